"""Reading logs: frames, DBC decoding, digests, files of other writers and files that are no logs."""

from __future__ import annotations

import json
from pathlib import Path

import cantools
import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from bus.errors import RecordError
from bus.telemetry.link import Field, TickPacker, Topic, announce_topics, pack_frames
from bus.wire.frames import FRAME
from tools.log.mcap_reader import parse_layout, read_run
from tools.log.recorder import Recorder, RunAttachment

DBC = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 401 WHEEL: 8 A
 SG_ COUNTER : 8|4@1+ (1,0) [0|15] "" A
 SG_ SPEED : 16|24@1- (0.001,0) [-8388|8388] "rad/s" A
 SG_ TEMP : 47|12@0- (0.5,-40) [-1000|1000] "degC" A
 SG_ STATUS : 12|4@1+ (1,0) [0|15] "" A
BO_ 402 OTHER: 2 A
 SG_ X : 0|16@1+ (1,0) [0|65535] "" A
BO_ 2566844417 LONG: 8 A
 SG_ Y : 7|16@0+ (1,0) [0|65535] "" A
BO_ 403 MUXED: 8 A
 SG_ M M : 0|8@1+ (1,0) [0|255] "" A
 SG_ Z m1 : 8|8@1+ (1,0) [0|255] "" A
