"""The chunk indexes of a log under construction, packed: a day's log has ten thousand of them, and each is a small table."""

from __future__ import annotations

import zlib
from typing import Final

from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex

BLOCK_BYTES: Final = 64 * 1024


class ChunkIndexes:
    """What the summary says of chunks: their index records, how many, and the time they span [ns]."""

    def __init__(self) -> None:
        self.count = 0
        self.first_ns = 0
        self.last_ns = 0
        self._blocks: list[bytes] = []
        self._open = bytearray()

    def add(self, index: ChunkIndex) -> None:
        """Take the index of the next chunk."""
        self.first_ns = min(self.first_ns, index.message_start_time) if self.count else index.message_start_time
        self.last_ns = max(self.last_ns, index.message_end_time)
        self.count += 1
        builder = RecordBuilder()
        index.write(builder)
        self._open += builder.end()  # type: ignore[no-untyped-call]
        if len(self._open) >= BLOCK_BYTES:
            self._blocks.append(zlib.compress(self._open, 1))
            self._open.clear()

    def format(self) -> bytes:
        """All index records, one behind the other."""
        return b"".join((*map(zlib.decompress, self._blocks), self._open))
