"""The standard streams of a process, whatever they were when it was started: closed, full, or of a narrow encoding."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import select
import sys
from typing import IO, Any

ERRORS = "backslashreplace"  # a sign that the terminal does not have is shown as its number


class PatientFile(io.FileIO):
    """A descriptor whose write errors are kept and not raised: words that nobody gets are no reason to fail.

    failure     : the first write error; None as long as all went well
    raises_pipe : a reader that went away is raised as BrokenPipeError
    """

    def __init__(self, fd: int, raises_pipe: bool) -> None:
        super().__init__(fd, "w", closefd=False)
        self.failure: OSError | None = None
        self._raises_pipe = raises_pipe

    def write(self, data: Any) -> int:
        """Write; bytes taken, or passed over after a failure."""
        try:
            while (taken := super().write(data)) is None:  # a terminal that somebody made non-blocking
                select.select([], [self], [])
            return taken
        except OSError as error:
            if error.errno == errno.EPIPE and self._raises_pipe:
                raise
            self.failure = self.failure or error
            return len(memoryview(data).cast("B"))


def open_streams() -> None:
    """Make 0, 1 and 2 open descriptors and stdout and stderr writable with any text. Harmless when repeated.

    Call it before anything else opens a descriptor: what is opened while one of the three is closed takes its number.
    """
    for fd in (0, 1, 2):
        try:
            os.fstat(fd)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # takes the lowest number that is free: fd
    if sys.stdin is None:
        sys.stdin = open(0, closefd=False)  # noqa: SIM115 - for the life of the process
    sys.stdout = _open_patiently(sys.stdout, 1)
    sys.stderr = _open_patiently(sys.stderr, 2)


def read_failure(stream: IO[str] | None) -> OSError | None:
    """Flush the stream and return its first write error; None when it had none. Raises BrokenPipeError for stdout."""
    if stream is None:
        return None
    with contextlib.suppress(ValueError):  # closed
        stream.flush()
    raw = getattr(getattr(stream, "buffer", None), "raw", None)
    return raw.failure if isinstance(raw, PatientFile) else None


def _open_patiently(stream: Any, fd: int) -> Any:
    """The stream over a PatientFile; one that a test or a notebook put there stays."""
    if stream is not None:
        try:
            same = stream.fileno() == fd and isinstance(stream, io.TextIOWrapper)
        except (OSError, ValueError, AttributeError):
            same = False
        if not same or isinstance(getattr(stream.buffer, "raw", None), PatientFile):
            return stream
        with contextlib.suppress(OSError):
            stream.flush()
    return io.TextIOWrapper(
        io.BufferedWriter(PatientFile(fd, raises_pipe=fd == 1)),
        encoding="utf-8" if stream is None else stream.encoding,
        errors=ERRORS,
        line_buffering=fd == 2 or (stream is not None and stream.line_buffering),
        write_through=stream is not None and stream.write_through,
    )