"""
PACKER = TickPacker([Topic("/t", "hilsat/T", (Field("a", "float64", 2, "N m", "doc # with [brackets]"),))], 2)


def write_log(path: Path, frames: list[list[bytes]], *, dbc: bool = True, a: float = 0.5) -> None:
    attachments = [RunAttachment("icd.dbc", "text/plain", DBC.encode())] if dbc else []
    recorder = Recorder(path, metadata={"run_id": "x"}, attachments=attachments, sources=[1])
    link = recorder.link(1)
    link.announce(announce_topics([PACKER], {1: "bus0"}))
    for tick, batch in enumerate(frames):
        link.write_tick(
            tick, tick * 100, pack_frames(1, tick, tick * 100, b"".join(batch)) + PACKER.pack(tick, tick * 100, a, -a)
        )
        link.fault(tick * 100, tick, "rw1", "loss", "onset", 0.25)
    link.close("done")
    recorder.close()


def random_frames(count: int) -> list[list[bytes]]:
    rng = np.random.default_rng(5)
    ids = (401, 402, 0x80000000 | (2566844417 & 0x1FFFFFFF), 0x123)
    return [[FRAME.pack(int(rng.choice(ids)), 8, rng.bytes(8)) for _ in range(tick % 5)] for tick in range(count)]


def test_frames_come_back_lossless_with_their_times(tmp_path: Path) -> None:
    """Identifier with flags, length and data of every frame, in bus order, stamped with their tick."""
    frames = random_frames(100)
    write_log(tmp_path / "a.mcap", frames)
    got = read_run(tmp_path / "a.mcap").frames()
    flat = [(tick * 100, *FRAME.unpack(frame)) for tick, batch in enumerate(frames) for frame in batch]
    assert [(int(f["t_ns"]), int(f["id"]), int(f["dlc"]), f["data"].tobytes()) for f in got] == flat
    assert len(read_run(tmp_path / "a.mcap").frames("no_such_bus")) == 0


@pytest.mark.parametrize("name", ["WHEEL", "OTHER", "LONG"])
def test_bulk_decoding_equals_cantools(name: str, tmp_path: Path) -> None:
    """Signed and unsigned, both byte orders, scaled and shifted, 11 and 29 bits: equal to cantools, frame by frame."""
    frames = random_frames(400)
    write_log(tmp_path / "a.mcap", frames)
    decoded = read_run(tmp_path / "a.mcap").decoded(name)
    definition = cantools.database.load_string(DBC, "dbc").get_message_by_name(name)
    can_id = definition.frame_id | (0x80000000 if definition.is_extended_frame else 0)
    expected = [
        (tick * 100, definition.decode(data[: definition.length], decode_choices=False))
        for tick, batch in enumerate(frames)
        for raw_id, _, data in map(FRAME.unpack, batch)
        if raw_id == can_id
    ]
    assert len(expected) > 50
    assert decoded["t_ns"].tolist() == [t for t, _ in expected]
    for signal in definition.signals:
        assert decoded[signal.name].tolist() == pytest.approx(
            [values[signal.name] for _, values in expected], abs=1e-12
        )


def test_what_cannot_be_decoded_is_named(tmp_path: Path) -> None:
    """An unknown message with the known ones, a multiplexed one, and a log without a DBC."""
    write_log(tmp_path / "a.mcap", random_frames(3))
    run = read_run(tmp_path / "a.mcap")
    with pytest.raises(RecordError, match="no message WHEL; there are: LONG, MUXED, OTHER, WHEEL"):
        run.decoded("WHEL")
    with pytest.raises(RecordError, match="Z is multiplexed"):
        run.decoded("MUXED")
    write_log(tmp_path / "b.mcap", random_frames(3), dbc=False)
    with pytest.raises(RecordError, match="no DBC is attached"):
        read_run(tmp_path / "b.mcap").decoded("WHEEL")


def test_topics_units_and_faults(tmp_path: Path) -> None:
    """What a log says of itself, and JSON records as dictionaries."""
    write_log(tmp_path / "a.mcap", random_frames(3))
    run = read_run(tmp_path / "a.mcap")
    assert run.complete
    assert run.topics["/t"].units == {"a": "N m"}
    assert run.signals("/t")["a"].tolist() == [[0.5, -0.5]] * 3
    assert [(f["tick"], f["unit"], f["phase"], f["value"]) for f in run.faults] == [
        (n, "rw1", "onset", 0.25) for n in range(3)
    ]
    assert run.events == []
    with pytest.raises(RecordError, match="there is no topic /u; there are: /can/bus0, /events, /faults, /t"):
        run.t_ns("/u")
    with pytest.raises(RecordError, match="/faults is json, not signals"):
        run.signals("/faults")
    with pytest.raises(RecordError, match="not a field of fixed size"):
        run.signals("/can/bus0")


def test_the_digest_sees_one_bit_and_nothing_else(tmp_path: Path) -> None:
    """Equal for equal content in another file, other for one other value."""
    frames = random_frames(20)
    digests = []
    for name, a in (("a", 0.5), ("b", 0.5), ("c", float(np.nextafter(0.5, 1)))):
        write_log(tmp_path / f"{name}.mcap", frames, dbc=name != "b", a=a)
        digests.append(read_run(tmp_path / f"{name}.mcap").digest())
    assert digests[0] == digests[1] != digests[2]


@pytest.mark.parametrize("use_chunking", [True, False])
def test_a_file_of_the_librarys_own_writer_is_read(use_chunking: bool, tmp_path: Path) -> None:
    """Schemas and channels inside chunks, no chunks at all, and JSON: other people's logs."""
    with open(tmp_path / "a.mcap", "wb") as file:
        writer = Writer(file, chunk_size=200, compression=CompressionType.LZ4, use_chunking=use_chunking)
        writer.start()
        schema = writer.register_schema("x", "jsonschema", b"{}")
        channel = writer.register_channel("/x", "json", schema)
        for n in range(50):
            writer.add_message(channel, n, json.dumps({"n": n}).encode(), n)
        writer.finish()
    run = read_run(tmp_path / "a.mcap")
    assert run.complete
    assert [record["n"] for record in run.records("/x")] == list(range(50))


def test_what_is_no_log_is_said(tmp_path: Path) -> None:
    """A missing file, a directory, a text and an empty file."""
    (tmp_path / "text").write_text("hello, this is a text")
    (tmp_path / "empty").touch()
    for name, words in (
        ("none", "No such file"), (".", "Is a directory"), ("text", "not an MCAP file"), ("empty", "not an MCAP file"),
    ):  # fmt: skip
        with pytest.raises(RecordError, match=words):
            read_run(tmp_path / name)


def test_a_layout_follows_the_alignment_rule() -> None:
    """Offsets of a mixed message as the CDR rule gives them by hand: 8, 16, 32, 33, 36."""
    dtype = parse_layout(
        "builtin_interfaces/Time stamp\nbool a\nfloat64[2] b\n# note\nuint8 c\nbool d # [1] x\nint32 e\n", "x"
    )
    assert {name: dtype.fields[name][1] for name in "abcde"} == {"a": 8, "b": 16, "c": 32, "d": 33, "e": 36}  # type: ignore[index]
    assert dtype.itemsize == 40
