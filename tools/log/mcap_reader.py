"""Reads the log of a run into numpy arrays; the log of a killed run too.

A log is read chunk by chunk and only what is asked for is kept, so that a day's log needs no day's memory. Each question
costs one pass over the file; `prefetch` answers many in one.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus.errors import RecordError
from bus.telemetry.cdr import FRAMES_SCHEMA
from bus.telemetry.events import EVENTS, FAULTS
from tools.log.mcap_records import McapContent, Stretch
from tools.log.message_index import DATA_AT, view_words
from tools.log.signal_decoder import MessageDecoder
from tools.log.topics import TopicInfo, list_topics, parse_layout

DBC_ATTACHMENT: Final = "icd.dbc"
FRAME_DTYPE: Final = np.dtype([("t_ns", "<i8"), ("id", "<u4"), ("dlc", "u1"), ("data", "u1", (8,))])
WIRE_DTYPE: Final = np.dtype([("id", "<u4"), ("dlc", "u1"), ("pad", "u1", (3,)), ("data", "u1", (8,))])
ENCAPSULATION_SIZE: Final = 4
WORD: Final = 8  # bytes
FRAMES_AT: Final = DATA_AT + ENCAPSULATION_SIZE + 12  # behind stamp and length


class LogRecord(NamedTuple):
    """One message, undecoded."""

    sequence: int
    t_ns: int
    data: bytes


class Signals(Mapping[str, NDArray[Any]]):
    """Field -> its values, shape (n,) or (n, count). A field is read when it is first asked for, all at once by items()."""

    def __init__(self, run: Run, topic: str, layout: np.dtype[Any]) -> None:
        self._run = run
        self._topic = topic
        self.layout = layout
        self.fields = tuple(name for name in layout.names or () if name != "stamp")

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self.fields:
            raise KeyError(name)
        self._run.prefetch({self._topic: (name,)})
        return self._run.cached_field(self._topic, name)

    def __iter__(self) -> Iterator[str]:
        self._run.prefetch({self._topic: self.fields})
        return iter(self.fields)

    def __contains__(self, name: object) -> bool:
        return name in self.fields

    def __len__(self) -> int:
        return len(self.fields)


class Run:
    """An opened log. Arrays are in file order, which is the order of time for the topics of one tick."""

    def __init__(self, content: McapContent) -> None:
        self._content = content
        self.path = content.path
        self.complete = content.complete  # False: the recorder was killed; see `hilsat recover`
        self.metadata: dict[str, dict[str, str]] = {record.name: dict(record.metadata) for record in content.metadata}
        self.attachments: dict[str, bytes] = {record.name: record.data for record in content.attachments}
        self.topics: dict[str, TopicInfo] = list_topics(content.channels.values(), content.schemas)
        self.lost_chunks = content.lost_chunks
        self.damage = content.damage  # what else is damaged -> how often; grows as JSON records are read
        self._count_unreadable()
        self._times: dict[str, NDArray[np.int64]] = {}
        self._fields: dict[tuple[str, str], NDArray[Any]] = {}
        self._layouts: dict[str, np.dtype[Any]] = {}

    def _count_unreadable(self) -> None:
        """Note the messages that belong to no topic: of a channel unknown, or laid out otherwise than its topic."""
        readable = {channel for info in self.topics.values() for channel in info.channels}
        for channel, tally in self._content.tallies.items():
            if channel not in self._content.channels:
                self.damage["message of a channel that is not described"] += tally.count
            elif channel not in readable:
                self.damage["message laid out otherwise than its topic"] += tally.count

    # -- what there is ---------------------------------------------------------------------------------------------

    def count(self, topic: str) -> int:
        """Number of messages of the topic."""
        tallies = self._content.tallies
        return sum(tallies[channel].count for channel in self._info(topic).channels if channel in tallies)

    def has(self, topic: str) -> bool:
        """Whether there is any message of the topic."""
        return topic in self.topics and self.count(topic) > 0

    def ticks(self, topic: str) -> NDArray[np.int64]:
        """Sequence number of every record of the topic: the tick, for what is written once a tick."""
        tallies = self._content.tallies
        found = [tallies[channel].sequences() for channel in self._info(topic).channels if channel in tallies]
        return np.concatenate(found) if found else np.empty(0, np.int64)

    def sequences(self, topic: str) -> list[int]:
        """The same as a list."""
        numbers: list[int] = self.ticks(topic).tolist()
        return numbers

    def attachment(self, name: str) -> bytes | None:
        """The attached file of exactly this name, None when there is none.

        Raises RecordError when it is damaged, or when several have the name and differ.
        """
        found = {record.data for record in self._content.attachments if record.name == name}
        if len(found) > 1:
            raise RecordError(
                f"{self.path}: {len(found)} different files called {name} are attached: which one counts?"
            )
        if not found and any(what.startswith(f"attachment {name!r}") for what in self.damage):
            raise RecordError(f"{self.path}: the attached {name} is damaged (its checksum does not match)")
        return next(iter(found), None)

    # -- signals ---------------------------------------------------------------------------------------------------

    def t_ns(self, topic: str) -> NDArray[np.int64]:
        """Log time of every record of the topic [ns]."""
        self._info(topic)
        self.prefetch({topic: ()})
        return self._times[topic]

    def signals(self, topic: str) -> Signals:
        """Field -> its values, shape (n,) or (n, count), in the unit that `topics[topic].units` states.

        Raises RecordError for a topic that has no fields of fixed size, and on reading a field of one whose records are
        not as long as its schema says.
        """
        return Signals(self, topic, self._layout(topic))

    def prefetch(self, wanted: Mapping[str, Iterable[str]]) -> None:
        """Read the times and these fields of these topics in one pass over the file, as far as they are not yet read."""
        fields = {
            topic: [name for name in dict.fromkeys(names) if (topic, name) not in self._fields]
            for topic, names in wanted.items()
        }
        missing = {topic: names for topic, names in fields.items() if names or topic not in self._times}
        if not missing:
            return
        owner = {channel: topic for topic in missing for channel in self._info(topic).channels}
        # Their length is known: filled in place, they need no second copy.
        times = {topic: np.empty(self.count(topic), np.int64) for topic in missing}
        values = {
            (topic, name): np.empty(self.count(topic), self._layout(topic)[name])
            for topic, names in missing.items()
            for name in names
        }
        at = dict.fromkeys(missing, 0)
        for stretch in self._content.stretches(owner):
            for channel, rows in stretch.table.split():
                topic = owner.get(channel)
                if topic is not None:
                    here = slice(at[topic], at[topic] + rows.size)
                    at[topic] = here.stop
                    times[topic][here] = stretch.table.log_time_ns[rows]
                    if missing[topic]:
                        for name, read in self._read_fields(topic, stretch, rows, missing[topic]):
                            values[topic, name][here] = read
        self._times |= times
        self._fields |= values

    def cached_field(self, topic: str, name: str) -> NDArray[Any]:
        """A field that was prefetched."""
        return self._fields[topic, name]

    def iterate_tables(self, topic: str) -> Iterator[tuple[NDArray[np.int64], NDArray[Any]]]:
        """Log times [ns] and all fields of a topic as a structured array, chunk by chunk; nothing is kept."""
        self._layout(topic)
        channels = self._info(topic).channels
        for stretch in self._content.stretches(channels):
            rows = np.flatnonzero(np.isin(stretch.table.channel, channels))
            if rows.size:
                yield stretch.table.log_time_ns[rows], self._gather(topic, stretch, rows)

    # -- records ---------------------------------------------------------------------------------------------------

    def iterate(self, *topics: str) -> Iterator[LogRecord]:
        """The messages of these topics, in file order, one chunk in memory at a time."""
        channels = [channel for topic in topics for channel in self._info(topic).channels]
        for stretch in self._content.stretches(channels):
            table = stretch.table
            rows = np.flatnonzero(np.isin(table.channel, channels))
            columns = (table.sequence, table.log_time_ns, table.offset, table.size)
            for sequence, t_ns, at, size in zip(*(column[rows].tolist() for column in columns), strict=True):
                yield LogRecord(sequence, t_ns, stretch.data[at + DATA_AT : at + size])

    def iterate_topics(self, *topics: str) -> Iterator[tuple[str, LogRecord]]:
        """The messages of these topics, each with its topic, in file order, one chunk in memory at a time."""
        owner = {channel: topic for topic in topics for channel in self._info(topic).channels}
        for stretch in self._content.stretches(owner):
            table, data = stretch.table, stretch.data
            columns = (table.channel, table.sequence, table.log_time_ns, table.offset, table.size)
            for channel, sequence, t_ns, at, size in zip(*(column.tolist() for column in columns), strict=True):
                topic = owner.get(channel)
                if topic is not None:
                    yield topic, LogRecord(sequence, t_ns, data[at + DATA_AT : at + size])

    def decode(self, topic: str, data: bytes) -> dict[str, Any]:
        """Field -> value of one message of a topic of signals. Raises RecordError where it is not of that layout."""
        layout = self._layout(topic)
        if len(data) != ENCAPSULATION_SIZE + layout.itemsize:
            raise RecordError(f"{self.path}: a record of {topic} has not the size that its schema says")
        row = np.frombuffer(data, layout, 1, ENCAPSULATION_SIZE)[0]
        return {name: row[name].tolist() for name in layout.names or () if name != "stamp"}

    def payloads(self, topic: str) -> list[bytes]:
        """The message data of a topic, undecoded."""
        return [record.data for record in self.iterate(topic)]

    def records(self, topic: str) -> list[dict[str, Any]]:
        """The JSON objects of a topic, each with its log time as `t_ns` [ns]. Others are counted as damage."""
        if topic not in self.topics:
            return []
        found = []
        for record in self.iterate(topic):
            try:
                data = json.loads(record.data)
            except (ValueError, RecursionError):
                data = None
            if isinstance(data, dict):
                found.append(data | {"t_ns": record.t_ns})
        if len(found) < self.count(topic):
            self.damage[f"{topic} record that is no JSON object"] = self.count(topic) - len(found)
        return found

    @cached_property
    def events(self) -> list[dict[str, Any]]:
        """Lines of /events: t_ns, level 1..5, name, message."""
        wanted = {"level": int, "name": str, "message": str}
        return self._well_formed(EVENTS.name, wanted)

    @cached_property
    def faults(self) -> list[dict[str, Any]]:
        """Onsets, ends and refusals of faults: t_ns, tick, unit, fault, phase, value, message."""
        return self._well_formed(FAULTS.name, {"tick": int, "unit": str, "fault": str, "phase": str})

    def _well_formed(self, topic: str, wanted: Mapping[str, type]) -> list[dict[str, Any]]:
        records = self.records(topic)
        good = [record for record in records if all(type(record.get(key)) is kind for key, kind in wanted.items())]
        if len(good) < len(records):
            self.damage[f"{topic} record without {', '.join(wanted)}"] = len(records) - len(good)
        return good

    # -- frames ----------------------------------------------------------------------------------------------------

    def buses(self) -> list[str]:
        """Names of the buses whose frames are in the log."""
        return [name.removeprefix("/can/") for name, info in self.topics.items() if info.schema_name == FRAMES_SCHEMA]

    def iterate_frames(self, bus: str | None = None) -> Iterator[NDArray[Any]]:
        """The frames of a bus (default: of every bus), chunk by chunk, as arrays of FRAME_DTYPE."""
        names = [
            name for name, info in self.topics.items()
            if info.schema_name == FRAMES_SCHEMA and bus in (None, name.removeprefix("/can/"))
        ]  # fmt: skip
        channels = [channel for name in names for channel in self.topics[name].channels]
        for stretch in self._content.stretches(channels):
            rows = np.flatnonzero(np.isin(stretch.table.channel, channels))
            if rows.size:
                yield _read_frames(stretch, rows)

    def frames(self, bus: str | None = None) -> NDArray[Any]:
        """All frames of a bus (default: of every bus) as a structured array: t_ns [ns], id with flags, dlc, data."""
        pieces = list(self.iterate_frames(bus))
        return np.concatenate(pieces) if pieces else np.empty(0, FRAME_DTYPE)

    def decoded(self, message: str, bus: str | None = None) -> dict[str, NDArray[Any]]:
        """Signal -> physical values of a DBC message, and `t_ns`, decoded with the icd.dbc that the log carries.

        Frames that are short are left out; checksums and counters are values like others and are not judged.
        """
        text = self.attachment(DBC_ATTACHMENT)
        if text is None:
            raise RecordError(f"{self.path}: no DBC is attached as {DBC_ATTACHMENT}, so {message} cannot be decoded")
        decoder = MessageDecoder(text.decode("utf-8", "replace"), message)
        pieces = [np.empty(0, FRAME_DTYPE), *map(decoder.select, self.iterate_frames(bus))]
        return decoder.decode(np.concatenate(pieces))

    def digest(self) -> str:
        """SHA-256 over topic, log time and data of every message of the deterministic topics, in file order."""
        names = {
            channel: info.name.encode() for info in self.topics.values() if info.deterministic
            for channel in info.channels
        }  # fmt: skip
        total = hashlib.sha256()
        update = total.update
        for stretch in self._content.stretches(names):
            view, table = memoryview(stretch.data), stretch.table
            columns = (table.channel, table.log_time_ns, table.offset, table.size)
            for channel, t, at, size in zip(*(column.tolist() for column in columns), strict=True):
                name = names.get(channel)
                if name is not None:
                    update(b"%b\0%d\0%d\0" % (name, t, size))
                    update(view[at + DATA_AT : at + size])
        return total.hexdigest()

    # -- layouts ---------------------------------------------------------------------------------------------------

    def _info(self, topic: str) -> TopicInfo:
        info = self.topics.get(topic)
        if info is None:
            raise RecordError(f"{self.path}: there is no topic {topic}; there are: {', '.join(sorted(self.topics))}")
        return info

    def _layout(self, topic: str) -> np.dtype[Any]:
        if topic not in self._layouts:
            info = self._info(topic)
            if info.encoding != "cdr":
                raise RecordError(f"{self.path}: {topic} is {info.encoding}, not signals; read it with records()")
            self._layouts[topic] = parse_layout(info.schema, f"{self.path}: {topic}")
        return self._layouts[topic]

    def _read_fields(
        self, topic: str, stretch: Stretch, rows: NDArray[np.int64], names: Iterable[str]
    ) -> Iterator[tuple[str, NDArray[Any]]]:
        """Each of these fields of a topic in one chunk. Numbers of eight bytes are taken one by one, others with all."""
        layout = self._check_size(topic, stretch, rows)
        starts = stretch.table.offset[rows] + DATA_AT + ENCAPSULATION_SIZE
        words, table = view_words(stretch.data), None
        for name in names:
            kind, at = layout.fields[name][:2]  # type: ignore[index]
            if kind.base.itemsize == WORD:
                steps = WORD * np.arange(math.prod(kind.shape)).reshape(kind.shape)
                yield name, words[starts.reshape(-1, *(1,) * steps.ndim) + (at + steps)].view(kind.base)
            else:
                table = self._gather(topic, stretch, rows) if table is None else table
                yield name, table[name]

    def _gather(self, topic: str, stretch: Stretch, rows: NDArray[np.int64]) -> NDArray[Any]:
        """The records of a topic in one chunk as a structured array."""
        layout = self._check_size(topic, stretch, rows)
        start = DATA_AT + ENCAPSULATION_SIZE
        data = np.frombuffer(stretch.data, np.uint8)
        where = stretch.table.offset[rows][:, None] + np.arange(start, start + layout.itemsize)
        table: NDArray[Any] = data[where].view(layout)
        return table.reshape(-1)

    def _check_size(self, topic: str, stretch: Stretch, rows: NDArray[np.int64]) -> np.dtype[Any]:
        """The layout of a topic. Raises RecordError where records of it are not as long as that says."""
        layout = self._layout(topic)
        size = DATA_AT + ENCAPSULATION_SIZE + layout.itemsize
        if (stretch.table.size[rows] != size).any():
            raise RecordError(f"{self.path}: a record of {topic} has not the {size} bytes that its schema says")
        return layout


def _read_frames(stretch: Stretch, rows: NDArray[np.int64]) -> NDArray[Any]:
    """The frames in some records of one chunk. Bytes behind the last whole frame of a record are left out."""
    table = stretch.table
    ends = (table.offset[rows] + table.size[rows]).tolist()
    starts = (table.offset[rows] + FRAMES_AT).tolist()
    counts = [max(0, end - start) // WIRE_DTYPE.itemsize for start, end in zip(starts, ends, strict=True)]
    size = WIRE_DTYPE.itemsize
    wire = np.frombuffer(
        b"".join([stretch.data[at : at + size * count] for at, count in zip(starts, counts, strict=True)]), WIRE_DTYPE
    )
    frames = np.empty(len(wire), FRAME_DTYPE)
    frames["t_ns"] = np.repeat(table.log_time_ns[rows], counts)
    for name in ("id", "dlc", "data"):
        frames[name] = wire[name]
    return frames


def read_run(path: Path | str) -> Run:
    """The log of a run, finished or not. Raises RecordError when it is no MCAP file or cannot be read."""
    return Run(McapContent(path))


__all__ = ["FRAMES_AT", "FRAME_DTYPE", "LogRecord", "Run", "TopicInfo", "parse_layout", "read_run"]
