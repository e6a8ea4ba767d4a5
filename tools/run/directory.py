"""The directory of a run: made or claimed for one run alone, before anything is started. What is in it stays."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from bus.errors import UsageError

LOG, PICTURE, CLAIM = "run.mcap", "run.png", "run.claim"
NAME_LIMIT_BYTES = 128  # of a scenario's name: the time and a number follow, and a file system takes 255


@contextlib.contextmanager
def own_directory(wanted: Path | None, name: str) -> Iterator[Path]:
    """Yield the directory for the log, claimed by this run until the end of the body.

    wanted : what the user named, None for a new one runs/NAME-TIME
    Raises UsageError for one that another run has, that holds a run already or that cannot be written.
    """
    directory = _make_default(name) if wanted is None else _make_wanted(wanted)
    claim = directory / CLAIM
    _claim(directory, claim)
    try:
        for taken in (LOG, PICTURE):
            if os.path.lexists(directory / taken):
                raise UsageError(f"{directory}: there is a {taken} in it already; name another directory with --out")
        yield directory
    finally:
        with contextlib.suppress(OSError):
            claim.unlink()


def keep_words(directory: Path, name: str, words: bytes) -> Path | None:
    """Write what a process said to a new file NAME.err, or NAME-2.err and so on; None when it cannot be written."""
    number = 1
    while True:
        path = directory / (f"{name}.err" if number == 1 else f"{name}-{number}.err")
        try:
            with open(path, "xb") as file:
                file.write(words)
            return path
        except FileExistsError:
            number += 1
        except OSError:
            return None


def _make_wanted(wanted: Path) -> Path:
    try:
        wanted.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise UsageError(
            f"{_show(wanted)}: cannot make the directory for the log: {_reason(error)}; use --out"
        ) from None
    return wanted


def _make_default(name: str) -> Path:
    if "/" in name or "\0" in name or len(os.fsencode(name)) > NAME_LIMIT_BYTES:
        raise UsageError(
            f"the scenario's name {_show(name)} cannot name a directory (no slash, at most {NAME_LIMIT_BYTES} bytes); "
            "change the name, or use --out"
        )
    base = Path("runs") / f"{name}-{datetime.now(UTC):%Y%m%d-%H%M%S}"
    directory, count = base, 1
    while True:
        try:
            base.parent.mkdir(exist_ok=True)
            directory.mkdir()
            return directory
        except FileExistsError:
            if not base.parent.is_dir():
                raise UsageError("runs: is not a directory; name one for the log with --out") from None
            count += 1
            directory = base.with_name(f"{base.name}-{count}")
        except OSError as error:
            raise UsageError(
                f"{_show(directory)}: cannot make the directory for the log: {_reason(error)}; use --out"
            ) from None


def _claim(directory: Path, claim: Path) -> None:
    try:
        os.close(os.open(claim, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600))
    except FileExistsError:
        raise UsageError(
            f"{directory}: another run has it ({CLAIM} is in it); name another directory with --out, or remove that file "
            "when no run is under way"
        ) from None
    except OSError as error:
        raise UsageError(
            f"{_show(directory)}: the directory for the log is not writable: {_reason(error)}; name another one with --out"
        ) from None


def _reason(error: OSError | ValueError) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def _show(name: Path | str) -> str:
    """For a message: one line, and not longer than one."""
    text = ascii(str(name))[1:-1] if not str(name).isprintable() else str(name)
    return text if len(text) <= 80 else text[:77] + "..."
