"""Who flies the runs of a campaign: what every kind of crew has in common."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import FrameType
from typing import Protocol

from bus.process import ENDING
from tools.campaign.fly import Flown
from tools.campaign.plan import RunPlan


@dataclass(frozen=True, slots=True)
class Order:
    """One run to be flown. log: name of the log in the campaign's directory, empty for none."""

    plan: RunPlan
    log: str = ""


class Crew(Protocol):
    """Flies orders, several at a time."""

    def fly(self, orders: Sequence[Order], on_done: Callable[[Flown], None]) -> None:
        """Fly all orders; call on_done as each is done, in whatever order that is.

        Returns early once the halt is asked for: what was under way is done, or dropped when it is asked for urgently.
        """

    def close(self) -> None:
        """Let everybody go. Harmless when repeated."""


class Halt:
    """Whether the campaign is to stop, and how soon. `fd` becomes readable when that changes.

    The first signal lets the runs under way come to their end; a second one, or SIGTERM, drops them.
    """

    def __init__(self) -> None:
        self.number = 0  # of the first signal
        self.urgent = False
        self.fd, self._write_fd = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)

    @property
    def asked(self) -> bool:
        """Whether no more runs are to begin."""
        return self.number != 0

    def ask(self, number: int) -> None:
        """A signal has come."""
        self.urgent = self.urgent or self.asked or number != signal.SIGINT
        self.number = self.number or number
        with contextlib.suppress(BlockingIOError):
            os.write(self._write_fd, b"!")

    def clear(self) -> None:
        """Make fd wait for the next signal."""
        with contextlib.suppress(BlockingIOError):
            os.read(self.fd, 64)

    def close(self) -> None:
        """Give the descriptors back."""
        os.close(self.fd)
        os.close(self._write_fd)


@contextlib.contextmanager
def catch_signals() -> Iterator[Halt]:
    """Yield what the signals that ask this process to end are turned into. A SIGHUP that is switched off stays so."""
    halt = Halt()

    def note(number: int, frame: FrameType | None) -> None:
        halt.ask(number)

    previous = {number: signal.getsignal(number) for number in ENDING}
    for number, handler in previous.items():
        if number != signal.SIGHUP or handler is not signal.SIG_IGN:
            signal.signal(number, note)
    try:
        yield halt
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
        halt.close()
