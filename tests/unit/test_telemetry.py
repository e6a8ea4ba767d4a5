"""Telemetry at the process that speaks: layouts, packing, and a pipe that is full, stuck or closed."""

from __future__ import annotations

import fcntl
import json
import os
import select
import struct
import threading
import time

import pytest

from bus.errors import ConfigError, RecordError, UsageError
from bus.telemetry import link as telemetry
from bus.telemetry.events import FAULTS, format_event, format_fault, format_transform
from bus.telemetry.link import (
    CLOSE,
    HEADER,
    JSON,
    MAGIC,
    TICK,
    Field,
    Link,
    MemoryLink,
    Row,
    TelemetryLink,
    TickPacker,
    Topic,
    announce_topics,
    pack_frames,
)

MIXED = Topic(
    "/mixed",
    "hilsat/Mixed",
    (Field("flag", "bool"), Field("x", "float64", 2, "m", "place"), Field("n", "uint8", 3), Field("big", "uint64")),
)


def split_records(data: bytes) -> list[tuple[int, int, int, int, int, bytes]]:
    """Opcode, channel, sequence, log time, publish time, data of each MCAP record, by the specification's table."""
    records, at = [], 0
    while at < len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        channel, sequence, log_time, publish_time = struct.unpack_from("<HIQQ", data, at + 9)
        records.append((opcode, channel, sequence, log_time, publish_time, data[at + 31 : at + 9 + length]))
        at += 9 + length
    assert at == len(data)
    return records


def test_a_mixed_record_lies_in_memory_as_cdr_demands() -> None:
    """Every byte of one record against a layout worked out by hand from the CDR alignment rule."""
    (record,) = split_records(TickPacker([MIXED], 7).pack(3, 5_000_000_009, True, 1.5, -2.0, 1, 2, 3, 2**64 - 1))
    assert record[:5] == (5, 7, 3, 5_000_000_009, 5_000_000_009)
    assert record[5].hex() == (
        "00010000"  # encapsulation: CDR, little endian
        "05000000" "09000000"  # stamp: 5 s, 9 ns
        "01" "00000000000000"  # bool, then padding to 8
        "000000000000f83f" "00000000000000c0"  # 1.5, -2.0
        "010203" "0000000000"  # three bytes, then padding to 8
        "ffffffffffffffff"
    )  # fmt: skip


def test_one_pack_call_makes_the_records_of_all_topics_in_order() -> None:
    """Channels count up from the first, values are shared out in topic order."""
    topics = [Topic(f"/t{n}", f"hilsat/T{n}", (Field("a", "float64", n),)) for n in (1, 3, 2)]
    packer = TickPacker(topics, 101)
    records = split_records(packer.pack(9, 12, *map(float, range(6))))
    assert [record[1] for record in records] == [101, 102, 103] == list(packer.channels)
    assert [struct.unpack(f"<{(len(r[5]) - 12) // 8}d", r[5][12:]) for r in records] == [(0.0,), (1, 2, 3), (4, 5)]
    assert packer.flat_size == 6


def test_a_wrong_number_or_kind_of_values_is_refused() -> None:
    """Too few, too many and a word instead of a number never make a record."""
    pack = TickPacker([MIXED], 1).pack
    too_few, too_many = (True, 1.0), (True, 1.0, 2.0, 1, 2, 3, 4, 5)
    a_word, not_a_byte = (True, "x", 2.0, 1, 2, 3, 4), (True, 1.0, 2.0, 1, 2, 300, 4)
    for values in (too_few, too_many, a_word, not_a_byte):
        with pytest.raises(struct.error):
            pack(0, 0, *values)


