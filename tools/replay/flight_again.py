"""The real flight software, flown on recorded inputs."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Final

from bus.clock import SystemClock
from bus.telemetry.link import Link, PackRows, Row
from fsw.config import FswConfig
from fsw.flight import Flight
from fsw.flight_log import SAFE_ASKED, SHEDDING
from fsw.node import FswNode
from tools.log.message_index import DATA_AT, walk_messages
from tools.replay.inputs import CycleInput

CATCH_UP: Final = "catch_up"


@dataclass(frozen=True, slots=True)
class Cycle:
    """What one cycle said: its frames, and its records by topic."""

    frames: bytes
    records: dict[str, bytes]


class _Keeper(Link):
    """Keeps the records of the last cycle."""

    def __init__(self) -> None:
        super().__init__(hold_ticks=1)
        self.topics: dict[int, str] = {}
        self.schemas: dict[str, str] = {}
        self.last = b""

    def announce(self, topics_json: bytes, pack_rows: PackRows | None = None) -> None:
        super().announce(topics_json, pack_rows)
        for row in json.loads(topics_json):
            if row["deterministic"]:
                self.topics[row["channel"]] = row["topic"]
                self.schemas[row["topic"]] = row["schema"]

    def _write_ticks(self, rows: list[Row], records: list[bytes]) -> None:
        self.last = records[-1]

    def write_json(self, topic: str, t_ns: int, payload: bytes) -> None:
        """Words are not compared."""


class FlightAgain:
    """Flight software at boot, fed cycle by cycle. `schemas`: the layout of each topic of it that can be compared."""

    def __init__(self, config: FswConfig, tick_ns: int, run_hash: int) -> None:
        """Raises ConfigError where the settings cannot be flown with."""
        self.flight = Flight(config, tick_ns * 1e-9, run_hash)
        self._keeper = _Keeper()
        self._node = FswNode(self.flight, self._keeper, tick_ns, SystemClock())
        self._catches_up = config.executive.overrun == CATCH_UP
        self._next_tick = 0
        self._answer = b""
        self.schemas = self._keeper.schemas

    def cycle(self, given: CycleInput) -> Cycle:
        """Run the cycle that had this input. What its executive had counted is part of the input."""
        counters = self.flight.executive
        missed = given.slips - counters.slips
        counters.slips = given.slips
        if self._catches_up:
            counters.caught_up += missed
        counters.skipped += given.tick - self._next_tick
        self._next_tick = given.tick + 1
        for command in given.commands:
            self._node.commands.add(command)
        self._node.tick(
            given.tick, given.frames, self._take, bool(given.flags & SAFE_ASKED), bool(given.flags & SHEDDING)
        )
        self._keeper.flush()
        table = walk_messages(self._keeper.last).table
        data, topics = self._keeper.last, self._keeper.topics
        places = zip(table.channel.tolist(), table.offset.tolist(), table.size.tolist(), strict=True)
        records = {topics[c]: data[at + DATA_AT : at + size] for c, at, size in places if c in topics}
        return Cycle(self._answer, records)

    def _take(self, frames: bytes) -> None:
        self._answer = frames
