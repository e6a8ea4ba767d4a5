"""A run without a log: of all that it says only the signals that somebody will ask for are kept, as arrays.

It can be graded as a log can, and gives the same verdicts to the bit. No file is made, compressed, or read back.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from bus.errors import RecordError
from bus.telemetry.events import EVENTS, FAULTS
from bus.telemetry.link import MemoryLink
from bus.units import DEG
from tools.log.mcap_reader import Run
from tools.log.message_index import CHANNEL_AT, DATA_AT, LayoutIndex
from tools.log.pointing import FLIGHT, TRUTH, angles_between
from tools.log.topics import TopicInfo, parse_layout

CHUNK_BYTES: Final = 1 << 20
BODY_AT: Final = DATA_AT + 4  # of a record: behind its head and the CDR encapsulation
ERROR: Final = "error_deg"  # of the truth: made here of the two that follow
ATTITUDE, TARGET = "q_ib", "q_it"
FIXED: Final = (  # what grading asks for whatever the scenario expects
    ("/fsw/executive", "rivals"), ("/fsw/executive", "slips"), ("/fsw/executive", "shed"), ("/plant/channel", "rivals"),
)  # fmt: skip
Arrays = list[NDArray[Any]]


class _Channel:
    """One channel: its topic, what is kept of its records, and what was kept so far."""

    def __init__(self, info: TopicInfo, fields: Mapping[str, tuple[int, np.dtype[Any]]]) -> None:
        self.info = info
        self.fields = fields
        self.places = {name: np.arange(at, at + kind.itemsize) for name, (at, kind) in fields.items()}
        self.times: Arrays = []
        self.ticks: Arrays = []
        self.values: dict[str, Arrays] = {name: [] for name in fields}

    def take(self, data: NDArray[np.uint8], words: NDArray[np.uint64], pairs: NDArray[np.uint64]) -> None:
        """Keep of the messages at these places (log time, offset) what is wanted."""
        offsets = pairs[:, 1].astype(np.int64)
        self.times.append(pairs[:, 0].astype(np.int64))
        self.ticks.append((words[offsets + CHANNEL_AT] >> np.uint64(32)).astype(np.int64))
        for name, (_, kind) in self.fields.items():
            found = data[offsets[:, None] + self.places[name]].view(kind.base)
            self.values[name].append(found.reshape(-1, *kind.shape))


class Keeper:
    """Takes the telemetry of both sides in place of a recorder, and keeps what is wanted of it."""

    def __init__(self, wanted: Iterable[tuple[str, str]]) -> None:
        """wanted: topic and field of every signal to be kept."""
        self._wanted: dict[str, set[str]] = {}
        for topic, field in (*FIXED, *wanted):
            self._wanted.setdefault(topic, set()).add(field)
        if ERROR in self._wanted.get(TRUTH, ()):
            self._wanted[TRUTH] |= {ATTITUDE}
            self._wanted.setdefault(FLIGHT, set()).add(TARGET)
        self._channels: dict[int, _Channel] = {}
        self._json: dict[str, list[tuple[int, bytes]]] = {EVENTS.name: [], FAULTS.name: []}
        self._parts: list[bytes] = []
        self._size = 0
        self._index = LayoutIndex()

    def link(self, source: int) -> MemoryLink:
        """The end that a side writes to."""
        return MemoryLink(self, source)

    def announce(self, source: int, topics_json: bytes) -> None:
        """Take the channel table of one side."""
        for channel, info in _read_table(source, topics_json):
            if channel in self._channels:
                continue
            wanted = self._wanted.get(info.name)
            fields = _locate(info.schema, info.name) if wanted else {}
            kept = {name: fields[name] for name in sorted(wanted or ()) if name in fields}
            self._channels[channel] = _Channel(info, kept)

    def write_ticks(self, source: int, ticks: list[int], t_ns: int, records: list[bytes]) -> None:
        """Take the Message records of some ticks of one side."""
        self._parts += records
        self._size += sum(map(len, records))
        if self._size >= CHUNK_BYTES:
            self._sift()

    def write_json(self, source: int, topic: str, t_ns: int, payload: bytes) -> None:
        """Take one JSON object."""
        self._json.setdefault(topic, []).append((t_ns, payload))

    def end_source(self, source: int, reason: str, dropped: int) -> None:
        """One side has said all."""

    def _sift(self) -> None:
        """Keep what is wanted of the records at hand, and let them go."""
        data = b"".join(self._parts)
        if data:
            words = np.ndarray(len(data) - 7, "<u8", data, 0, (1,))
            view = np.frombuffer(data, np.uint8)
            for channel, pairs in self._index.locate(self._parts, data).pairs.items():
                self._channels[channel].take(view, words, pairs)
        self._parts, self._size = [], 0

    def finish(self, name: str) -> KeptRun:
        """The run as it was, for reading. name: what it is called in messages."""
        self._sift()
        return KeptRun(name, list(self._channels.values()), self._json)


class KeptRun(Run):
    """A run of which some signals were kept. Others are there by name, and cannot be read."""

    def __init__(self, name: str, channels: list[_Channel], json_records: dict[str, list[tuple[int, bytes]]]) -> None:
        self.path = Path(name)
        self.complete = True
        self.metadata = {}
        self.attachments = {}
        self.lost_chunks = []
        self.damage = Counter()
        self.topics = {channel.info.name: channel.info for channel in channels}
        self._json = json_records
        for topic in json_records:
            self.topics[topic] = TopicInfo(topic, (), "json", "", "", True, {})
        self._layouts: dict[str, np.dtype[Any]] = {}
        self._times = {channel.info.name: _join(channel.times) for channel in channels}
        self._ticks = {channel.info.name: _join(channel.ticks) for channel in channels}
        self._fields = {
            (channel.info.name, field): np.concatenate(pieces) if pieces else np.empty((0, *kind.shape), kind.base)
            for channel in channels
            for field, (_, kind) in channel.fields.items()
            for pieces in (channel.values[field],)
        }
        if (TRUTH, ERROR) in self._fields and (FLIGHT, TARGET) in self._fields:
            self._fields[TRUTH, ERROR] = self._point()

    def _point(self) -> NDArray[np.float64]:
        """The true pointing error [deg] of every tick: NaN before there is a target; as tools/log/pointing.py has it."""
        targets, attitudes = self._fields[FLIGHT, TARGET], self._fields[TRUTH, ATTITUDE]
        which = np.searchsorted(self._times[FLIGHT], self._times[TRUTH], side="right") - 1
        errors = np.full(len(attitudes), np.nan)
        known = which >= 0
        errors[known] = angles_between(targets[which[known]], attitudes[known]) / DEG
        return errors

    def count(self, topic: str) -> int:
        """Number of messages of the topic."""
        self._info(topic)
        return len(self._json[topic]) if topic in self._json else len(self._times[topic])

    def ticks(self, topic: str) -> NDArray[np.int64]:
        """The tick of every record of the topic."""
        self._info(topic)
        return self._ticks.get(topic, np.empty(0, np.int64))

    def attachment(self, name: str) -> bytes | None:
        """Nothing is attached."""
        return None

    def prefetch(self, wanted: Mapping[str, Iterable[str]]) -> None:
        """See that these fields are there. Raises RecordError for one that was not kept."""
        for topic, names in wanted.items():
            self._info(topic)
            for name in names:
                if (topic, name) not in self._fields:
                    raise RecordError(f"{self.path}: {topic} {name} was not kept")

    def records(self, topic: str) -> list[dict[str, Any]]:
        """The JSON objects of a topic, each with its time as `t_ns` [ns]."""
        return [json.loads(payload) | {"t_ns": t_ns} for t_ns, payload in self._json.get(topic, ())]


def _join(pieces: Arrays) -> NDArray[np.int64]:
    return np.concatenate(pieces) if pieces else np.empty(0, np.int64)


@lru_cache(maxsize=64)  # runs of one process announce the same again
def _read_table(source: int, topics_json: bytes) -> tuple[tuple[int, TopicInfo], ...]:
    return tuple(
        (
            row["channel"],
            TopicInfo(
                row["topic"], (row["channel"],), "cdr", row["schema_name"], row["schema"], row["deterministic"],
                row["units"], str(source), row["every"],
            ),
        )
        for row in json.loads(topics_json)
    )  # fmt: skip


@lru_cache(maxsize=256)
def _locate(schema: str, topic: str) -> Mapping[str, tuple[int, np.dtype[Any]]]:
    """Where each field begins in a record, and its kind; nothing for a topic that has no fields of fixed size."""
    try:
        fields = cast(Any, parse_layout(schema, topic).fields)
    except RecordError:
        return {}
    return {name: (BODY_AT + at, kind) for name, (kind, at, *_) in fields.items()}
