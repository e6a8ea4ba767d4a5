"""Foreign, damaged and hostile MCAP files: read as far as they go, within bounds, and without a traceback."""

from __future__ import annotations

import argparse
import json
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, Writer

from bus.errors import HilsatError, RecordError
from tools.log import export, recover
from tools.log.decompression import MAX_CHUNK_BYTES, DamagedData, decompress, decompress_beginning
from tools.log.mcap_reader import read_run
from tools.log.mcap_records import McapContent
from tools.log.message_index import read_indexes, walk_messages

MAGIC = b"\x89MCAP0\r\n"
STAMP = "builtin_interfaces/Time stamp\n"
CHUNK, CHANNEL = 6, 4


def run_verb(module: object, *words: str) -> int:
    parser = argparse.ArgumentParser()
    module.add_parser(parser.add_subparsers())  # type: ignore[attr-defined]
    args = parser.parse_args(list(words))
    return int(args.func(args))


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def chunk(data: bytes, name: str, size: int, packed: bytes, rest: bytes = b"") -> bytes:
    """A Chunk record by the specification; `rest` stands behind its data."""
    head = struct.pack("<QQQI", 0, 0, size, 0) + text(name) + struct.pack("<Q", len(packed))
    return record(CHUNK, head + packed + rest)


def message(channel: int, number: int, value: float) -> bytes:
    body = struct.pack("<HIQQ", channel, number, number * 10, number * 10)
    return record(5, body + b"\0\1\0\0" + bytes(8) + struct.pack("<d", value))


def write_file(path: Path, *records: bytes) -> Path:
    """One topic /a of one float64 x on channel 1, and these records; closed."""
    schema = record(3, struct.pack("<H", 1) + text("t/A") + text("ros2msg") + text(STAMP + "float64 x"))
    channel = record(CHANNEL, struct.pack("<HH", 1, 1) + text("/a") + text("cdr") + struct.pack("<I", 0))
    end = record(15, bytes(4)) + record(2, bytes(20))
    path.write_bytes(MAGIC + record(1, text("") + text("")) + schema + channel + b"".join(records) + end + MAGIC)
    return path


MESSAGES = b"".join(message(1, n, n / 2) for n in range(5))


# -- bounds --------------------------------------------------------------------------------------------------------


def squeeze(name: str, data: bytes) -> bytes:
    if name == "zstd":
        return zstandard.ZstdCompressor(write_content_size=False).compress(data)
    return bytes(lz4.frame.compress(data, content_checksum=True)) if name == "lz4" else data


@pytest.mark.parametrize("name", ["zstd", "lz4"])
def test_a_chunk_costs_no_more_than_it_declares(name: str) -> None:
    """Data that unpacks to more than its head says is damaged; so is less, a cut, and a declared size out of bounds."""
    data = bytes(100_000) + b"end"
    packed = squeeze(name, data)
    assert decompress(name, packed, len(data)) == data
    for size in (0, 1000, len(data) - 1, len(data) + 1, MAX_CHUNK_BYTES + 1, 2**63):
        with pytest.raises(DamagedData):
            decompress(name, packed, size)
    with pytest.raises(DamagedData):
        decompress(name, packed[:-3], len(data))
    assert len(decompress_beginning(name, packed, 500)) == 500
    assert decompress_beginning(name, b"garbage", 500) == b""


BOMB = """
import re, sys
from tools.log.mcap_reader import read_run
run = read_run(sys.argv[1])
# not ru_maxrss, which begins with what the process had before it became this program
print(len(run.lost_chunks), int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]) // 1024)
"""


@pytest.mark.parametrize("closed", [True, False])
def test_a_bomb_costs_no_memory(closed: bool, tmp_path: Path) -> None:
    """2 GB of zeros in 70 kB behind a head that says 1000 bytes, in a whole chunk and in the chunk the file ends in."""
    packer = zstandard.ZstdCompressor(level=3).compressobj()
    packed = b"".join(packer.compress(bytes(1 << 20)) for _ in range(2048)) + packer.flush()
    path = write_file(tmp_path / "bomb.mcap", chunk(b"", "zstd", 1000, packed))
    if not closed:
        path.write_bytes(path.read_bytes()[:-200])
    done = subprocess.run([sys.executable, "-c", BOMB, str(path)], capture_output=True, text=True, check=True)
    lost, peak_mb = map(int, done.stdout.split())
    assert lost == closed
    assert peak_mb < 150


