"""The directory where packages and kernels are kept between runs, and the locks that keep two writers apart."""

from __future__ import annotations

import fcntl
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tools.vcan.errors import VcanError


def cache_dir() -> Path:
    """Return the cache's directory: $HILSAT_CACHE, else `hilsat` in $XDG_CACHE_HOME or ~/.cache."""
    if chosen := os.environ.get("HILSAT_CACHE"):
        return Path(chosen).absolute()
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base and os.path.isabs(base) else Path.home() / ".cache") / "hilsat"


def make_cache_dir(*parts: str) -> Path:
    """Return a directory inside the cache, made if need be. Raises VcanError."""
    path = cache_dir().joinpath(*parts)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise VcanError(
            f"the cache {path} cannot be written ({error.strerror}); set HILSAT_CACHE to a directory of yours"
        ) from error
    return path


def say(text: str) -> None:
    """Progress goes to stderr: stdout belongs to the command."""
    print(f"hilsat vcan: {text}", file=sys.stderr, flush=True)


@contextmanager
def locked(name: str) -> Iterator[None]:
    """Hold the cache's lock `name`; wait, and say so, while another process holds it. It falls with the process."""
    path = make_cache_dir("locks") / name
    with path.open("w") as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say(f"another process is busy with {name}; waiting for it (lock {path})")
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
