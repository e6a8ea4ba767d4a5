"""The real flight software, flown on recorded inputs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

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
        self._feeder = Feeder(config, tick_ns, run_hash)
        self._sorter = RecordSorter(self._feeder.topics)
        self.schemas: Mapping[str, str] = self._sorter.schemas

    @property
    def mode(self) -> str:
        return self._feeder.mode

    def cycle(self, given: CycleInput) -> Cycle:
        frames, records = self._feeder.feed(given.tick, given.slips, given.flags, given.commands, given.frames)
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
        names, at, end = self._names, 0, len(data)
        while at + DATA_AT <= end:
            size = RECORD_HEAD + int.from_bytes(data[at + 1 : at + RECORD_HEAD], "little")
            name = names.get(data[at + 9] | data[at + 10] << 8)
            if name is not None:
                found[name] = data[at + DATA_AT : at + size]
            at += size
        return found