def test_only_the_declared_data_of_a_chunk_counts(tmp_path: Path) -> None:
    """Bytes behind the data of an uncompressed chunk are room for later versions, not damage."""
    path = write_file(tmp_path / "a.mcap", chunk(MESSAGES, "", len(MESSAGES), MESSAGES, b"new"))
    run = read_run(path)
    assert run.signals("/a")["x"].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert not run.lost_chunks
    lost = read_run(write_file(tmp_path / "b.mcap", chunk(MESSAGES, "", len(MESSAGES) - 3, MESSAGES)))
    assert [c.why for c in lost.lost_chunks] == [f"it declares {len(MESSAGES) - 3} bytes and has more"]


# -- indexes -------------------------------------------------------------------------------------------------------


def index(channel: int, *pairs: tuple[int, int]) -> bytes:
    entries = b"".join(struct.pack("<QQ", *pair) for pair in pairs)
    return record(7, struct.pack("<HI", channel, len(entries)) + entries)


def test_an_index_is_not_believed_over_the_messages() -> None:
    """Channel and times of the messages count; an index that leaves one out, or is not whole, counts for nothing."""
    size = len(message(1, 0, 0.0))
    lying = index(9, *((999, number * size) for number in range(5)))
    table = read_indexes(MESSAGES, lying)
    assert table is not None
    assert (table.channel.tolist(), table.sequence.tolist()) == ([1] * 5, [0, 1, 2, 3, 4])
    assert table.log_time_ns.tolist() == [0, 10, 20, 30, 40]
    assert [column.tolist() for column in table] == [column.tolist() for column in walk_messages(MESSAGES).table]
    short = index(1, *((0, number * size) for number in range(4)))
    for bad in (short, lying[:-8], lying[:12], index(1), index(1, (0, 2**63)), lying + b"\7"):
        assert read_indexes(MESSAGES, bad) is None


def test_a_message_too_short_is_stepped_over_and_counted(tmp_path: Path) -> None:
    """The messages around it are read."""
    data = message(1, 0, 0.0) + record(5, b"short") + message(1, 1, 0.5)
    run = read_run(write_file(tmp_path / "a.mcap", chunk(data, "", len(data), data)))
    assert run.signals("/a")["x"].tolist() == [0.0, 0.5]
    assert run.damage == {"message record": 1}


# -- what others write ---------------------------------------------------------------------------------------------


