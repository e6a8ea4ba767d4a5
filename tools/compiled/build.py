"""Compile the modules of pyproject.toml's list in place: `make compiled`, or `python -P -m tools.compiled.build`.

Exit codes: 0 in place; 1 a module does not compile, after the compiler's words; 2 the surroundings do not allow it;
130 interrupted. Unless it is 0 no compiled build is in place, and the plain one runs.
"""

from __future__ import annotations

import contextlib
import fcntl
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from bus.build import find_build
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
    modules = list_modules(home)
    problems = [problem for name in modules for problem in check_file(home, name)]
    if problems:
        print(*problems, sep="\n", file=sys.stderr)
        return 1
    scratch = home / SCRATCH
    with _alone(scratch) as alone:
        if not alone:
            return _refuse("another one is at work in this checkout")
        remove_build(home)
        sources = read_sources(home, modules)
        compiled = _compile(home, modules, scratch)
        if compiled is None:
            print(f"make compiled: does not compile; {PLAIN}", file=sys.stderr)
            return 1
        manifest = write_manifest(sources, compiled.libraries, compiled.flags, needs_librt=compiled.needs_librt)
        put_in_place(home, compiled.libraries, manifest)
    build = find_build(str(home), "compiled")
    print(f"make compiled: {build.trouble or build.words}", file=sys.stderr)
    return 2 if build.trouble else 0


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