def test_frames_travel_untouched() -> None:
    """The batch is the payload behind stamp and length, for none, one and many frames."""
    for count in (0, 1, 13):
        batch = os.urandom(16 * count)
        ((_, channel, sequence, t_ns, _, data),) = split_records(pack_frames(1, 4, 2_000_000_001, batch))
        assert (channel, sequence, t_ns) == (1, 4, 2_000_000_001)
        assert data == bytes.fromhex("00010000") + struct.pack("<iII", 2, 1, len(batch)) + batch


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Field("J_b"), "lower-case"),
        (lambda: Field("a__b"), "underscore"),
        (lambda: Field("stamp"), "by itself"),
        (lambda: Field("a", "float32"), "float64, uint64"),
        (lambda: Field("a", count=0), "1 or more"),
        (lambda: Topic("t", "hilsat/T", (Field("a"),)), '"/"'),
        (lambda: Topic("/t", "T", (Field("a"),)), "hilsat/Name"),
        (lambda: Topic("/t", "hilsat/T", (Field("a"), Field("a"))), "one name"),
        (lambda: TickPacker([Topic("/t", "hilsat/T", ())], 1), "/t has nothing"),
        (lambda: TickPacker([], 1), "nothing to pack"),
    ],
)
def test_a_layout_that_viewers_could_not_read_is_refused(make: object, words: str) -> None:
    """Each with a message that says what is allowed."""
    with pytest.raises(ConfigError, match=words):
        make()  # type: ignore[operator]


def test_the_channel_table_says_all_that_the_recorder_needs() -> None:
    """Frames and topics with channel, type, schema text, units."""
    table = json.loads(announce_topics([TickPacker([MIXED], 2)], {1: "bus0"}))
    assert [(row["channel"], row["topic"], row["schema_name"]) for row in table] == [
        (1, "/can/bus0", "hilsat/msg/CanFrames"), (2, "/mixed", "hilsat/msg/Mixed"),
    ]  # fmt: skip
    assert table[1]["units"] == {"x": "m"}
    assert "float64[2] x  # [m] place\n" in table[1]["schema"]


def read_pieces(fd: int) -> list[tuple[int, int, int, int, bytes]]:
    """Kind, source, tick, t_ns, body of everything in a pipe whose write end is closed."""
    data = b""
    while block := os.read(fd, 1 << 16):
        data += block
    pieces, at = [], 0
    while at < len(data):
        magic, kind, source, size, tick, t_ns = HEADER.unpack_from(data, at)
        assert magic == MAGIC
        at += HEADER.size + size
        assert at <= len(data)
        pieces.append((kind, source, tick, t_ns, data[at - size : at]))
    return pieces


def test_what_is_said_arrives_in_order() -> None:
    """One piece a call, and a goodbye with the reason; closing twice is harmless."""
    out, into = os.pipe()
    link = TelemetryLink(into, 2, blocking=True)
    link.write_tick(7, 70, b"records")
    link.event(71, "warning", "modes", "to safe")
    link.close("done")
    link.close()
    tick, event, goodbye = read_pieces(out)
    os.close(out)
    assert tick == (TICK, 2, 7, 70, b"records")
    assert event[:4] == (JSON, 2, 7, 71)
    assert json.loads(event[4].partition(b"\0")[2])["message"] == "to safe"
    assert goodbye[0] == CLOSE
    assert json.loads(goodbye[4]) == {"reason": "done", "dropped": 0}


def test_a_real_time_process_drops_whole_ticks_and_never_waits() -> None:
    """With nobody reading, thousands of ticks take no time; what does arrive is whole, and the rest is counted.

    Pieces are larger than PIPE_BUF, so that the pipe also takes one only in part.
    """
    out, into = os.pipe()
    link = TelemetryLink(into, 1, blocking=False)
    fcntl.fcntl(into, fcntl.F_SETPIPE_SZ, 16384)
    body = bytes(5000)
    for tick in range(1000):
        link.write_tick(tick, tick, body)
    assert link.dropped > 900
    dropped = link.dropped
    received: list[list[tuple[int, int, int, int, bytes]]] = []
    reader = threading.Thread(target=lambda: received.append(read_pieces(out)))
    reader.start()
    time.sleep(0.1)
    link.write_tick(1000, 1000, body)
    link.close("done")
    reader.join(10)
    os.close(out)
    ticks = [piece for piece in received[0] if piece[0] == TICK]
    assert all(piece[4] == body for piece in ticks)
    assert len(ticks) == 1001 - dropped
    assert ticks[-1][2] == 1000
    assert json.loads(received[0][-1][4])["dropped"] == dropped


