"""Writes MCAP files from ready-made Message records, chunk by chunk, with every index a viewer wants.

Schema, channel, metadata and attachment records stand outside chunks, before the data, so that the file of a killed
run explains itself. Records are laid down by the mcap library's own classes; only Message, Chunk and MessageIndex,
which come by the hundred, are assembled here.
"""

from __future__ import annotations

import contextlib
import os
import stat
import struct
import time
import zlib
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import IO, Final, Literal, Self

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from bus.errors import RecordError
from tools.log.chunk_indexes import ChunkIndexes
from tools.log.message_index import LayoutIndex, Pairs

Compression = Literal["zstd", "lz4", ""]

MCAP_MAGIC: Final = b"\x89MCAP0\r\n"
LIBRARY: Final = "hilsat"
DATA_END_SIZE: Final = 13
ZSTD_LEVEL: Final = -1  # docs/decisions/0001-telemetry-encoding.md
REMEMBERED: Final = 128  # schemas and channels whose records are kept; a run has some twenty of each
CHUNK_HEAD: Final = struct.Struct("<BQQQQI")  # opcode, length, start, end, uncompressed size, crc
INDEX_HEAD: Final = struct.Struct("<BQHI")  # opcode, length, channel, bytes of entries


def choose_compressor(compression: Compression) -> Callable[[bytes], bytes]:
    """A function that compresses a chunk into one frame with its own checksum (so the chunk needs no CRC-32)."""
    if compression == "zstd":
        return zstandard.ZstdCompressor(level=ZSTD_LEVEL, write_checksum=True, write_content_size=True).compress
    if compression == "lz4":
        return lambda data: bytes(lz4.frame.compress(data, content_checksum=True))
    return lambda data: data


def is_device(path: Path | str) -> bool:
    """Whether it is a device, a pipe or a file that lies in memory only: there is nothing in it to lose."""
    try:
        found = os.stat(path)
    except OSError:
        return False
    return stat.S_ISCHR(found.st_mode) or stat.S_ISFIFO(found.st_mode) or found.st_nlink == 0


def is_taken(path: Path | str) -> bool:
    """Whether a new log cannot have this name, because something has it."""
    return os.path.lexists(path) and not is_device(path)


