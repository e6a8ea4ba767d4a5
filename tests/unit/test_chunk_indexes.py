"""The chunk indexes of a long log: nothing of them is lost, and a day of them is small."""

from __future__ import annotations

import io
import tracemalloc

import pytest
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import ChunkIndex

from tools.log.chunk_indexes import ChunkIndexes

CHUNKS_OF_A_DAY = 9000  # of 512 kB, for 4.5 GB at 100 Hz
CHANNELS = range(1, 31)


def make_index(number: int) -> ChunkIndex:
    """As long as they are: sizes that vary, an offset for each of thirty channels."""
    start = number * 130_000 + number * number % 9973
    return ChunkIndex(
        chunk_length=120_000 + number * 7919 % 9000, chunk_start_offset=start, compression="zstd",
        compressed_size=119_900 + number * 7919 % 9000, message_end_time=(number + 1) * 1_170_000_000,
        message_index_length=30_000, message_start_time=number * 1_170_000_000, uncompressed_size=524_288,
        message_index_offsets={channel: start + 120_000 + 1900 * channel + channel * number % 16 for channel in CHANNELS},
    )  # fmt: skip


def test_what_was_added_comes_back_and_a_day_takes_less_than_2_mb() -> None:
    """Read back with the mcap library's own class, one by one; the growth is what the allocator counts."""
    tracemalloc.start()
    try:
        indexes = ChunkIndexes()
        before, _ = tracemalloc.get_traced_memory()
        for number in range(CHUNKS_OF_A_DAY):
            indexes.add(make_index(number))
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 2_000_000
    assert (indexes.count, indexes.first_ns, indexes.last_ns) == (CHUNKS_OF_A_DAY, 0, CHUNKS_OF_A_DAY * 1_170_000_000)
    stream = ReadDataStream(io.BytesIO(indexes.format()))
    for number in range(CHUNKS_OF_A_DAY):
        assert stream.read1() == Opcode.CHUNK_INDEX
        stream.read8()
        assert ChunkIndex.read(stream) == make_index(number)
    with pytest.raises(EndOfFile):
        stream.read1()
