"""What is compiled, and with which flags: the list of modules is in pyproject.toml, so that it stands once."""

from __future__ import annotations

import tomllib
from pathlib import Path

HOME = Path(__file__).resolve().parents[2]
SCRATCH = Path("build", "compiled")  # below HOME
# What the user's CFLAGS or the target would change, plain Python does not do: the bits must be the same. The order counts:
# in clang -fno-fast-math sets the contraction back.
EXACT_FLAGS = ("-fno-fast-math", "-ffp-contract=off")
OPTIMISATION = "2"


def list_modules(home: Path) -> list[str]:
    """Sources to compile, as paths below `home`. Raises ValueError for a list that is wrong."""
    project = tomllib.loads((home / "pyproject.toml").read_text(encoding="utf-8"))
    modules: list[str] = project["tool"]["hilsat"]["compiled"]["modules"]
    if modules != sorted(set(modules)):
        raise ValueError("[tool.hilsat.compiled] modules: not sorted, or one twice")
    missing = [name for name in modules if not (home / name).is_file()]
    if missing:
        raise ValueError(f"[tool.hilsat.compiled] modules: no such file: {', '.join(missing)}")
    return modules