def test_a_lock_step_process_waits_for_room_and_loses_nothing() -> None:
    """A slow reader delays the writer instead of costing a tick."""
    out, into = os.pipe()
    link = TelemetryLink(into, 1, blocking=True, stall_s=0.2)
    fcntl.fcntl(into, fcntl.F_SETPIPE_SZ, 4096)

    def write() -> None:
        for tick in range(300):
            link.write_tick(tick, tick, bytes(3000))
        link.close()

    writer = threading.Thread(target=write)
    writer.start()
    pieces = read_pieces(out)
    writer.join(10)
    os.close(out)
    assert [piece[2] for piece in pieces if piece[0] == TICK] == list(range(300))


def test_a_stuck_recorder_is_named() -> None:
    """A lock-step process gives up in words when nothing is taken for the time limit."""
    out, into = os.pipe()
    link = TelemetryLink(into, 1, blocking=True, stall_s=0.2)
    fcntl.fcntl(into, fcntl.F_SETPIPE_SZ, 4096)
    link.write_tick(0, 0, bytes(4096 - HEADER.size))
    with pytest.raises(RecordError, match=r"tick 1: the recorder took nothing for 0\.2 s"):
        link.write_tick(1, 0, bytes(4096 - HEADER.size))
    assert not select.select([], [into], [], 0)[1]
    os.close(out)
    link.close()  # must not raise: the stall has been reported


@pytest.mark.parametrize("blocking", [True, False])
@pytest.mark.parametrize("as_row", [True, False])
def test_a_dead_recorder_is_named(blocking: bool, as_row: bool) -> None:
    """In both modes the first write after its death says so; the goodbye does not hide an error under way."""
    out, into = os.pipe()
    link = TelemetryLink(into, 1, blocking)
    link.announce(b"[]", pack_last)

    def write(tick: int) -> None:
        if as_row:
            link.write_row((tick, 0, b"x"))
        else:
            link.write_tick(tick, 0, b"x")
        link.flush()

    write(0)
    os.close(out)
    with pytest.raises(RecordError, match="tick 1: the recorder died"):
        write(1)
    link.close()


def pack_last(rows: list[Row]) -> list[bytes]:
    """Rows that carry their records ready made, behind tick and time."""
    return [row[-1] for row in rows]


