"""MAV_CMD_CAN_FORWARD: the frames of the bus to who asked for them, as ArduPilot does it, at a rate that a tick can bear."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from bus.clock import MonotonicClock
from bus.mavlink import words
from bus.mavlink.component import CommandRequest
from bus.mavlink.dialect import MAVLink_can_frame_message
from bus.mavlink.endpoint import Endpoint
from bus.mavlink.packets import Message
from bus.wire.frames import FRAME

CAN_FILTER_MODIFY: Final = 388
REPLACE, ADD, REMOVE = 0, 1, 2  # CAN_FILTER_OP
BUSES: Final = 1
LAST_NS: Final = 5_000_000_000  # after the last request
FRAMES_A_TICK: Final = 32
FRAMES_A_S: Final = 2000  # of wall time
BURST: Final = 200
MOST_IDS: Final = 256  # in the filter


class CanForward:
    """Forwards to one peer at a time; another that asks takes its place."""

    def __init__(self, endpoint: Endpoint, clock: MonotonicClock, say: Callable[[str, str], None]) -> None:
        self._endpoint = endpoint
        self._clock = clock
        self._say = say
        self.on = False
        self.sent = 0
        self.left_out = 0  # frames that passed the filter and were too many
        self._to = ("", 0, 0)  # address, system and component of who asked
        self._until_ns = self._filled_ns = 0
        self._room = float(BURST)
        self._wanted: set[int] = set()  # ids; none: all
        self.commands: dict[int, Callable[[CommandRequest], int]] = {words.CMD_CAN_FORWARD: self._start}
        self.others: dict[int, Callable[[Message, str], None]] = {CAN_FILTER_MODIFY: self._modify}

    def send(self, frames: bytes, answer: bytes) -> None:
        """Send the frames of a tick that were received, then those that were sent."""
        now_ns = self._clock.now_ns()
        if now_ns >= self._until_ns:
            self._stop("no request for 5 s")
            return
        self._room = min(float(BURST), self._room + (now_ns - self._filled_ns) * (FRAMES_A_S * 1e-9))
        self._filled_ns = now_ns
        left, wanted = min(FRAMES_A_TICK, int(self._room)), self._wanted
        address, system, component = self._to
        messages = []
        for can_id, length, data in FRAME.iter_unpack(frames + answer):
            if wanted and can_id not in wanted:
                continue
            if left <= 0:
                self.left_out += 1
                continue
            left -= 1
            messages.append(MAVLink_can_frame_message(system, component, 0, min(length, 8), can_id, list(data)))
        self._room -= len(messages)
        if messages and self._endpoint.send_together(messages, address):
            self.sent += len(messages)

    def _start(self, request: CommandRequest) -> int:
        bus, asker = request.whole(1, -1), (request.address, request.system, request.component)
        if bus == 0:
            if self.on and asker == self._to:
                self._stop("asked to")
            return words.ACCEPTED
        if bus is None or not 1 <= bus <= BUSES or not request.address:
            self._say("warning", f"CAN forward refused: there is bus 1 to {BUSES}, and 0 to stop")
            return words.DENIED
        now_ns = self._clock.now_ns()
        if not self.on or self._to != asker:
            self.sent = self.left_out = 0
            self._wanted = set()
            self._filled_ns = now_ns
            self._room = float(BURST)
        self.on, self._to = True, asker
        self._until_ns = now_ns + LAST_NS
        return words.ACCEPTED

    def _stop(self, why: str) -> None:
        self.on = False
        self._say("info", f"CAN forward ends, {why}: {self.sent} frames, {self.left_out} left out")

    def _modify(self, message: Message, address: str) -> None:
        """Change which ids are forwarded; a filter with no id in it lets all pass."""
        if not self.on or (address, message.get_srcSystem(), message.get_srcComponent()) != self._to:
            return
        ids = set(message.ids[: min(message.num_ids, 16)])
        if message.operation == REPLACE:
            self._wanted = ids
        elif message.operation == ADD and len(self._wanted | ids) <= MOST_IDS:
            self._wanted |= ids
        elif message.operation == REMOVE:
            self._wanted -= ids
