"""Which packet goes where between ground stations and the two sides of a bench. No sockets: see gateway.py.

From the ground, by its target: system 0 or 1; component 0 is both sides, 1 the flight software, 25 the plant; others are not
delivered. A message without a target goes to both. INJECT_FAILURE (420) is the plant's business whoever is asked: sent to
component 0 or 1 it goes to the plant alone, and the plant's answer goes back as from component 1, because MAVSDK and ground
stations take the answer of the autopilot only.

From the sides, to all ground stations: each component's packets with a dense sequence of their own.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Final, NamedTuple

from bus.mavlink.packets import LinkCounters, Message
from bus.mavlink.words import (
    CMD_INJECT_FAILURE,
    FSW_COMPONENT,
    IN_PROGRESS,
    PLANT_COMPONENT,
    SYSTEM_ID,
)
from tools.ground.rewriting import readdress, renumber

COMMAND_INT_ID, COMMAND_LONG_ID, COMMAND_ACK_ID = 75, 76, 77
SIDES: Final = {FSW_COMPONENT: "fsw", PLANT_COMPONENT: "plant"}
MOST_ASKED: Final = 64  # commands whose answers are waited for
PATIENCE_S: Final = 10.0  # after which the answer to one does not come any more


class Asked(NamedTuple):
    """An INJECT_FAILURE on its way: who asked whom, and until when it may be answered."""

    ground: tuple[int, int]  # system and component
    component: int
    until_s: float


class Router:
    """Routes and rewrites the messages of one bench."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        """now_s : a clock that never goes back [s]"""
        self._now_s = now_s
        self._asked: deque[Asked] = deque(maxlen=MOST_ASKED)
        self._sequence: dict[int, int] = {}

    def route(self, message: Message, counters: LinkCounters) -> list[tuple[str, bytes]]:
        """Return side and packet for each side that a message of the ground is for; none, and counted, for a foreign one."""
        system, component = getattr(message, "target_system", 0), getattr(message, "target_component", 0)
        from_us = message.get_srcSystem() == SYSTEM_ID and message.get_srcComponent() in SIDES
        if from_us or system not in (0, SYSTEM_ID) or component not in (0, *SIDES):
            counters.foreign += 1
            return []
        if message.get_msgId() in (COMMAND_INT_ID, COMMAND_LONG_ID) and message.command == CMD_INJECT_FAILURE:
            ground = (message.get_srcSystem(), message.get_srcComponent())
            self._asked.append(Asked(ground, component, self._now_s() + PATIENCE_S))
            return [("plant", readdress(message, PLANT_COMPONENT))]
        packet = bytes(message.get_msgbuf())
        return [(side, packet) for number, side in SIDES.items() if component in (0, number)]

    def number(self, message: Message) -> bytes:
        """Return the packet in which a message of a side goes to the ground, unsigned."""
        component = message.get_srcComponent()
        if message.get_msgId() == COMMAND_ACK_ID and message.command == CMD_INJECT_FAILURE:
            component = self._find_asked(message) or component
        sequence = self._sequence.get(component, 0)
        self._sequence[component] = (sequence + 1) % 256
        return renumber(message, sequence, component)

    def _find_asked(self, ack: Message) -> int | None:
        """Return as which component this answer goes on; None: as it is."""
        now_s = self._now_s()
        while self._asked and self._asked[0].until_s < now_s:
            self._asked.popleft()
        wanted = (ack.target_system, ack.target_component)
        found = next((asked for asked in self._asked if wanted in (asked.ground, (0, 0))), None)
        if found is None:
            return None
        if ack.result != IN_PROGRESS:
            self._asked.remove(found)
        return PLANT_COMPONENT if found.component == PLANT_COMPONENT else FSW_COMPONENT
