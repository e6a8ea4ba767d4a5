"""Frames that no sound node sends: those of a babbling one, and forged ones."""

from __future__ import annotations

import math
from typing import Final

from bus.icd.e2e import COUNTER_MODULUS, checksum
from bus.wire.frames import FRAME
from plant_server.faults.bus_nodes import FSW, ROUTES
from plant_server.faults.kinds.bus import Babble, Masquerade
from plant_server.faults.timeline import ActiveFault

FORGED_AHEAD: Final = 7  # counts by which a forged sequence starts ahead of the true one: about half of a turn


def goes_to_plant(can_id: int, sender: str) -> bool:
    """Whether an inserted frame is one for the plant's nodes; the flight computer does not hear its own ids."""
    route = ROUTES.get(can_id)
    return sender == FSW if route is None else route[0] == FSW


def count_babble(effect: Babble, elapsed_s: float, tick_s: float) -> int:
    """Return how many frames a babbling node sends in the tick that begins so long after the onset [1]."""
    return math.floor((elapsed_s + tick_s) * effect.rate_hz + 1e-6) - math.floor(elapsed_s * effect.rate_hz + 1e-6)


def make_babble(effect: Babble) -> bytes:
    """Return one of its frames."""
    return FRAME.pack(effect.can_id, 8, bytes(8))


class Forger:
    """What a masquerading node knows: the last frame of the id at its onset, and its own last frame."""

    def __init__(self) -> None:
        self._last: dict[int, bytes] = {}  # data of the last frame sent, by id
        self._own: dict[str, bytes] = {}  # and by node
        self._stale: dict[int, bytes] = {}  # by fault: what the id carried at the onset
        self._counters: dict[int, int] = {}

    def note(self, can_id: int, sender: str, frame: bytes) -> None:
        """Keep what was sent."""
        self._last[can_id] = self._own[sender] = frame[8:16]

    def forge(self, entry: ActiveFault[Masquerade]) -> bytes | None:
        """Return the frame of this tick; None while there is nothing to forge it from."""
        effect, number = entry.effect, entry.occurrence.number
        last = self._last.get(effect.can_id)
        if last is None:
            return None
        if number not in self._stale:
            self._stale[number] = last
            self._counters[number] = (last[1] & 0x0F) + FORGED_AHEAD
        data = self._stale[number] if effect.content == "stale" else self._own.get(effect.node)
        if data is None:
            return None
        counter = self._counters[number] % COUNTER_MODULUS
        self._counters[number] = counter + 1
        payload = bytes([data[1] & 0xF0 | counter]) + data[2:]
        return FRAME.pack(effect.can_id, 8, bytes([checksum(effect.can_id, payload)]) + payload)