class McapWriter:
    """An MCAP file under construction. What has been written is readable at any time, index or not.

    replace : a file of that name may go
    Raises RecordError when the file is there already, cannot be made or a write fails; it then ends with its last whole
    record.
    """

    def __init__(self, path: Path | str, *, compression: Compression = "zstd", replace: bool = False) -> None:
        self._start(Path(path), "wb" if replace or is_device(path) else "xb", compression)
        self._put(MCAP_MAGIC, Header(profile="", library=LIBRARY))

    def _start(self, path: Path, mode: str, compression: Compression) -> None:
        self.path = path
        self._compression = compression
        self._compress = choose_compressor(compression)
        self._layouts = LayoutIndex()
        # The last hand on a chunk before it is packed.
        self.complete: Callable[[dict[int, Pairs], bytes], bytes] | None = None
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._chunks = ChunkIndexes()
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: dict[int, int] = {}
        self._size = 0
        try:
            self._file: IO[bytes] = open(path, mode, buffering=0)  # noqa: SIM115 - closed by close()
        except FileExistsError:
            raise RecordError(f"{path}: cannot write the log: there is a file of that name; name another one") from None
        except OSError as error:
            raise RecordError(f"{path}: cannot write the log: {error.strerror}; name another file with --out") from None

    @classmethod
    def resume(cls, path: Path | str) -> Self:
        """Open a finished file to add to its end. Raises RecordError for a file without a summary."""
        from mcap.reader import SeekingReader  # who only reads logs is not to wait for it

        writer = cls.__new__(cls)
        writer._start(Path(path), "r+b", "zstd")
        try:
            with open(path, "rb") as reading:  # the reader closes an unbuffered file that it is given
                summary = SeekingReader(reading).get_summary()
            writer._file.seek(-(len(MCAP_MAGIC) + 20), os.SEEK_END)
            start = int.from_bytes(writer._file.read(8), "little")
        except (McapError, OSError) as error:
            summary, start = None, 0
            reason = f" ({error})"
        else:
            reason = ""
        if summary is None or start < DATA_END_SIZE:
            writer._file.close()
            raise RecordError(f"{path}: cannot add to a log that was not finished{reason}; run `hilsat recover` on it")
        writer._schemas, writer._channels = dict(summary.schemas), dict(summary.channels)
        for index in summary.chunk_indexes:
            writer._chunks.add(index)
        writer._attachments, writer._metadata = list(summary.attachment_indexes), list(summary.metadata_indexes)
        if summary.statistics:
            writer._counts = dict(summary.statistics.channel_message_counts)
        writer._size = start - DATA_END_SIZE
        writer._file.truncate(writer._size)
        writer._file.seek(writer._size)
        return writer

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._size

    @property
    def message_count(self) -> int:
        return sum(self._counts.values())

    def has_channel(self, channel: int) -> bool:
        return channel in self._channels

    def add_channel(
        self, channel: int, topic: str, encoding: str, schema: tuple[str, str, str | bytes], metadata: Mapping[str, str]
    ) -> None:
        """Declare a channel before its first message. `schema`: name, encoding, text (bytes for a binary one)."""
        if channel in self._channels:
            raise RecordError(f"channel {channel} is both {self._channels[channel].topic} and {topic}")
        name, schema_encoding, text = schema
        data = text if isinstance(text, bytes) else text.encode()
        known = [s.id for s in self._schemas.values() if (s.name, s.encoding, s.data) == (name, schema_encoding, data)]
        if known:
            schema_id = known[0]
        elif not (name or schema_encoding or data):
            schema_id = 0  # which stands for none
        else:
            schema_id = len(self._schemas) + 1
            self._schemas[schema_id] = Schema(id=schema_id, name=name, encoding=schema_encoding, data=data)
            self._put(format_schema(self._schemas[schema_id]))
        self._channels[channel] = Channel(
            id=channel, topic=topic, message_encoding=encoding, metadata=dict(metadata), schema_id=schema_id
        )
        self._put(format_channel(self._channels[channel]))

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        start = self._put(Metadata(name=name, metadata=dict(values)))
        self._metadata.append(MetadataIndex(offset=start, length=self._size - start, name=name))

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        now_ns = time.time_ns()
        start = self._put(Attachment(create_time=now_ns, log_time=now_ns, name=name, media_type=media_type, data=data))
        index = AttachmentIndex(
            offset=start, length=self._size - start, log_time=now_ns, create_time=now_ns,
            data_size=len(data), name=name, media_type=media_type,
        )  # fmt: skip
        self._attachments.append(index)

    def write_chunk(self, parts: list[bytes]) -> None:
        """Write one chunk of ticks, each of which is whole Message records, and its message index."""
        data = b"".join(parts)
        table, first_ns, last_ns = self._layouts.locate(parts, data)
        if not table:
            return
        unknown = table.keys() - self._channels.keys()
        if unknown:
            raise RecordError(f"telemetry on channels {sorted(unknown)}, which no process announced")
        if self.complete is not None:
            data = self.complete(table, data)
        packed = self._compress(data)
        name = self._compression.encode()
        crc = 0 if name else zlib.crc32(data)
        head = CHUNK_HEAD.pack(
            Opcode.CHUNK, 40 + len(name) + len(packed), first_ns, last_ns, len(data), crc
        ) + struct.pack(f"<I{len(name)}sQ", len(name), name, len(packed))
        start = self._size
        chunk_length = len(head) + len(packed)
        offsets: dict[int, int] = {}
        indexes: list[bytes] = []
        at = start + chunk_length
        for channel, pairs in table.items():
            size = 16 * len(pairs)
            indexes += INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size), pairs.tobytes()
            offsets[channel] = at
            at += INDEX_HEAD.size + size
            self._counts[channel] = self._counts.get(channel, 0) + len(pairs)
        self._write(b"".join((head, packed, *indexes)))
        index = ChunkIndex(
            message_start_time=first_ns, message_end_time=last_ns, chunk_start_offset=start,
            chunk_length=chunk_length, message_index_offsets=offsets,
            message_index_length=self._size - start - chunk_length, compression=self._compression,
            compressed_size=len(packed), uncompressed_size=len(data),
        )  # fmt: skip
        self._chunks.add(index)

    def close(self) -> None:
        """Write the summary and close the file. Harmless when repeated."""
        if self._file.closed:
            return
        try:
            self._put(DataEnd(data_section_crc=0))
            self._write(self._format_summary() + MCAP_MAGIC)
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close after a failed write: with the summary if it still fits, else with the last whole record."""
        end = self._size
        try:
            self.close()
        except RecordError:
            with contextlib.suppress(OSError):
                os.truncate(self.path, end)

    def _format_summary(self) -> bytes:
        start = self._size
        groups = {
            Opcode.SCHEMA: b"".join(map(format_schema, self._schemas.values())),
            Opcode.CHANNEL: b"".join(map(format_channel, self._channels.values())),
            Opcode.STATISTICS: format_records(self._count_all()),
            Opcode.CHUNK_INDEX: self._chunks.format(),
            Opcode.ATTACHMENT_INDEX: format_records(*self._attachments),
            Opcode.METADATA_INDEX: format_records(*self._metadata),
        }
        body, offsets = b"", b""
        for opcode, records in groups.items():
            if records:
                offsets += format_records(SummaryOffset(opcode, start + len(body), len(records)))
                body += records
        offsets_start = start + len(body)
        crc = zlib.crc32(body + offsets + struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offsets_start))
        return body + offsets + format_records(Footer(start, offsets_start, crc))

    def _count_all(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments), channel_count=len(self._channels),
            channel_message_counts=self._counts, chunk_count=self._chunks.count, message_count=self.message_count,
            message_end_time=self._chunks.last_ns, message_start_time=self._chunks.first_ns,
            metadata_count=len(self._metadata), schema_count=len(self._schemas),
        )  # fmt: skip

    def _put(self, *pieces: McapRecord | bytes) -> int:
        """Write records; the offset of the first."""
        start = self._size
        self._write(b"".join(piece if isinstance(piece, bytes) else format_records(piece) for piece in pieces))
        return start

    def _write(self, data: bytes) -> None:
        view = memoryview(data)
        try:
            while view:
                view = view[self._file.write(view) :]
        except OSError as error:
            with contextlib.suppress(OSError):  # a device has no length to cut
                self._file.truncate(self._size)
                self._file.seek(self._size)
            raise RecordError(
                f"{self.path}: cannot write the log: {error.strerror} after {self._size / 1e6:.1f} MB; "
                "what was written stays readable; free some space or name another place with --out"
            ) from None
        self._size += len(data)


def format_schema(schema: Schema) -> bytes:
    """The record of a schema."""
    return _lay_down_schema(schema.id, schema.name, schema.encoding, schema.data)


def format_channel(channel: Channel) -> bytes:
    """The record of a channel."""
    metadata = tuple(channel.metadata.items())
    return _lay_down_channel(channel.id, channel.topic, channel.message_encoding, metadata, channel.schema_id)


# Every log has them twice, and the next log of this process has the same again.
@lru_cache(maxsize=REMEMBERED)
def _lay_down_schema(number: int, name: str, encoding: str, data: bytes) -> bytes:
    return format_records(Schema(id=number, name=name, encoding=encoding, data=data))


@lru_cache(maxsize=REMEMBERED)
def _lay_down_channel(
    number: int, topic: str, encoding: str, metadata: tuple[tuple[str, str], ...], schema_id: int
) -> bytes:
    return format_records(
        Channel(id=number, topic=topic, message_encoding=encoding, metadata=dict(metadata), schema_id=schema_id)
    )


def format_records(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    laid_down: bytes = builder.end()  # type: ignore[no-untyped-call]
    return laid_down
