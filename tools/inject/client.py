"""Asks the plant of a running bench: one request, and the replies to it, over a Unix socket beside the plant's.

A request that is not answered is sent once more with the same token, so that nothing is done twice.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import secrets
import select
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from bus.errors import PeerLostError, UsageError
from bus.mavlink.dialect import MAVLink_hilsat_reply_message
from bus.mavlink.endpoint import Endpoint
from bus.mavlink.json_parts import Assembler, cut_request
from bus.mavlink.packets import Message
from bus.mavlink.words import GROUND_COMPONENT, GROUND_SYSTEM_ID, PLANT_COMPONENT, SYSTEM_ID
from tools.inject.bench_finder import listens

LOOK_S: Final = 0.2  # between looks at whether the bench is still there
RESEND_AFTER: Final = 0.4  # of the time that an answer may take
QUEUE_S: Final = 0.002  # between two tries to put a part into a full queue
Reply = dict[str, Any]


class Refused(UsageError):
    """The plant does not do what was asked; `reasons` says why."""

    def __init__(self, reasons: list[str]) -> None:
        self.reasons = reasons
        super().__init__("\n".join(reasons) or "refused")


class BenchGone(PeerLostError):
    """The bench ended, or never answered."""


class PlantClient:
    """One program that asks one plant."""

    def __init__(self, plant: Path) -> None:
        """plant : its socket. Raises UsageError when no socket can be made beside it."""
        self._plant = str(plant)
        self._endpoint = _open_beside(plant.parent)
        self._assembler = Assembler()

    def ask(self, what: Reply, timeout_s: float, patience_s: float | None = None) -> Iterator[Reply]:
        """Yield the replies to a request up to the last one.

        timeout_s  : until the first reply
        patience_s : from one to the next; None: as long as the bench runs
        Raises Refused when it is refused, BenchGone when there is no answer, UsageError for what cannot be sent.
        """
        token = secrets.randbelow(2**32 - 1) + 1
        try:
            messages = cut_request(what, token, SYSTEM_ID, PLANT_COMPONENT)
        except ValueError as error:  # a number that is not finite, or too much of it
            raise UsageError(f"this cannot be sent: {error}") from None
        for reply in self._receive_in_order(messages, token, timeout_s, patience_s):
            if reply.get("state") == "refused":
                raise Refused([str(reason) for reason in reply.get("reasons", ())])
            yield reply
            if reply.get("final"):
                return

    def ask_once(self, what: Reply, timeout_s: float) -> Reply:
        """Return the last reply to a request; errors as `ask`."""
        reply: Reply = {}
        for reply in self.ask(what, timeout_s, timeout_s):  # noqa: B007
            pass
        return reply

    def _receive_in_order(
        self, messages: list[Message], token: int, timeout_s: float, patience_s: float | None
    ) -> Iterator[Reply]:
        waiting: dict[int, Reply] = {}
        for number in itertools.count():
            first = number == 0
            limit_s = timeout_s if first else patience_s
            self._await(waiting, number, messages if first else [], token, limit_s)
            yield waiting.pop(number)

    def _await(
        self, waiting: dict[int, Reply], number: int, messages: list[Message], token: int, limit_s: float | None
    ) -> None:
        """Put replies into `waiting` until the one of this number is there."""
        begun_s = time.monotonic()
        resend_s = begun_s if messages else None
        sendings = 0
        while number not in waiting:
            now_s = time.monotonic()
            if limit_s is not None and now_s - begun_s >= limit_s:
                if not messages:
                    raise BenchGone(f"nothing more from the bench within {limit_s:g} s")
                raise BenchGone(f"no answer from the bench within {limit_s:g} s; it is busy or does not move")
            if resend_s is not None and now_s >= resend_s and sendings < 2:
                # A plant that is not up yet, or whose queue is full, has not got it: that was no sending.
                there = listens(self._plant)
                sendings += there and self._send(messages, now_s + (RESEND_AFTER * (limit_s or 1.0)))
                resend_s = now_s + (RESEND_AFTER * (limit_s or 1.0) if sendings else LOOK_S)
            self._collect(waiting, token, LOOK_S if limit_s is None else min(LOOK_S, begun_s + limit_s - now_s))
            if number not in waiting and self._has_ended(first=bool(messages)):
                self._collect(waiting, token, 0.0)  # its last words
                if number not in waiting:
                    raise BenchGone("the bench has ended")

    def _send(self, messages: list[Message], until_s: float) -> bool:
        """Send them in order, as fast as the plant reads: its queue holds ten. False where it does not by then."""
        for message in messages:
            while not self._endpoint.try_send(message, self._plant):
                if time.monotonic() >= until_s:
                    return False
                time.sleep(QUEUE_S)
        return True

    def _has_ended(self, first: bool) -> bool:
        """Return whether nobody is there any more. A bench that has not answered yet may be about to make its socket."""
        if not os.path.lexists(self._plant):
            return not first or not os.path.lexists(os.path.dirname(self._plant))
        return not listens(self._plant)

    def _collect(self, waiting: dict[int, Reply], token: int, wait_s: float) -> None:
        select.select([self._endpoint], [], [], max(0.0, wait_s))
        for message, sender in self._endpoint.poll():
            if sender != self._plant or not isinstance(message, MAVLink_hilsat_reply_message) or message.token != token:
                continue
            reply = self._assembler.add(message, sender)
            if reply is not None:
                waiting[message.reply] = reply

    def close(self) -> None:
        """Close the socket. May be repeated."""
        self._endpoint.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _open_beside(directory: Path) -> Endpoint:
    for number in range(100):
        path = directory / f"ground-{os.getpid()}-{number}.sock"
        if not os.path.lexists(path):
            return Endpoint(path, GROUND_SYSTEM_ID, GROUND_COMPONENT)
        if not listens(str(path)):  # of a process that had our number
            with contextlib.suppress(OSError):
                path.unlink()
            return Endpoint(path, GROUND_SYSTEM_ID, GROUND_COMPONENT)
    raise UsageError(f"{directory}: too many clients of one process")
