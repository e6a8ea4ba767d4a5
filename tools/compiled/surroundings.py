"""What a machine must have to compile, told in a line each before anything is touched."""

from __future__ import annotations

import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

from bus.build import PACKAGES
from tools.compiled.project import SCRATCH


def describe_missing(home: Path) -> str:
    """The first thing that is missing and what brings it; empty when all is there."""
    return _miss_packages() or _miss_compiler() or _miss_headers() or miss_writing(home)


def _miss_packages() -> str:
    for name, package in (("mypyc", "mypy"), ("setuptools", "setuptools"), ("librt", "librt")):
        if importlib.util.find_spec(name) is None:
            return f"the Python package {package} is missing: `make setup` installs it"
    return ""


def _miss_compiler() -> str:
    words = shlex.split(os.environ.get("CC") or str(sysconfig.get_config_var("CC") or "cc"))
    if not words or shutil.which(words[0]) is None:
        return f"there is no C compiler {' '.join(words)!r}: sudo apt-get install gcc, or name another in CC"
    with tempfile.TemporaryDirectory() as place:
        source = Path(place, "probe.c")
        source.write_text("int probe;\n")
        done = subprocess.run(
            [*words, "-c", str(source), "-o", str(source.with_suffix(".o"))],
            capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        if done.returncode != 0 or not source.with_suffix(".o").exists():
            said = done.stderr.strip().splitlines()[:1]
            return f"the C compiler {' '.join(words)!r} does not compile{': ' if said else ''}{''.join(said)}"
    return ""


def _miss_headers() -> str:
    header = Path(sysconfig.get_path("include"), "Python.h")
    if header.exists():
        return ""
    package = f"python{sys.version_info.major}.{sys.version_info.minor}-dev"
    return f"the headers of Python are missing ({header}): sudo apt-get install {package}"


def miss_writing(home: Path) -> str:
    """The first place that cannot be written to: compiled modules lie beside their sources."""
    for name in PACKAGES:
        if not os.access(home / name, os.W_OK):
            return f"{home / name} cannot be written to, and compiled modules lie beside their sources"
    try:
        (home / SCRATCH).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        return f"{home / SCRATCH} cannot be made: {error.strerror}"
    return ""
