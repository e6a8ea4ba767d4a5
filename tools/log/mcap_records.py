"""Walks an MCAP file record by record, a damaged one too: everything whole, and how much of it is not.

The mcap library's reader refuses a file without its footer. A killed recorder leaves exactly that.
"""

from __future__ import annotations

import io
import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from bus.errors import RecordError
from tools.log.mcap_writer import MCAP_MAGIC
from tools.log.message_index import EMPTY, MessageTable, walk_messages

RECORD_HEAD: Final = struct.Struct("<BQ")
CHUNK_HEAD: Final = struct.Struct("<QQQII")  # start, end, uncompressed size, crc, length of the compression's name
INDEX_HEAD: Final = struct.Struct("<HI")
DATA_SECTION_ENDS: Final = {Opcode.DATA_END, Opcode.FOOTER}


@dataclass(frozen=True, slots=True)
class Stretch:
    """Decompressed bytes of one chunk and where the messages in it are."""

    data: bytes
    table: MessageTable


@dataclass(slots=True)
class McapContent:
    """Everything in a file. `complete`: it ends as it should, with a summary or at least a footer."""

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)
    attachments: list[Attachment] = field(default_factory=list)
    stretches: list[Stretch] = field(default_factory=list)
    complete: bool = False
    size: int = 0
    whole: int = 0  # bytes up to the end of the last whole record
    damaged_chunks: int = 0
    salvaged: int = 0  # messages out of a chunk that was not whole


def read_content(path: Path | str) -> McapContent:
    """Everything that can be had from the file. Raises RecordError when it is no MCAP file or cannot be read."""
    content = McapContent(Path(path))
    try:
        data = content.path.read_bytes()
    except OSError as error:
        raise RecordError(f"{path}: cannot read the log: {error.strerror}") from None
    content.size = len(data)
    if data[: len(MCAP_MAGIC)] != MCAP_MAGIC:
        raise RecordError(f"{path}: this is not an MCAP file (it does not start with the bytes 89 4D 43 41 50 30)")
    _walk(content, data)
    if not content.complete:
        _salvage_tail(content, data)
    return content


def _walk(content: McapContent, data: bytes) -> None:
    at = len(MCAP_MAGIC)
    content.whole = at
    waiting: Stretch | None = None  # the chunk whose message indexes follow
    indexes: list[bytes] = []
    while at + RECORD_HEAD.size <= len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        end = at + RECORD_HEAD.size + length
        if end > len(data):
            break
        body = data[at + RECORD_HEAD.size : end]
        if opcode == Opcode.MESSAGE_INDEX:
            indexes.append(body)
        else:
            _finish_stretch(content, waiting, indexes)
            waiting, indexes = None, []
            if opcode == Opcode.CHUNK:
                waiting = _open_chunk(content, body)
            elif opcode == Opcode.MESSAGE:
                record = data[at:end]
                content.stretches.append(Stretch(record, walk_messages(record)[0]))
            elif opcode in DATA_SECTION_ENDS:
                content.complete = data.endswith(MCAP_MAGIC)
            else:
                _take(content, opcode, body)
        at = content.whole = end
        if opcode == Opcode.FOOTER:
            break
    _finish_stretch(content, waiting, indexes)


def _take(content: McapContent, opcode: int, body: bytes) -> None:
    """Keep a record that is not data."""
    stream = ReadDataStream(io.BytesIO(body))
    if opcode == Opcode.SCHEMA:
        schema = Schema.read(stream)
        content.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = Channel.read(stream)
        content.channels[channel.id] = channel
    elif opcode == Opcode.METADATA:
        content.metadata.append(Metadata.read(stream))
    elif opcode == Opcode.ATTACHMENT:
        content.attachments.append(Attachment.read(stream))


