"""The compiled wheel: `HILSAT_COMPILE=1 pip wheel .` adds to the plain one what `make compiled` puts in place.

Loaded by hatchling, by its path, also for the plain wheel, which it leaves as it is.
"""

from __future__ import annotations

import os
import sys
import tomllib
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

COMPILING = ("mypy", "librt", "setuptools", "types-")  # of the development group


class CompiledWheel(BuildHookInterface[Any]):  # type: ignore[misc]  # hatchling is there when it builds alone
    """Compiles in the build directory and adds libraries and manifest to the wheel; nothing is put into the tree."""

    @property
    def wanted(self) -> bool:
        """Whether this build is of the compiled wheel. An editable install is plain: `make compiled` is for it."""
        return self.target_name == "wheel" and os.environ.get("HILSAT_COMPILE") == "1"

    def dependencies(self) -> list[str]:
        """What the build needs besides hatchling: the compiler, and all that our modules import, whose types it reads."""
        if not self.wanted:
            return []
        project = tomllib.loads(Path(self.root, "pyproject.toml").read_text(encoding="utf-8"))
        compiling = [word for word in project["dependency-groups"]["dev"] if word.startswith(COMPILING)]
        return [*compiling, *project["project"]["dependencies"]]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Before the files of the wheel are collected."""
        if not self.wanted or version == "editable":
            return
        sys.path.insert(0, self.root)
        from tools.compiled.build import compile_for_wheel

        files, requires = compile_for_wheel(Path(self.root))
        build_data["pure_python"] = False
        build_data["infer_tag"] = True
        build_data["force_include"].update({str(path): name for name, path in files.items()})
        build_data["dependencies"].extend(requires)