def test_a_lock_step_process_holds_back_little_and_briefly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows are packed and written together once there are 64 or the first of them is 50 ms old, or at `flush`."""
    now_s = [0.0]
    monkeypatch.setattr(telemetry.time, "monotonic", lambda: now_s[0])
    out, into = os.pipe()
    os.set_blocking(out, False)
    link = TelemetryLink(into, 1, blocking=True)
    link.announce(b"[]", pack_last)
    os.read(out, 1 << 16)
    size = HEADER.size + 100

    def written() -> int:
        try:
            return len(os.read(out, 1 << 20)) // size
        except BlockingIOError:
            return 0

    counts = []
    for tick in range(70):
        link.write_row((tick, tick, bytes(100)))
        counts.append(written())
    assert max(counts) == counts[63] == sum(counts) == telemetry.HOLD_TICKS == 64
    now_s[0] = 0.049
    link.write_row((70, 70, bytes(100)))
    assert written() == 0
    now_s[0] = 0.051
    link.write_row((71, 71, bytes(100)))
    assert written() == 8
    link.write_row((72, 72, bytes(100)))
    link.flush()
    assert written() == 1
    link.close()
    os.close(out)


def test_a_real_time_process_writes_every_row_at_once() -> None:
    """Nothing is held back where a later write would be a stall."""
    out, into = os.pipe()
    link = TelemetryLink(into, 1, blocking=False)
    link.announce(b"[]", pack_last)
    os.read(out, 1 << 16)
    for tick in range(3):
        link.write_row((tick, tick, b"abc"))
        assert os.read(out, 1 << 16)[HEADER.size :] == b"abc"
    link.close()
    os.close(out)


@pytest.mark.parametrize("kind", ["pipe", "memory"])
def test_what_is_held_back_goes_ahead_of_an_event(kind: str) -> None:
    """Rows, an event, a row: they arrive in that order, whoever takes them, and at the goodbye nothing is left."""
    said: list[object] = []

    class Sink:
        def announce(self, source: int, topics_json: bytes) -> None: ...

        def write_ticks(self, source: int, ticks: list[int], t_ns: int, records: list[bytes]) -> None:
            said.extend(zip(ticks, records, strict=True))
            assert t_ns == 10 * ticks[-1]

        def write_json(self, source: int, topic: str, t_ns: int, payload: bytes) -> None:
            said.append(topic)

        def end_source(self, source: int, reason: str, dropped: int) -> None: ...

    out, into = os.pipe()
    link: Link = MemoryLink(Sink(), 1) if kind == "memory" else TelemetryLink(into, 1, blocking=True)
    link.announce(b"[]", pack_last)
    link.write_row((0, 0, b"a"))
    link.write_row((1, 10, b"b"))
    link.event(20, "info", "test", "between")
    link.write_row((2, 20, b"c"))
    link.close("done")
    if kind == "pipe":
        for piece, _, tick, _, body in read_pieces(out)[1:-1]:
            said.append((tick, body) if piece == TICK else body.partition(b"\0")[0].decode())
    else:
        os.close(into)
    os.close(out)
    assert said == [(0, b"a"), (1, b"b"), "/events", (2, b"c")]


def test_without_a_pipe_nothing_happens() -> None:
    """`None` is a link that swallows everything."""
    link = TelemetryLink(None, 1, blocking=True)
    link.announce(b"[]", pack_last)
    link.write_tick(0, 0, b"x")
    link.write_row((1, 0, b"x"))
    link.flush()
    link.fault(0, 0, "rw1", "loss", "onset", 0.5)
    link.transform(0, "inertial", "body", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    link.close("done")
    assert link.dropped == 0


def test_json_records_are_what_viewers_expect() -> None:
    """foxglove.Log and foxglove.FrameTransform by their published field names; no NaN literal ever."""
    assert json.loads(format_event(1_500_000_000, "error", "plant", "text")) == {
        "timestamp": {"sec": 1, "nsec": 500_000_000}, "level": 4, "name": "plant", "message": "text", "file": "",
        "line": 0,
    }  # fmt: skip
    assert json.loads(format_event(0, 2, "", ""))["level"] == 2
    with pytest.raises(UsageError, match="debug, info, warning, error, fatal"):
        format_event(0, "loud", "", "")
    assert "value" not in json.loads(format_fault(0, 5, "wheel.2", "loss", "onset", float("nan")))
    record = json.loads(format_fault(0, 5, "wheel.2", "loss", "effect", 0.4, "text", id="a", number=3, definition="{}"))
    assert record.pop("timestamp") == {"sec": 0, "nsec": 0}
    assert record == {
        "id": "a", "number": 3, "unit": "wheel.2", "fault": "loss", "phase": "effect", "tick": 5, "value": 0.4,
        "definition": "{}", "message": "text",
    }  # fmt: skip
    assert {*record, "timestamp"} == set(FAULTS.properties)
    transform = json.loads(format_transform(0, "inertial", "body", (1.0, 2.0, 3.0), (0.5, 0.1, 0.2, 0.3)))
    assert transform["rotation"] == {"w": 0.5, "x": 0.1, "y": 0.2, "z": 0.3}
    with pytest.raises(ValueError, match="JSON"):
        format_transform(0, "a", "b", (float("nan"), 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
