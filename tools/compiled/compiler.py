"""From Python to shared libraries, in a directory of its own: mypyc makes C of modules, setuptools calls the compiler."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import setuptools  # before mypyc, which asks whether it is there
from mypyc.build import mypycify
from setuptools.command.build_ext import build_ext

from bus.build import LIBRARY
from tools.compiled.project import EXACT_FLAGS, OPTIMISATION

GROUP = LIBRARY.removesuffix("__mypyc").replace(os.sep, ".")  # mypyc adds the suffix


class Compiled(NamedTuple):
    """What a compilation made."""

    libraries: dict[str, Path]  # place below the packages' home -> file
    flags: list[str]
    needs_librt: bool


class BuildBeside(build_ext):  # type: ignore[misc]  # setuptools has no types
    """Compiles the files of one library side by side too: nearly all of them belong to one."""

    def build_extensions(self) -> None:
        """As setuptools calls it, with the compiler at hand."""
        compiler = self.compiler
        workers = len(os.sched_getaffinity(0))

        def compile_all(
            sources: list[str], output_dir: str | None = None, macros: Any = None, include_dirs: Any = None,
            debug: bool = False, extra_preargs: Any = None, extra_postargs: Any = None, depends: Any = None,
        ) -> list[str]:  # fmt: skip
            macros, objects, postargs, options, build = compiler._setup_compile(
                output_dir, macros, include_dirs, sources, depends, extra_postargs
            )
            arguments = compiler._get_cc_args(options, debug, extra_preargs)
            with ThreadPoolExecutor(workers) as pool:
                list(pool.map(lambda o: compiler._compile(o, *build[o], arguments, postargs, options), objects))
            return list(objects)

        compiler.compile = compile_all
        super().build_extensions()


def compile_modules(home: Path, modules: list[str], scratch: Path) -> Compiled:
    """Compile modules of `home` in `scratch`, which is emptied first.

    Raises SystemExit after mypyc's own messages, setuptools' errors after the C compiler's.
    """
    for name in ("CFLAGS", "LDFLAGS"):  # somebody's -ffast-math would get into the link as well
        os.environ.pop(name, None)
    for name in ("source", "object", "library"):
        shutil.rmtree(scratch / name, ignore_errors=True)
    source = scratch / "source"
    with contextlib.chdir(home):
        extensions = mypycify(
            ["--config-file=pyproject.toml", f"--cache-dir={scratch / 'cache'}", *modules],
            opt_level=OPTIMISATION, debug_level="0", multi_file=True, target_dir=str(source), group_name=GROUP,
        )  # fmt: skip
        for extension in extensions:
            extension.extra_compile_args = [*extension.extra_compile_args, *EXACT_FLAGS]
            extension.include_dirs = [*extension.include_dirs, str(source / Path(LIBRARY).parent)]
        # Not setup(): that would read pyproject.toml, which is another tool's.
        command = BuildBeside(setuptools.Distribution({"name": "hilsat-compiled", "ext_modules": extensions}))
        command.build_lib, command.build_temp = str(scratch / "library"), str(scratch / "object")
        command.ensure_finalized()
        command.run()
    built = [Path(path) for path in command.get_outputs()]
    return Compiled(
        {str(path.relative_to(scratch / "library")): path for path in built},
        list(extensions[0].extra_compile_args),
        any(re.search(r"\bimport_librt_", path.read_text()) for path in source.rglob("__native*.c")),
    )
