"""What all processes have in common at their edges: streams, signals, exit codes, progress, and a last word at the end."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from types import FrameType

from bus.build import CURRENT
from bus.errors import BusLostError, HilsatError, PeerLostError
from bus.streams import open_streams
from bus.telemetry.link import Link
from bus.trace import describe_unforeseen
from bus.wire.transport import Transport

MEETING_PATIENCE_S = 10.0  # how long a side waits for the other to come
PROGRESS_EVERY_S = 0.2
TOGETHER_S = 0.2  # within which all of a bench are told to end: who is told last may lose the others before


ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # what asks a process to end; SIGHUP: its terminal went away


class Interrupted(KeyboardInterrupt):
    """A signal of ENDING arrived; carries its number."""

    @property
    def number(self) -> int:
        """The signal's number."""
        return int(self.args[0])


def name_signal(number: int) -> str:
    """Its name, "signal 40" for one without."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


@contextlib.contextmanager
def raise_signals() -> Iterator[list[int]]:
    """Yield the list of signals that came, one at most.

    Raise the first signal of ENDING in the body as Interrupted; the cleaning up after it is not disturbed by more.

    A SIGHUP that whoever started us has switched off (nohup) stays so.
    """
    previous = {number: signal.getsignal(number) for number in ENDING}
    came: list[int] = []
    try:
        _catch_signals(came)
        yield came
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def run_process(name: str, body: Callable[[], None]) -> int:
    """Run the body of a process, which is all that is left of it to do; return its exit code.

    0 when it ends, 128 + n for a signal, 3 for what nobody foresaw, 2 for a compiled build that is stale, else the error's
    own, after its message on stderr under `name`. Signals that come once it is ending are ignored from then on.
    """
    return guard_process(name, body, _catch_signals)


def guard_process(name: str, body: Callable[[], None], prepare: Callable[[], None] = lambda: None) -> int:
    """As run_process, for a process that sees to its signals itself.

    prepare : called first of all, with the streams open
    """
    open_streams()
    if CURRENT.trouble:
        print(f"{name}: {CURRENT.trouble}", file=sys.stderr)
        return 2
    try:
        try:
            prepare()
            return _run_body(name, body)
        finally:
            _ignore_signals()
    except KeyboardInterrupt as stop:  # also one that came while the words of an error were written
        return 128 + (stop.number if isinstance(stop, Interrupted) else signal.SIGINT)


def _run_body(name: str, body: Callable[[], None]) -> int:
    try:
        body()
    except HilsatError as error:
        if isinstance(error, BusLostError | PeerLostError):
            time.sleep(TOGETHER_S)  # a signal that comes now says why, and is how this process ends
        print(f"{name}: {error}", file=sys.stderr)
        return error.exit_code
    except Exception as error:
        print(f"{name}: {describe_unforeseen(name, error)}", file=sys.stderr)
        return HilsatError.exit_code
    return 0


def _catch_signals(came: list[int] | None = None) -> None:
    def interrupt(number: int, frame: FrameType | None) -> None:
        _ignore_signals()
        if came is not None:
            came.append(number)
        raise Interrupted(number)

    for number in ENDING:
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, interrupt)


def _ignore_signals() -> None:
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)


class Progress:
    """Tells whoever started the process how far it is, at most every PROGRESS_EVERY_S, as JSON lines on a descriptor."""

    def __init__(self, fd: int | None) -> None:
        self._fd = fd
        self._next_s = 0.0

    def __call__(self, tick: int) -> None:
        if self._fd is None or tick & 15:
            return
        now_s = time.monotonic()
        if now_s >= self._next_s:
            self._next_s = now_s + PROGRESS_EVERY_S
            self.say(tick=tick)

    def say(self, **what: object) -> None:
        """One JSON line; nobody listening is no error."""
        if self._fd is not None:
            with contextlib.suppress(OSError):
                os.write(self._fd, json.dumps(what).encode() + b"\n")


@contextlib.contextmanager
def last_word(
    name: str,
    transport: Transport,
    link: Link,
    progress: Progress,
    heartbeat: Callable[[bool], bytes],
    now_ns: Callable[[], int],
) -> Iterator[None]:
    """Whatever ends the body: say so on the bus and in the log, and leave both.

    heartbeat : the frame to leave behind; its argument says whether the process failed
    now_ns    : simulated time, for what is logged at the end
    """
    reason = "failed"
    try:
        yield
        reason = "done"
    except Interrupted:
        reason = "interrupted"
        raise
    except HilsatError as error:
        progress.say(**{f"{name}_error": type(error).__name__})  # one that only felt another's end is not the culprit
        with contextlib.suppress(HilsatError):
            link.event(now_ns(), "error", name, str(error))
        raise
    finally:
        with contextlib.suppress(HilsatError, OSError):
            transport.send(heartbeat(reason == "failed"))
        progress.say(**{f"{name}_bus": asdict(transport.counters)})
        with contextlib.suppress(HilsatError):
            if transport.counters.lossy:
                link.event(now_ns(), "warning", name, transport.counters.describe())
            link.close(reason)
        transport.close()