def write_mixed(path: Path) -> Path:
    """A text topic first, then protobuf with a binary schema, one without a schema, signals, and broken JSON."""
    with open(path, "wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start()
        ids = [
            writer.register_channel("/notes", "cdr", writer.register_schema("s/S", "ros2msg", b"string data")),
            writer.register_channel("/camera", "protobuf", writer.register_schema("p", "protobuf", b"\x0a\x88\xff")),
            writer.register_channel("/bare", "json", 0, {"units": "not { json"}),
            writer.register_channel(
                "/x", "cdr", writer.register_schema("h/X", "ros2msg", f"{STAMP}float64 x".encode())
            ),
            writer.register_channel("/faults", "json", 0),
        ]
        signal = b"\0\1\0\0" + bytes(8) + struct.pack("<d", 1.5)
        deep = b"[" * 100_000
        for channel, data in zip(ids, (b"\0\1\0\0abc", b"\xff\xfe", b'{"n": 1}', signal, deep), strict=True):
            writer.add_message(channel, 5, data, 5)
        for data in (
            b"",
            b"7",
            b'{"unit": 3}',
            b"\xff",
            b'{"tick": 1e400, "unit": "a", "fault": "b", "phase": "onset"}',
        ):
            writer.add_message(ids[4], 6, data, 6)
        writer.finish()
    return path


def test_one_topic_that_cannot_be_decoded_does_not_stop_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """csv and npz of everything: what can be is written, what cannot is named."""
    path = str(write_mixed(tmp_path / "a.mcap"))
    assert run_verb(export, "export", path, "--to", "csv", "-o", str(tmp_path / "csv")) == 0
    words = capsys.readouterr().err
    assert "/notes is left out" in words
    assert "/camera is left out: /camera is protobuf" in words
    assert sorted(file.name for file in (tmp_path / "csv").iterdir()) == ["bare.csv", "faults.csv", "x.csv"]
    assert (tmp_path / "csv" / "x.csv").read_text() == "t_s,x\n5e-09,1.5\n"
    assert run_verb(export, "export", path, "--to", "npz", "-o", str(tmp_path / "a.npz")) == 0
    with np.load(tmp_path / "a.npz") as arrays:
        assert arrays["x.x"].tolist() == [1.5]
    with pytest.raises(RecordError, match="protobuf"):
        run_verb(export, "export", path, "--to", "csv", "--topic", "/camera")


def test_json_records_that_are_none_are_left_out_and_counted(tmp_path: Path) -> None:
    """Deep nesting, no object, no text, keys of another kind: none is a fault, each is counted."""
    run = read_run(write_mixed(tmp_path / "a.mcap"))
    assert run.faults == []
    assert sum(count for what, count in run.damage.items() if what.startswith("/faults")) == 6
    assert run.topics["/bare"].units == {}
    assert run.records("/bare") == [{"n": 1, "t_ns": 5}]


def test_a_mixed_log_is_recovered_with_its_binary_schema(tmp_path: Path) -> None:
    """Cut before its end: messages of every encoding come back byte for byte."""
    raw = write_mixed(tmp_path / "a.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(raw[:-30])
    recover.recover(tmp_path / "cut.mcap", tmp_path / "whole.mcap")
    assert read_run(tmp_path / "whole.mcap").payloads("/camera") == [b"\xff\xfe"]
    assert McapContent(tmp_path / "whole.mcap").schemas.keys() == McapContent(tmp_path / "a.mcap").schemas.keys()


def test_records_that_contradict_are_counted_and_the_first_counts(tmp_path: Path) -> None:
    """Channel 1 declared again as another topic."""
    other = record(CHANNEL, struct.pack("<HH", 1, 1) + text("/b") + text("cdr") + struct.pack("<I", 0))
    cut = record(CHANNEL, b"\1")
    path = write_file(tmp_path / "a.mcap", other, cut, chunk(MESSAGES, "", len(MESSAGES), MESSAGES))
    run = read_run(path)
    assert list(run.topics) == ["/a"]
    assert run.damage == {"channel record that contradicts another": 1, "channel record": 1}


def test_nonsense_ends_in_words(tmp_path: Path) -> None:
    """Layouts out of bounds, records of another size, a pipe instead of a file."""
    body = json.dumps({}).encode()
    for number, layout in enumerate(("float64[999999] x\n" * 20, "float64 x\nfloat64 x", "float64[0]", "\0")):
        schema = record(3, struct.pack("<H", 2) + text("t/B") + text("ros2msg") + text(STAMP + layout))
        channel = record(CHANNEL, struct.pack("<HH", 2, 2) + text("/b") + text("cdr") + struct.pack("<I", 0))
        odd = record(5, struct.pack("<HIQQ", 2, 0, 2**64 - 1, 0) + body)
        run = read_run(write_file(tmp_path / f"{number}.mcap", schema, channel, odd))
        with pytest.raises(HilsatError):
            run.signals("/b")["x"]
        assert run.t_ns("/b").size == 1
    with pytest.raises(RecordError, match="device or a pipe"):
        read_run("/dev/null")


def test_checksums_of_chunks_and_attachments_are_checked(tmp_path: Path) -> None:
    """CRC-32 by zlib over what the specification says."""
    head = (
        struct.pack("<QQQI", 0, 0, len(MESSAGES), zlib.crc32(MESSAGES) ^ 1)
        + text("")
        + struct.pack("<Q", len(MESSAGES))
    )
    body = struct.pack("<QQ", 0, 0) + text("icd.dbc") + text("text/plain") + struct.pack("<Q", 3) + b"abc"
    bad, good = (record(9, body + struct.pack("<I", zlib.crc32(body) ^ turn)) for turn in (1, 0))
    run = read_run(write_file(tmp_path / "a.mcap", record(CHUNK, head + MESSAGES), bad))
    assert [c.why for c in run.lost_chunks] == ["its checksum does not match"]
    with pytest.raises(RecordError, match=r"icd\.dbc is damaged"):
        run.decoded("X")
    assert read_run(write_file(tmp_path / "b.mcap", good)).attachment("icd.dbc") == b"abc"
