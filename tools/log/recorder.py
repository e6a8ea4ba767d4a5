"""Merges the telemetry of several processes into one log whose content does not depend on how they were scheduled.

Ticks are filed by (tick, source). One is written once every open source has spoken of that tick or a later one; in
real time it waits 0.3 s at most. Chunks close at 512 kB or 0.5 s of wall time, so a killed run loses less than 1 s.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import struct
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus.errors import RecordError
from bus.telemetry.events import EVENTS, FAULTS, JSON_TOPICS, format_event
from bus.telemetry.link import MemoryLink
from tools.log.mcap_writer import Compression, McapWriter
from tools.log.pointing import PointingError

CHUNK_BYTES: Final = 512 * 1024
FLUSH_S: Final = 0.5
PATIENCE_S: Final = 0.3  # real time: how long a tick waits for the other process
MESSAGE: Final = struct.Struct("<BQHIQQ")
RECORDER: Final = 255  # the recorder's own lines are filed behind everybody else's


@dataclass(frozen=True, slots=True)
class RunAttachment:
    """A file that travels inside the log."""

    name: str
    media_type: str
    data: bytes


@dataclass(frozen=True, slots=True)
class RecordSummary:
    """What a finished log holds."""

    path: str
    messages: int
    bytes: int
    last_tick: int  # -1: none
    dropped: Mapping[str, int]  # ticks without room, by source
    reasons: Mapping[str, str]  # why each source ended


class _Announced(NamedTuple):
    """One row of a channel table, as the log has it."""

    channel: int
    topic: str
    schema: tuple[str, str, str]
    metadata: Mapping[str, str]


@lru_cache(maxsize=16)  # runs of one process announce the same again
def _read_announcement(source: int, topics_json: bytes) -> tuple[_Announced, ...]:
    return tuple(
        _Announced(
            row["channel"],
            row["topic"],
            (row["schema_name"], "ros2msg", row["schema"]),
            {
                "deterministic": "true" if row["deterministic"] else "false",
                "every": row["every"],
                "units": json.dumps(row["units"]),
                "source": str(source),
            },
        )
        for row in json.loads(topics_json)
    )


@dataclass(slots=True)
class _Source:
    """One process as the recorder sees it."""

    last_tick: int = -1
    last_t_ns: int = 0
    open: bool = True
    reason: str = ""
    dropped: int = 0
    json_waiting: list[tuple[str, int, bytes]] = field(default_factory=list)


class Recorder:
    """The log of one run. Use `link(source)` in process, or feed it what comes through the pipes.

    metadata, attachments : written first, so that they survive a killed run
    sources  : the numbers that will speak; 1 plant, 2 fsw
    realtime : do not wait for a silent source for more than 0.3 s
    Raises RecordError when the file cannot be written; what is in it stays readable.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        metadata: Mapping[str, str],
        attachments: Sequence[RunAttachment] = (),
        sources: Sequence[int] = (1, 2),
        realtime: bool = False,
        compression: Compression = "zstd",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._writer = McapWriter(path, compression=compression)
        self._pointing = PointingError()
        self._writer.complete = self._pointing.fill
        self._sources = {source: _Source() for source in sources}
        self._realtime = realtime
        self._clock = clock
        self._deadline = clock() + FLUSH_S
        # Two lists instead of one of tuples: nothing here for the garbage collector to visit.
        self._keys: list[int] = []  # tick << 8 | source, the order of the file
        self._held: list[bytes] = []
        self._held_bytes = 0
        self._limit_bytes = CHUNK_BYTES
        self._mark = (-1, clock())  # real time: the newest tick at that moment, due PATIENCE_S later
        self._failure: RecordError | None = None
        with self._writing():
            self._writer.add_metadata("run", metadata)
            for attachment in attachments:
                self._writer.add_attachment(attachment.name, attachment.media_type, attachment.data)
            for topic in (EVENTS, FAULTS):
                self._declare_json(topic.name)

    def link(self, source: int) -> MemoryLink:
        """The end that a process in memory writes to."""
        return MemoryLink(self, source)

    # -- what sources say ------------------------------------------------------------------------------------------

    def announce(self, source: int, topics_json: bytes) -> None:
        """Take the channel table of one source; see bus.telemetry.link.announce_topics."""
        with self._writing():
            for row in _read_announcement(source, topics_json):
                self._pointing.learn(row.channel, row.topic, row.schema[2])
                self._writer.add_channel(row.channel, row.topic, "cdr", row.schema, row.metadata)

    def write_ticks(self, source: int, ticks: list[int], t_ns: int, records: list[bytes]) -> None:
        """Take the Message records of some ticks of one source, t_ns being the time of the last."""
        state = self._sources[source]
        state.last_tick = ticks[-1]
        state.last_t_ns = t_ns
        self._keys += [tick << 8 | source for tick in ticks]
        self._held += records
        self._held_bytes += sum(map(len, records))
        if state.json_waiting:
            self._file_json(source, state, ticks[0])
        if self._held_bytes >= self._limit_bytes or self._clock() >= self._deadline:
            self.flush()

    def write_json(self, source: int, topic: str, t_ns: int, payload: bytes) -> None:
        """Take one JSON object; it is filed behind the source's next tick."""
        self._sources[source].json_waiting.append((topic, t_ns, payload))

    def end_source(self, source: int, reason: str, dropped: int = 0) -> None:
        """A source has closed its link, or is gone."""
        state = self._sources[source]
        if state.open:
            state.open = False
            state.reason = reason
            state.dropped = dropped
            # One tick on: nothing of that tick can be in the file yet, so its place does not depend on timing.
            self._file_json(source, state, state.last_tick + 1)

    # -- what goes into the file -----------------------------------------------------------------------------------

    def flush(self) -> None:
        """Write what is complete. Raises RecordError when it cannot be written."""
        now = self._clock()
        self._deadline = now + FLUSH_S
        if not self._held:
            return
        keys = np.fromiter(self._keys, np.int64, len(self._keys))
        order = np.argsort(keys, kind="stable")  # arrivals of one key keep theirs
        keys = keys[order]
        count = self._count_complete(keys, now)
        if count:
            held, places = self._held, order.tolist()
            with self._writing():
                self._write_out([held[place] for place in places[:count]], keys[:count] >> 8)
            self._keys, self._held = keys[count:].tolist(), [held[place] for place in places[count:]]
            self._held_bytes = sum(map(len, self._held))
        self._limit_bytes = self._held_bytes + CHUNK_BYTES

    def poll(self) -> float:
        """Flush when it is time to; seconds until the next time."""
        left = self._deadline - self._clock()
        if left > 0.0:
            return left
        self.flush()
        return FLUSH_S

    def _count_complete(self, keys: NDArray[np.int64], now: float) -> int:
        """How many held entries nothing can be filed before any more, of all by key, rising."""
        heads = [state.last_tick for state in self._sources.values() if state.open]
        if not heads:
            return len(keys)
        horizon = min(heads)
        if self._realtime:
            newest, since = self._mark
            if now >= since + PATIENCE_S:
                horizon = max(horizon, newest)
                self._mark = (max(heads), now)
            if max(heads) > horizon:
                self._deadline = min(self._deadline, now + PATIENCE_S)
        return int(np.searchsorted(keys, (horizon + 1) << 8))

    def _write_out(self, parts: list[bytes], ticks: NDArray[np.int64]) -> None:
        """Write chunks of about CHUNK_BYTES and of whole ticks, without a small one at the end."""
        ends = np.cumsum(np.fromiter(map(len, parts), np.int64, len(parts)))
        pieces = max(1, int(ends[-1]) // CHUNK_BYTES)
        cuts = np.searchsorted(ends, ends[-1] * np.arange(1, pieces) / pieces) + 1
        whole = np.searchsorted(ticks, ticks[np.minimum(cuts, len(ticks) - 1)])
        for start, end in itertools.pairwise((0, *whole.tolist(), len(parts))):
            if end > start:
                self._writer.write_chunk(parts[start:end])

    def _file_json(self, source: int, state: _Source, tick: int) -> None:
        """File the waiting JSON objects at a tick of the source, behind what it has there already."""
        for topic, t_ns, payload in state.json_waiting:
            self._declare_json(topic)
            channel = JSON_TOPICS[topic].channel
            record = MESSAGE.pack(5, 22 + len(payload), channel, tick & 0xFFFFFFFF, t_ns, t_ns) + payload
            self._keys.append(tick << 8 | source)
            self._held.append(record)
            self._held_bytes += len(record)
        state.json_waiting.clear()

    def _declare_json(self, name: str) -> None:
        topic = JSON_TOPICS.get(name)
        if topic is None:
            raise RecordError(f"there is no JSON topic {name}; there are: {', '.join(JSON_TOPICS)}")
        if not self._writer.has_channel(topic.channel):
            schema = (topic.schema_name, "jsonschema", topic.json_schema())
            with self._writing():
                self._writer.add_channel(topic.channel, name, "json", schema, {"deterministic": "true"})

    def report(self, level: str, message: str) -> None:
        """Log a line of the recorder's own on /events."""
        last_tick = max(source.last_tick for source in self._sources.values())
        t_ns = max(source.last_t_ns for source in self._sources.values())
        state = _Source(json_waiting=[(EVENTS.name, t_ns, format_event(t_ns, level, "recorder", message))])
        self._file_json(RECORDER, state, last_tick + 1)

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file now, behind what has been flushed."""
        with self._writing():
            self._writer.add_attachment(name, media_type, data)

    def close(self) -> RecordSummary:
        """Write everything that is held, and the summary. After a failed write: only say what the file holds.

        Raises RecordError when the writing fails here.
        """
        for source, state in self._sources.items():
            if state.open:
                self.end_source(source, "the recorder was closed")
        if self._failure is None:
            self.flush()
            summary = self._sum_up()
            values = {f"dropped_ticks_{source}": str(count) for source, count in summary.dropped.items()}
            values |= {f"ended_{source}": reason for source, reason in summary.reasons.items()}
            with self._writing():
                self._writer.add_metadata("recording", {**values, "messages": str(summary.messages)})
                self._writer.close()
        return self._sum_up()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Everything that touches the file: the first failure ends the file as well as it can be, and is repeated."""
        if self._failure is not None:
            raise self._failure
        try:
            yield
        except RecordError as error:
            self._failure = error
            self._writer.abandon()
            raise

    def _sum_up(self) -> RecordSummary:
        return RecordSummary(
            path=str(self._writer.path),
            messages=self._writer.message_count,
            bytes=self._writer.size,
            last_tick=max((source.last_tick for source in self._sources.values()), default=-1),
            dropped={str(number): source.dropped for number, source in self._sources.items()},
            reasons={str(number): source.reason for number, source in self._sources.items()},
        )
