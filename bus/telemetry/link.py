"""Telemetry of a running process: packed here, written to the recorder process or to one in memory.

A tick's records are complete MCAP Message records (MCAP 1.0, opcode 0x05) from the start, so that nobody downstream
takes them apart again. In the tick itself a process only notes a row, what its records are made of; rows become records
many at a time, which costs half as much (docs/decisions/0003). What a process says is a stream of pieces, each behind
one HEADER:

    ANNOUNCE  the channel table as JSON, first
    TICK      the Message records of one tick
    JSON      topic name, zero byte, one JSON object; belongs to the tick that is written next
    CLOSE     a JSON object: why the stream ends, and how many ticks found no room
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import operator
import os
import select
import struct
import time
from collections.abc import Callable, Sequence
from typing import Any, Final, Protocol

from mypy_extensions import mypyc_attr

from bus.errors import RecordError
from bus.telemetry.cdr import (
    FRAMES_SCHEMA,
    FRAMES_TEXT,
    INPUT_SCHEMA,
    INPUT_TEXT,
    Field,
    Kind,
    Topic,
)
from bus.telemetry.events import EVENTS, FAULTS, TF, format_event, format_fault, format_transform
from bus.telemetry.packing import TickPacker, pack_frames, pack_frames_stamped, pack_input, stamp
from bus.units import Vec3, Vec4

__all__ = [
    "ANNOUNCE", "CLOSE", "HEADER", "JSON", "MAGIC", "TICK", "Field", "Kind", "Link", "MemoryLink", "Row",
    "TelemetryLink", "TickPacker", "Topic", "announce_topics", "pack_frames", "pack_frames_stamped", "pack_input", "stamp",
]  # fmt: skip

HEADER: Final = struct.Struct("<HBBIqq")  # MAGIC, kind, source, bytes that follow, tick, t_ns
MAGIC: Final = 0x4D54
ANNOUNCE, TICK, JSON, CLOSE = 1, 2, 3, 4

PIPE_BYTES: Final = 1 << 20  # the largest that an unprivileged process may ask for; about 8 s of a 100 Hz run
STALL_S: Final = 5.0  # how long a blocking writer waits for the recorder
HOLD_TICKS: Final = 64  # rows that a process that may wait keeps at most before it packs them,
HOLD_S: Final = 0.05  # and for how long

Row = tuple[Any, ...]  # tick, t_ns, and whatever the records of that tick are made of
PackRows = Callable[[list[Row]], list[bytes]]  # the Message records of each
TICK_OF: Final = operator.itemgetter(0)


def announce_topics(
    packers: Sequence[TickPacker] = (), frames: dict[int, str] | None = None, inputs: dict[int, str] | None = None
) -> bytes:
    """The channel table of one process as JSON: its packers' topics, the bus name behind each frame channel, and the topic
    behind each channel of cycle inputs.
    """
    table = [
        {
            "channel": channel,
            "topic": f"/can/{bus}",
            "schema_name": FRAMES_SCHEMA,
            "schema": FRAMES_TEXT,
            "deterministic": True,
            "every": "tick",
            "units": {},
        }
        for channel, bus in (frames or {}).items()
    ]
    table += [
        {
            "channel": channel,
            "topic": topic,
            "schema_name": INPUT_SCHEMA,
            "schema": INPUT_TEXT,
            "deterministic": True,
            "every": "tick",
            "units": {},
        }
        for channel, topic in (inputs or {}).items()
    ]
    for packer in packers:
        table += [
            {
                "channel": channel,
                "topic": topic.name,
                "schema_name": topic.message_type,
                "schema": topic.ros2msg(),
                "deterministic": topic.deterministic,
                "every": topic.every,
                "units": {field.name: field.unit for field in topic.fields if field.unit},
            }
            for topic, channel in zip(packer.topics, packer.channels, strict=True)
        ]
    return json.dumps(table).encode()


@mypyc_attr(allow_interpreted_subclasses=True)
class Link:
    """Where a process puts its telemetry. `dropped` counts the ticks that found no room.

    hold_ticks : how many rows may wait before they are packed, HOLD_S at the most; 1: none does
    """

    def __init__(self, hold_ticks: int) -> None:
        self.dropped = 0
        self._hold_ticks = hold_ticks
        self._rows: list[Row] = []
        self._due_s = 0.0  # when to pack them, of the monotonic clock
        self._pack_rows: PackRows | None = None
        self.hear: Callable[[str, str], object] | None = None  # is told level and words of every event

    def announce(self, topics_json: bytes, pack_rows: PackRows | None = None) -> None:
        """State the channel table (see announce_topics) and how rows become records, once, before the first tick."""
        self._pack_rows = pack_rows

    def write_row(self, row: Row) -> None:
        """Hand over a tick as a row. Everything in it must stay as it is: tuples and numbers. Ticks rise."""
        rows = self._rows
        rows.append(row)
        now_s = time.monotonic()
        if len(rows) == 1:
            self._due_s = now_s + HOLD_S
        if len(rows) >= self._hold_ticks or now_s >= self._due_s:
            self.flush()

    def flush(self) -> None:
        """Let go of what is held back, before a wait that may be long."""
        rows, self._rows = self._rows, []
        if rows and self._pack_rows is not None:
            self._write_ticks(rows, self._pack_rows(rows))

    def _write_ticks(self, rows: list[Row], records: list[bytes]) -> None:
        raise NotImplementedError

    def write_tick(self, tick: int, t_ns: int, records: bytes) -> None:
        """Hand over the Message records of one tick, ready made."""
        self._write_ticks([(tick, t_ns)], [records])

    def write_json(self, topic: str, t_ns: int, payload: bytes) -> None:
        """Hand over one JSON object for a topic of bus.telemetry.events; it is filed behind the tick written next."""
        raise NotImplementedError

    def close(self, reason: str = "") -> None:
        """End the stream and say why. Harmless when repeated."""
        raise NotImplementedError

    def event(self, t_ns: int, level: int | str, name: str, message: str) -> None:
        """Log a line on /events; level is debug, info, warning, error or fatal (1..5). Whoever listens hears it too."""
        if self.hear is not None:
            self.hear(str(level), message)
        self.write_json(EVENTS.name, t_ns, format_event(t_ns, level, name, message))

    def fault(
        self,
        t_ns: int,
        tick: int,
        unit: str,
        fault: str,
        phase: str,
        value: float = 0.0,
        message: str = "",
        *,
        id: str = "",
        number: int = -1,
        definition: str = "",
    ) -> None:
        """Log on /faults what became of a fault of `unit` at `tick`; the phases are those of bus.telemetry.events."""
        record = format_fault(
            t_ns, tick, unit, fault, phase, value, message, id=id, number=number, definition=definition
        )
        self.write_json(FAULTS.name, t_ns, record)

    def transform(self, t_ns: int, parent: str, child: str, translation_m: Vec3, q: Vec4) -> None:
        """Log on /tf the pose of `child` in `parent`; q scalar first, v_parent = R(q) v_child."""
        self.write_json(TF.name, t_ns, format_transform(t_ns, parent, child, translation_m, q))


class TelemetryLink(Link):
    """Telemetry through an inherited pipe to the recorder process.

    blocking : lock-step and in-process runs wait for room (5 s at most); a real-time process drops the tick instead
    fd None  : nothing is recorded and every call does nothing
    Raises RecordError once the recorder is gone, or takes nothing for 5 s.

    A real-time process writes every tick at once: one system call, no later stall. A blocking one runs as fast as it can,
    and the recorder's wake-up costs more than the writing: it holds rows for HOLD_S or HOLD_TICKS.
    """

    def __init__(self, fd: int | None, source: int, blocking: bool, stall_s: float = STALL_S) -> None:
        super().__init__(HOLD_TICKS if blocking else 1)
        self._fd = fd
        self._source = source
        self._blocking = blocking
        self._stall_s = stall_s
        self._tail = b""  # the rest of a piece that the pipe took only in part
        self._last_tick = 0
        if fd is not None:
            os.set_blocking(fd, False)
            with contextlib.suppress(OSError):  # a link through something else than a pipe has the room it has
                widen_pipe(fd)

    def announce(self, topics_json: bytes, pack_rows: PackRows | None = None) -> None:
        super().announce(topics_json, None if self._fd is None else pack_rows)
        self._send(HEADER.pack(MAGIC, ANNOUNCE, self._source, len(topics_json), 0, 0) + topics_json, wait=True)

    def _write_ticks(self, rows: list[Row], records: list[bytes]) -> None:
        pieces: list[bytes] = []
        for (tick, t_ns, *_), data in zip(rows, records, strict=True):
            pieces += HEADER.pack(MAGIC, TICK, self._source, len(data), tick, t_ns), data
        self._last_tick = tick
        self._send(b"".join(pieces), self._blocking)

    def write_json(self, topic: str, t_ns: int, payload: bytes) -> None:
        text = topic.encode() + b"\0" + payload
        self.flush()
        self._send(HEADER.pack(MAGIC, JSON, self._source, len(text), self._last_tick, t_ns) + text, self._blocking)

    def close(self, reason: str = "") -> None:
        if self._fd is None:
            return
        text = json.dumps({"reason": reason, "dropped": self.dropped}).encode()
        # A recorder that is gone has been reported by the tick that met it, and is by whoever started it.
        with contextlib.suppress(RecordError):
            self.flush()
            self._send(HEADER.pack(MAGIC, CLOSE, self._source, len(text), self._last_tick, 0) + text, wait=True)
        os.close(self._fd)
        self._fd = None

    def _send(self, piece: bytes, wait: bool) -> None:
        if self._fd is None:
            return
        try:
            if self._tail and not self._drain(self._fd, wait):
                self.dropped += 1
                return
            try:
                sent = os.write(self._fd, piece)
            except BlockingIOError:
                sent = 0
            if sent == len(piece):
                return
            if sent == 0 and not wait:
                self.dropped += 1
                return
            self._tail = piece[sent:]  # a piece that has begun must end, or the stream is garbage
            self._drain(self._fd, wait)
        except BrokenPipeError:
            raise RecordError(
                f"telemetry of tick {self._last_tick}: the recorder died (its end of the pipe is closed); "
                "what it wrote stays readable, see `hilsat recover`"
            ) from None

    def _drain(self, fd: int, wait: bool) -> bool:
        """Send what is left of the last piece, waiting for room where that is allowed; True when nothing is left."""
        poller = select.poll()
        poller.register(fd, select.POLLOUT)
        while self._tail:
            if not poller.poll(int(self._stall_s * 1000) if wait else 0):
                if not wait:
                    return False
                raise RecordError(
                    f"telemetry of tick {self._last_tick}: the recorder took nothing for {self._stall_s:g} s; "
                    "is its disk stuck, or the process stopped?"
                )
            try:
                written = os.write(fd, self._tail)
                self._tail = self._tail[written:]
            except BlockingIOError:
                if not wait:
                    return False
        return True


class Sink(Protocol):
    """What a recorder in this process takes."""

    def announce(self, source: int, topics_json: bytes) -> None: ...
    def write_ticks(self, source: int, ticks: list[int], t_ns: int, records: list[bytes]) -> None: ...
    def write_json(self, source: int, topic: str, t_ns: int, payload: bytes) -> None: ...
    def end_source(self, source: int, reason: str, dropped: int) -> None: ...


class MemoryLink(Link):
    """Telemetry straight to a recorder in the same process. Never drops."""

    def __init__(self, sink: Sink, source: int) -> None:
        super().__init__(HOLD_TICKS)
        self._sink = sink
        self._source = source
        self._open = True

    def announce(self, topics_json: bytes, pack_rows: PackRows | None = None) -> None:
        super().announce(topics_json, pack_rows)
        self._sink.announce(self._source, topics_json)

    def _write_ticks(self, rows: list[Row], records: list[bytes]) -> None:
        self._sink.write_ticks(self._source, list(map(TICK_OF, rows)), rows[-1][1], records)

    def write_json(self, topic: str, t_ns: int, payload: bytes) -> None:
        self.flush()
        self._sink.write_json(self._source, topic, t_ns, payload)

    def close(self, reason: str = "") -> None:
        if self._open:
            self._open = False
            self.flush()
            self._sink.end_source(self._source, reason, self.dropped)


def widen_pipe(fd: int) -> int:
    """Bytes that the pipe behind `fd` now holds: as many as this machine lets an unprivileged process have."""
    size = PIPE_BYTES
    while size > select.PIPE_BUF:
        try:
            return fcntl.fcntl(fd, fcntl.F_SETPIPE_SZ, size)
        except PermissionError:
            size //= 2
    return fcntl.fcntl(fd, fcntl.F_GETPIPE_SZ)
