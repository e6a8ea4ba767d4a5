"""Files that verbs write for people: made whole or not at all, and never in the place of another that was there.

The content goes into a file of another name in the same directory, which takes its name when it is whole.
"""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Iterator, Sequence
from pathlib import Path

from bus.errors import RecordError, UsageError


@contextlib.contextmanager
def create(out: Path, source: Path | Sequence[Path], force: bool = False) -> Iterator[Path]:
    """A path to write to; what is written there becomes `out` when the body ends well, and goes when it does not.

    source : the file that is read from, or some, which are never replaced
    force  : another file of this name may be replaced
    Raises UsageError when `out` is there already, or is a source; RecordError when it cannot be written.
    """
    try:
        if _is_device(out):
            yield out
            return
        _refuse(out, [source] if isinstance(source, Path) else source, force)
        part = out.parent / f".hilsat-{secrets.token_hex(8)}.part"
        try:
            yield part
            _put_in_place(part, out, force)
        finally:
            with contextlib.suppress(OSError):
                part.unlink()
    except BrokenPipeError:
        raise
    except OSError as error:
        raise RecordError(f"{out}: cannot write: {error.strerror or error}") from None
    except ValueError as error:
        if "null" not in str(error):
            raise
        raise UsageError(f"{str(out)!r} cannot be the name of a file: {error}") from None


def _is_device(path: Path) -> bool:
    return path.exists() and not path.is_file() and not path.is_dir()


def _refuse(out: Path, sources: Sequence[Path], force: bool) -> None:
    if out.exists() and any(source.exists() and os.path.samefile(out, source) for source in sources):
        raise UsageError(f"{out}: this is the log that is read, or another input; name another file")
    if out.is_dir():
        raise UsageError(f"{out}: this is a directory; name a file with -o")
    if os.path.lexists(out) and not force:
        raise UsageError(_say_there(out))


def _put_in_place(part: Path, out: Path, force: bool) -> None:
    if force:
        os.replace(part, out)
        return
    try:
        os.link(part, out)
    except FileExistsError:
        raise UsageError(_say_there(out)) from None
    except OSError:  # a file system without links
        os.close(_claim(out))
        os.replace(part, out)


def _claim(out: Path) -> int:
    try:
        return os.open(out, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    except FileExistsError:
        raise UsageError(_say_there(out)) from None


def _say_there(out: Path) -> str:
    return f"{out} is there already and stays as it is; name another file, or replace it with --force"
