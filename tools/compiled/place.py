"""A build gets in place and out of it, in an order in which no half of it ever runs.

Shared library first, manifest last; on the way out the manifest last again. Whatever is in between is either a library
without a manifest or a manifest without its libraries, and bus.build refuses both.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from bus.build import LIBRARY, MANIFEST, PACKAGES, SOABI, hash_file


def read_sources(home: Path, modules: list[str]) -> dict[str, dict[str, Any]]:
    """What tells each source from a later one. Taken before compiling: a change meanwhile makes the build stale."""
    sources = {}
    for name in modules:
        status = (home / name).stat()
        sources[name] = {
            "size": status.st_size, "mtime_ns": status.st_mtime_ns, "sha256": hash_file(str(home / name))
        }  # fmt: skip
    return sources


def write_manifest(
    sources: dict[str, dict[str, Any]], libraries: Mapping[str, Path], flags: list[str], *, needs_librt: bool
) -> str:
    """The manifest of a build, as JSON text."""
    manifest = {
        "soabi": SOABI,
        "mypy": version("mypy"),
        "librt": version("librt") if needs_librt else "",
        "flags": flags,
        "sources": sources,
        "libraries": {name: path.stat().st_size for name, path in libraries.items()},
    }
    return json.dumps(manifest, indent=1) + "\n"


def remove_build(home: Path) -> None:
    """Take out what was put in place, by whichever Python and list of modules."""
    for package in PACKAGES:
        for path in sorted((home / package).rglob("*.so")):
            path.unlink()
    (home / MANIFEST).unlink(missing_ok=True)


def put_in_place(home: Path, libraries: Mapping[str, Path], manifest: str) -> None:
    """Copy the libraries beside their sources; take them out again when that does not succeed."""
    try:
        for name in sorted(libraries, key=lambda name: not name.startswith(LIBRARY)):
            shutil.copy(libraries[name], home / name)
        new = home / f"{MANIFEST}.new"
        new.write_text(manifest, encoding="utf-8")
        os.replace(new, home / MANIFEST)
    except BaseException:
        remove_build(home)
        (home / f"{MANIFEST}.new").unlink(missing_ok=True)
        raise