def _open_chunk(content: McapContent, body: bytes) -> Stretch | None:
    """The chunk's data, its messages not looked for yet; None when it is damaged."""
    _, _, size, crc, name_length = CHUNK_HEAD.unpack_from(body)
    at = CHUNK_HEAD.size
    name = body[at : at + name_length].decode("ascii", "replace")
    packed = body[at + name_length + 8 :]
    try:
        data = decompress(name, packed, size)
    except (zstandard.ZstdError, RuntimeError):
        content.damaged_chunks += 1
        return None
    if len(data) != size or (crc and zlib.crc32(data) != crc):
        content.damaged_chunks += 1
        return None
    return Stretch(data, EMPTY)


def decompress(name: str, packed: bytes, size: int) -> bytes:
    """The data of a chunk. Raises what the decompressor raises for a damaged one, RecordError for an unknown one."""
    if name == "zstd":
        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    if name == "lz4":
        return bytes(lz4.frame.decompress(packed))
    if name == "":
        return packed
    raise RecordError(f'chunk compression "{name}" is not one of zstd, lz4, none')


def _finish_stretch(content: McapContent, stretch: Stretch | None, indexes: list[bytes]) -> None:
    """Find the messages of a chunk, from its indexes where it has them, else record by record."""
    if stretch is None:
        return
    table = _read_indexes(stretch.data, indexes) if indexes else None
    if table is None:
        table, _ = walk_messages(stretch.data)
        _take_inner(content, stretch.data)
    content.stretches.append(Stretch(stretch.data, table))


def _take_inner(content: McapContent, data: bytes) -> None:
    """Keep the schemas and channels that other writers put inside chunks."""
    at = 0
    while at + RECORD_HEAD.size <= len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        end = at + RECORD_HEAD.size + length
        if opcode != Opcode.MESSAGE:
            _take(content, opcode, data[at + RECORD_HEAD.size : end])
        at = end


def _read_indexes(data: bytes, indexes: list[bytes]) -> MessageTable | None:
    """The table that the message indexes describe; None when they do not cover the chunk byte for byte."""
    channels, pairs = [], []
    for body in indexes:
        channel, size = INDEX_HEAD.unpack_from(body)
        entries = np.frombuffer(body, "<i8", size // 8, INDEX_HEAD.size).reshape(-1, 2)
        pairs.append(entries)
        channels.append(np.full(len(entries), channel, np.int64))
    merged, channel_of = np.concatenate(pairs), np.concatenate(channels)
    order = np.argsort(merged[:, 1])
    log_time, offset = merged[order].T
    sizes = np.diff(offset, append=len(data))
    if not len(offset) or offset[0] != 0 or offset[-1] + 9 > len(data) or (sizes < 31).any():
        return None
    raw = np.frombuffer(data, np.uint8)
    lengths = np.ascontiguousarray(raw[offset[:, None] + np.arange(1, 9)]).view("<i8").ravel()
    if (lengths + 9 != sizes).any() or (raw[offset] != Opcode.MESSAGE).any():
        return None
    return MessageTable(channel_of[order], log_time, offset, sizes)


def _salvage_tail(content: McapContent, data: bytes) -> None:
    """Take the whole messages out of a chunk that the file ends in the middle of."""
    at = content.whole
    if at + RECORD_HEAD.size + CHUNK_HEAD.size > len(data) or data[at] != Opcode.CHUNK:
        return
    at += RECORD_HEAD.size
    *_, name_length = CHUNK_HEAD.unpack_from(data, at)
    at += CHUNK_HEAD.size
    name, packed = data[at : at + name_length], data[at + name_length + 8 :]
    try:
        if name == b"zstd":
            inside = zstandard.ZstdDecompressor().decompressobj().decompress(packed)
        elif name == b"lz4":
            inside = bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed))
        else:
            inside = packed
    except (zstandard.ZstdError, RuntimeError):
        return
    table, whole = walk_messages(inside)
    if len(table.channel):
        content.stretches.append(Stretch(inside[:whole], table))
        content.salvaged = len(table.channel)
