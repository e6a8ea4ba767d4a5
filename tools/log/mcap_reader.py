"""Reads the log of a run into numpy arrays, whole topics at a time; the log of a killed run too."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bus.errors import RecordError
from bus.telemetry.cdr import FRAMES_SCHEMA
from bus.telemetry.events import EVENTS, FAULTS
from tools.log.layout import parse_layout
from tools.log.mcap_records import McapContent, read_content
from tools.log.message_index import DATA_AT
from tools.log.signal_decoder import decode_frames

FRAME_DTYPE: Final = np.dtype([("t_ns", "<i8"), ("id", "<u4"), ("dlc", "u1"), ("data", "u1", (8,))])
WIRE_DTYPE: Final = np.dtype([("id", "<u4"), ("dlc", "u1"), ("pad", "u1", (3,)), ("data", "u1", (8,))])
SEQUENCE_AT: Final = 11
ENCAPSULATION_SIZE: Final = 4
FRAMES_AT: Final = DATA_AT + ENCAPSULATION_SIZE + 12  # behind stamp and length


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic of a log."""

    name: str
    channels: tuple[int, ...]
    encoding: str
    schema_name: str
    schema: str
    deterministic: bool
    units: Mapping[str, str]


class Run:
    """An opened log. Arrays are in file order, which is the order of time for the topics of one tick."""

    def __init__(self, content: McapContent) -> None:
        self._content = content
        self.path = content.path
        self.complete = content.complete  # False: the recorder was killed; see `hilsat recover`
        self.metadata: dict[str, dict[str, str]] = {record.name: dict(record.metadata) for record in content.metadata}
        self.attachments: dict[str, bytes] = {record.name: record.data for record in content.attachments}
        self.topics: dict[str, TopicInfo] = _list_topics(content)
        self._signals: dict[str, dict[str, NDArray[Any]]] = {}
        # (index of the stretch, which of its messages) for every channel
        self._rows: dict[int, list[tuple[int, NDArray[np.int64]]]] = {}
        for number, stretch in enumerate(content.stretches):
            channels = stretch.table.channel
            for channel in np.unique(channels).tolist():
                self._rows.setdefault(channel, []).append((number, np.flatnonzero(channels == channel)))

    def has(self, topic: str) -> bool:
        """Whether there is any message of the topic."""
        return topic in self.topics and self.t_ns(topic).size > 0

    def t_ns(self, topic: str) -> NDArray[np.int64]:
        """Log time of every record of the topic [ns]."""
        stretches = self._content.stretches
        pieces = [stretches[number].table.log_time_ns[rows] for number, rows in self._find_rows(topic)]
        return np.concatenate(pieces) if pieces else np.empty(0, np.int64)

    def signals(self, topic: str) -> dict[str, NDArray[Any]]:
        """Field -> its values, shape (n,) or (n, count), in the unit that `topics[topic].units` states."""
        if topic not in self._signals:
            info = self._info(topic)
            if info.encoding != "cdr":
                raise RecordError(f"{self.path}: {topic} is {info.encoding}, not signals; read it with records()")
            dtype = parse_layout(info.schema, f"{self.path}: {topic}")
            size = DATA_AT + ENCAPSULATION_SIZE + dtype.itemsize
            rows = self._gather(topic, size)
            table = np.ascontiguousarray(rows[:, DATA_AT + ENCAPSULATION_SIZE :]).view(dtype).reshape(-1)
            self._signals[topic] = {name: table[name] for name in dtype.names or () if name != "stamp"}
        return self._signals[topic]

    def records(self, topic: str) -> list[dict[str, Any]]:
        """The JSON objects of a topic, each with its log time as `t_ns` [ns]."""
        if topic not in self.topics:
            return []
        payloads = self.payloads(topic)
        return [{"t_ns": int(t)} | json.loads(data) for t, data in zip(self.t_ns(topic), payloads, strict=True)]

    @cached_property
    def events(self) -> list[dict[str, Any]]:
        """Lines of /events: t_ns, level 1..5, name, message."""
        return self.records(EVENTS.name)

    @cached_property
    def faults(self) -> list[dict[str, Any]]:
        """Onsets, ends and refusals of faults: t_ns, tick, unit, fault, phase, value, message."""
        return self.records(FAULTS.name)

    def payloads(self, topic: str) -> list[bytes]:
        """The message data of a topic, undecoded."""
        found = []
        for number, rows in self._find_rows(topic):
            stretch = self._content.stretches[number]
            offsets, sizes = stretch.table.offset[rows].tolist(), stretch.table.size[rows].tolist()
            found += [stretch.data[at + DATA_AT : at + size] for at, size in zip(offsets, sizes, strict=True)]
        return found

    def sequences(self, topic: str) -> list[int]:
        """Sequence number of every record of the topic: the tick, for what is written once a tick."""
        found = []
        for number, rows in self._find_rows(topic):
            stretch = self._content.stretches[number]
            at = [offset + SEQUENCE_AT for offset in stretch.table.offset[rows].tolist()]
            found += [int.from_bytes(stretch.data[start : start + 4], "little") for start in at]
        return found

    def frames(self, bus: str | None = None) -> NDArray[Any]:
        """All frames of a bus (default: of every bus) as a structured array: t_ns [ns], id with flags, dlc, data."""
        pieces: list[NDArray[Any]] = []
        for topic, info in self.topics.items():
            if info.schema_name == FRAMES_SCHEMA and bus in (None, topic.removeprefix("/can/")):
                payloads = self.payloads(topic)
                raw = b"".join(payload[FRAMES_AT - DATA_AT :] for payload in payloads)
                wire = np.frombuffer(raw, WIRE_DTYPE)
                counts = [(len(payload) - (FRAMES_AT - DATA_AT)) // WIRE_DTYPE.itemsize for payload in payloads]
                frames = np.empty(len(wire), FRAME_DTYPE)
                frames["t_ns"] = np.repeat(self.t_ns(topic), counts)
                for name in ("id", "dlc", "data"):
                    frames[name] = wire[name]
                pieces.append(frames)
        return np.concatenate(pieces) if pieces else np.empty(0, FRAME_DTYPE)

    def decoded(self, message: str, bus: str | None = None) -> dict[str, NDArray[Any]]:
        """Signal -> physical values of a DBC message, and `t_ns`, decoded with the DBC that the log carries.

        Frames that are short are left out; checksums and counters are values like others and are not judged.
        """
        text = next((data for name, data in self.attachments.items() if name.endswith(".dbc")), None)
        if text is None:
            raise RecordError(f"{self.path}: no DBC is attached, so {message} cannot be decoded")
        return decode_frames(text.decode(), message, self.frames(bus))

    def digest(self) -> str:
        """SHA-256 over topic, log time and data of every message of the deterministic topics, in file order."""
        names = {
            channel: info.name.encode() for info in self.topics.values() if info.deterministic
            for channel in info.channels
        }  # fmt: skip
        total = hashlib.sha256()
        update = total.update
        for stretch in self._content.stretches:
            view = memoryview(stretch.data)
            for channel, t, at, size in zip(*(column.tolist() for column in stretch.table), strict=True):
                name = names.get(channel)
                if name is not None:
                    update(b"%b\0%d\0%d\0" % (name, t, size))
                    update(view[at + DATA_AT : at + size])
        return total.hexdigest()

    # -- finding ---------------------------------------------------------------------------------------------------

    def _info(self, topic: str) -> TopicInfo:
        info = self.topics.get(topic)
        if info is None:
            raise RecordError(f"{self.path}: there is no topic {topic}; there are: {', '.join(sorted(self.topics))}")
        return info

    def _find_rows(self, topic: str) -> list[tuple[int, NDArray[np.int64]]]:
        channels = self._info(topic).channels
        found = [entry for channel in channels for entry in self._rows.get(channel, [])]
        return sorted(found, key=lambda entry: entry[0]) if len(channels) > 1 else found

    def _gather(self, topic: str, size: int) -> NDArray[np.uint8]:
        """The records of a topic of fixed size as rows of bytes."""
        pieces = [np.empty((0, size), np.uint8)]
        for number, rows in self._find_rows(topic):
            stretch = self._content.stretches[number]
            if (stretch.table.size[rows] != size).any():
                raise RecordError(f"{self.path}: a record of {topic} has not the {size} bytes that its schema says")
            data = np.frombuffer(stretch.data, np.uint8)
            pieces.append(data[stretch.table.offset[rows][:, None] + np.arange(size)])
        return np.concatenate(pieces)


def read_run(path: Path | str) -> Run:
    """The log of a run, finished or not. Raises RecordError when it is no MCAP file or cannot be read."""
    return Run(read_content(path))


def _list_topics(content: McapContent) -> dict[str, TopicInfo]:
    topics: dict[str, TopicInfo] = {}
    for channel in content.channels.values():
        schema = content.schemas.get(channel.schema_id)
        before = topics.get(channel.topic)
        topics[channel.topic] = TopicInfo(
            name=channel.topic,
            channels=(*(before.channels if before else ()), channel.id),
            encoding=channel.message_encoding,
            schema_name=schema.name if schema else "",
            schema=schema.data.decode() if schema else "",
            deterministic=channel.metadata.get("deterministic") != "false",
            units=json.loads(channel.metadata.get("units", "{}")),
        )
    return topics
