"""The lean MCAP writer, seen by the mcap library's own readers."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import ChunkIndex
from mcap.stream_reader import StreamReader

from bus.errors import RecordError
from tools.log.mcap_writer import Compression, McapWriter

SCHEMA = ("hilsat/msg/Raw", "ros2msg", "uint8 x\n")


def message(channel: int, sequence: int, t_ns: int, data: bytes) -> bytes:
    return struct.pack("<BQHIQQ", 5, 22 + len(data), channel, sequence, t_ns, t_ns) + data


def write_sample(path: Path, compression: Compression = "zstd") -> list[tuple[str, int, int, bytes]]:
    """Three chunks on two channels with ticks of several lengths; what the readers must find."""
    writer = McapWriter(path, compression=compression)
    writer.add_metadata("run", {"seed": "1", "name": "müller"})
    writer.add_attachment("scenario.yaml", "application/yaml", b"a: 1\n")
    writer.add_channel(1, "/a", "cdr", SCHEMA, {"deterministic": "true"})
    writer.add_channel(9, "/b", "cdr", SCHEMA, {})
    written = []
    number = 0
    for _ in range(3):
        parts = []
        for _ in range(40):
            number += 1
            long = bytes([number % 251]) * (5 + number % 3)
            parts.append(message(1, number, 10 * number, b"one") + message(9, number, 10 * number, long))
            written += [("/a", number, 10 * number, b"one"), ("/b", number, 10 * number, long)]
        writer.write_chunk(parts)
    writer.close()
    return written


@pytest.mark.parametrize("compression", ["zstd", "lz4", ""])
def test_every_reader_of_the_library_finds_every_message(compression: Compression, tmp_path: Path) -> None:
    """By index, by index backwards, and straight through with all checksums on."""
    path = tmp_path / "a.mcap"
    written = write_sample(path, compression)
    for reader in (make_reader, NonSeekingReader):
        with open(path, "rb") as file:
            found = [
                (channel.topic, m.sequence, m.log_time, m.data)
                for _, channel, m in reader(file, validate_crcs=True).iter_messages()
            ]
        assert found == written
    with open(path, "rb") as file:
        topic_b = [m.sequence for _, _, m in make_reader(file).iter_messages("/b", starting_at=500, ending_before=600)]
    assert topic_b == list(range(50, 60))


def test_the_summary_tells_the_truth(tmp_path: Path) -> None:
    """Statistics, attachment and metadata by index, schema shared between channels."""
    path = tmp_path / "a.mcap"
    write_sample(path)
    with open(path, "rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert [a.data for a in reader.iter_attachments()] == [b"a: 1\n"]
        assert [m.metadata for m in reader.iter_metadata()] == [{"seed": "1", "name": "müller"}]
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.channel_message_counts == {1: 120, 9: 120}
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (10, 1200)
    assert summary.statistics.chunk_count == len(summary.chunk_indexes) == 3
    assert len(summary.schemas) == 1


def test_message_indexes_point_at_messages(tmp_path: Path) -> None:
    """Every (log time, offset) of every index leads to a Message record of that channel and time in its chunk."""
    path = tmp_path / "a.mcap"
    write_sample(path, "")
    raw = path.read_bytes()
    with open(path, "rb") as file:
        chunks = [record for record in StreamReader(file, emit_chunks=True).records if isinstance(record, ChunkIndex)]
    entries = 0
    for chunk in chunks:
        data_at = chunk.chunk_start_offset + chunk.chunk_length - chunk.uncompressed_size
        for channel, at in chunk.message_index_offsets.items():
            (length,) = struct.unpack_from("<Q", raw, at + 1)
            number, size = struct.unpack_from("<HI", raw, at + 9)
            assert (raw[at], number, length) == (7, channel, 6 + size)
            for t_ns, offset in struct.iter_unpack("<QQ", raw[at + 15 : at + 15 + size]):
                opcode, _, got, _, log_time = struct.unpack_from("<BQHIQ", raw, data_at + offset)
                assert (opcode, got, log_time) == (5, channel, t_ns)
                entries += 1
    assert entries == 240


def test_adding_to_a_finished_file_keeps_the_rest(tmp_path: Path) -> None:
    """The grade is attached after the run: messages, indexes and the earlier attachment stay."""
    path = tmp_path / "a.mcap"
    written = write_sample(path)
    writer = McapWriter.resume(path)
    writer.add_attachment("grade.json", "application/json", b"{}")
    writer.close()
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert [a.name for a in reader.iter_attachments()] == ["scenario.yaml", "grade.json"]
        assert len(list(reader.iter_messages())) == len(written)
    with open(path, "rb") as file:
        assert len(list(NonSeekingReader(file, validate_crcs=True).iter_messages())) == len(written)


def test_adding_to_a_file_without_a_summary_is_refused(tmp_path: Path) -> None:
    """The log of a killed run is not touched; the message names the way out."""
    path = tmp_path / "a.mcap"
    write_sample(path)
    path.write_bytes(path.read_bytes()[:-50])
    before = path.read_bytes()
    with pytest.raises(RecordError, match="hilsat recover"):
        McapWriter.resume(path)
    assert path.read_bytes() == before
    with pytest.raises(RecordError, match="No such file"):
        McapWriter.resume(tmp_path / "none.mcap")


def test_ticks_that_look_alike_but_are_not_are_told_apart(tmp_path: Path) -> None:
    """Equal total lengths with other cuts and other channels inside: the layout that was learnt does not mislead."""
    path = tmp_path / "a.mcap"
    writer = McapWriter(path)
    for channel in (1, 2, 3):
        writer.add_channel(channel, f"/{channel}", "cdr", SCHEMA, {})
    shapes = [((1, 10), (2, 20)), ((1, 20), (2, 10)), ((2, 10), (3, 20)), ((1, 10), (2, 20))]
    parts, expected = [], []
    for number in range(60):
        shape = shapes[number % 4] if number >= 20 else shapes[0]
        parts.append(b"".join(message(channel, number, number, bytes([number] * size)) for channel, size in shape))
        expected += [(channel, number, bytes([number] * size)) for channel, size in shape]
    writer.write_chunk(parts[:20])
    writer.write_chunk(parts[20:])
    writer.close()
    with open(path, "rb") as file:
        found = [(m.channel_id, m.log_time, m.data) for _, _, m in make_reader(file).iter_messages()]
    assert sorted(found) == sorted(expected)


def test_what_is_not_whole_messages_is_refused(tmp_path: Path) -> None:
    """A cut tick and a channel nobody declared are errors of the writer, not damage in the file."""
    writer = McapWriter(tmp_path / "a.mcap")
    writer.add_channel(1, "/a", "cdr", SCHEMA, {})
    with pytest.raises(RecordError, match="ends inside a record"):
        writer.write_chunk([message(1, 0, 0, b"abc")[:-1]])
    with pytest.raises(RecordError, match=r"channels \[2\]"):
        writer.write_chunk([message(2, 0, 0, b"abc")])
    with pytest.raises(RecordError, match="both /a and /b"):
        writer.add_channel(1, "/b", "cdr", SCHEMA, {})
    writer.write_chunk([message(1, 0, 0, b"abc")])
    writer.close()
    with open(tmp_path / "a.mcap", "rb") as file:
        assert [m.data for _, _, m in make_reader(file).iter_messages()] == [b"abc"]
