"""The real flight software, flown on recorded inputs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

from bus.telemetry.packing import PREFIX
from fsw.config import FswConfig
from tools.log.message_index import DATA_AT, RECORD_HEAD
from tools.replay.feeder import Feeder
from tools.replay.inputs import CycleInput


@dataclass(frozen=True, slots=True)
class Cycle:
    """What one cycle said: its frames, and its records by topic."""

    frames: bytes
    records: dict[str, bytes]


class Flown(Protocol):
    """Flight software that takes recorded inputs, wherever it runs."""

    schemas: Mapping[str, str]  # the layout of each topic of it that can be compared

    @property
    def mode(self) -> str:
        """Its mode after the last cycle, in words."""
        ...

    def cycle(self, given: CycleInput) -> Cycle:
        """Run the cycle that had this input."""
        ...


class FlightAgain:
    """Flight software of this version in this process, at boot."""

    def __init__(self, config: FswConfig, tick_ns: int, run_hash: int) -> None:
        """Raises ConfigError where the settings cannot be flown with."""
        self.feeder = Feeder(config, tick_ns, run_hash)
        self._sorter = RecordSorter(self.feeder.topics)
        self.schemas: Mapping[str, str] = self._sorter.schemas

    @property
    def mode(self) -> str:
        return self.feeder.mode

    def cycle(self, given: CycleInput) -> Cycle:
        frames, records = self.feeder.feed(given.tick, given.slips, given.flags, given.commands, given.frames)
        return Cycle(frames, self._sorter.sort(records))


class RecordSorter:
    """Tells the records of a cycle apart. `schemas`: topic -> layout, of those that can be compared."""

    def __init__(self, topics: Iterable[Mapping[str, Any]]) -> None:
        """topics: as the flight software announces them."""
        rows = list(topics)
        self.schemas: Final = {str(row["topic"]): str(row["schema"]) for row in rows}
        self._names = {int(row["channel"]): str(row["topic"]) for row in rows}

    def sort(self, data: bytes) -> dict[str, bytes]:
        """Topic -> message data, of Message records that lie end to end."""
        found: dict[str, bytes] = {}
        names, at, end, unpack = self._names, 0, len(data), PREFIX.unpack_from
        while at < end:
            _, size, channel = unpack(data, at)
            after = at + RECORD_HEAD + size
            if channel in names:
                found[names[channel]] = data[at + DATA_AT : after]
            at = after
        return found
