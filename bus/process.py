"""What both processes have in common at their edges: signals, exit codes, progress, and a last word when they end."""

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

from bus.errors import HilsatError
from bus.telemetry.link import Link
from bus.wire.transport import Transport

MEETING_PATIENCE_S = 10.0  # how long a side waits for the other to come
PROGRESS_EVERY_S = 0.2


class Interrupted(Exception):
    """SIGINT or SIGTERM arrived; carries the signal's number."""


def run_process(name: str, body: Callable[[], None]) -> int:
    """Run the body of a process; return its exit code.

    0 when it ends, 128 + n for a signal, else the error's own, after its message on stderr under `name`.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    try:
        body()
    except Interrupted as stop:
        return 128 + int(stop.args[0])
    except HilsatError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise Interrupted(number)


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
