"""Feeds flight software at boot with recorded inputs, cycle by cycle; in this process, or in one of its own.

Imports nothing but the flight software and what it stands on: `child.py` runs this very file in another process, where they
may be those of another version.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, Final

from bus.clock import SystemClock
from bus.commands import Command
from bus.telemetry.link import Link, PackRows, Row
from fsw.config import FswConfig
from fsw.flight import Flight
from fsw.flight_log import SAFE_ASKED, SHEDDING
from fsw.node import FswNode

CATCH_UP: Final = "catch_up"


class _Keeper(Link):
    """Keeps the records of the last cycle."""

    def __init__(self) -> None:
        super().__init__(hold_ticks=1)
        self.topics: list[dict[str, Any]] = []
        self.last = b""

    def announce(self, topics_json: bytes, pack_rows: PackRows | None = None) -> None:
        super().announce(topics_json, pack_rows)
        self.topics += [row for row in json.loads(topics_json) if row["deterministic"]]

    def _write_ticks(self, rows: list[Row], records: list[bytes]) -> None:
        self.last = records[-1]

    def write_json(self, topic: str, t_ns: int, payload: bytes) -> None:
        """Words are not compared."""


class Feeder:
    """Flight software at boot. `topics`: what it announces of each topic that can be compared."""

    def __init__(self, config: FswConfig, tick_ns: int, run_hash: int) -> None:
        """Raises ConfigError where the settings cannot be flown with."""
        self.flight = Flight(config, tick_ns * 1e-9, run_hash)
        self._keeper = _Keeper()
        self._node = FswNode(self.flight, self._keeper, tick_ns, SystemClock())
        self._catches_up = config.executive.overrun == CATCH_UP
        self._next_tick = 0
        self._answer = b""
        self.topics = self._keeper.topics

    @property
    def mode(self) -> str:
        """In words."""
        return self.flight.modes.mode.name.lower()

    def feed(
        self, tick: int, slips: int, flags: int, commands: Sequence[Command], frames: bytes
    ) -> tuple[bytes, bytes]:
        """Run a cycle; return the frames that it sends and its Message records.

        What its executive had counted is part of the input.
        """
        counters = self.flight.executive
        missed = slips - counters.slips
        counters.slips = slips
        if self._catches_up:
            counters.caught_up += missed
        counters.skipped += tick - self._next_tick
        self._next_tick = tick + 1
        for command in commands:
            self._node.commands.add(command)
        self._node.tick(tick, frames, self._take, bool(flags & SAFE_ASKED), bool(flags & SHEDDING))
        self._keeper.flush()
        return self._answer, self._keeper.last

    def _take(self, frames: bytes) -> None:
        self._answer = frames
