"""Compile the modules of pyproject.toml's list in place: `make compiled`, or `python -P -m tools.compiled.build`.

Exit codes: 0 in place; 1 a module does not compile, after the compiler's words; 2 the surroundings do not allow it;
130 interrupted. Unless it is 0 no compiled build is in place, and the plain one runs.
"""

from __future__ import annotations

import contextlib
import fcntl
import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from bus.build import MANIFEST, find_build
from tools.compiled.place import put_in_place, read_sources, remove_build, write_manifest
from tools.compiled.project import HOME, SCRATCH, list_modules
from tools.compiled.rules import check_file
from tools.compiled.surroundings import describe_missing

if TYPE_CHECKING:
    from tools.compiled.compiler import Compiled

PLAIN = "the plain build goes on working"


def main() -> int:
    """Build; return the exit code."""
    try:
        missing = describe_missing(HOME)
        if missing:
            return _refuse(missing)
        return build_in_place(HOME)
    except KeyboardInterrupt:
        print(f"make compiled: interrupted; {PLAIN}", file=sys.stderr)
        return 130
    except (OSError, ValueError) as error:  # a full disk, a place that cannot be written to, a wrong list
        return _refuse(str(error))


def build_in_place(home: Path) -> int:
    """Take out the old build, compile, put the new one in place; return the exit code."""
    with _alone(home / SCRATCH) as alone:
        if not alone:
            return _refuse("another one is at work in this checkout")
        modules = list_modules(home)
        remove_build(home)
        built = _build(home, modules)
        if built is None:
            print(f"make compiled: does not compile; {PLAIN}", file=sys.stderr)
            return 1
        compiled, manifest = built
        put_in_place(home, compiled.libraries, manifest)
    build = find_build(str(home), "compiled")
    print(f"make compiled: {build.trouble or build.words}", file=sys.stderr)
    return 2 if build.trouble else 0


def compile_for_wheel(home: Path) -> tuple[dict[str, Path], list[str]]:
    """Files to add to a wheel, by their place in it, and what it then requires. Nothing is put in place.

    Raises SystemExit with words where it cannot be built.
    """
    missing = describe_missing(home)
    if missing:
        raise SystemExit(f"compiled wheel: {missing}")
    with _alone(home / SCRATCH) as alone:
        built = _build(home, list_modules(home)) if alone else None
        if built is None:
            raise SystemExit(
                "compiled wheel: does not compile" if alone else "compiled wheel: make compiled is at work"
            )
    compiled, manifest = built
    file = home / SCRATCH / "manifest.json"
    file.write_text(manifest, encoding="utf-8")
    requires = [f"librt=={version('librt')}"] if compiled.needs_librt else []
    return {**compiled.libraries, MANIFEST: file}, requires


def _build(home: Path, modules: list[str]) -> tuple[Compiled, str] | None:
    """Libraries and manifest; None when a module does not compile or breaks a rule, which has been said."""
    problems = [problem for name in modules for problem in check_file(home, name)]
    if problems:
        print(*problems, sep="\n", file=sys.stderr)
        return None
    sources = read_sources(home, modules)
    compiled = _compile(home, modules, home / SCRATCH)
    if compiled is None:
        return None
    return compiled, write_manifest(sources, compiled.libraries, compiled.flags, needs_librt=compiled.needs_librt)


def _compile(home: Path, modules: list[str], scratch: Path) -> Compiled | None:
    """None when a module does not compile; the compiler has said why."""
    from setuptools.errors import CCompilerError  # only now is it known that these are there

    from tools.compiled.compiler import compile_modules

    try:
        return compile_modules(home, modules, scratch)
    except CCompilerError as error:
        print(error, file=sys.stderr)
    except SystemExit:  # mypyc found something
        pass
    return None


@contextlib.contextmanager
def _alone(scratch: Path) -> Iterator[bool]:
    """Whether no other build is at work, for as long as the body takes."""
    with open(scratch / "lock", "w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True


def _refuse(reason: str) -> int:
    print(f"make compiled: {reason}; {PLAIN}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
