"""Walks an MCAP file record by record, a damaged one too: everything whole, and how much of it is not.

The mcap library's reader refuses a file without its footer. A killed recorder leaves exactly that. Nothing of the file is
held but its small records and where its chunks are: messages are read again, chunk by chunk, whenever they are asked for.
"""

from __future__ import annotations

import io
import os
import stat
import struct
import weakref
import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from bus.errors import RecordError
from tools.log.decompression import MAX_CHUNK_BYTES, DamagedData, decompress, decompress_beginning
from tools.log.mcap_writer import MCAP_MAGIC
from tools.log.message_index import MessageTable, read_indexes, walk_messages
from tools.log.tally import Tally

RECORD_HEAD: Final = struct.Struct("<BQ")
CHUNK_HEAD: Final = struct.Struct("<QQQII")  # start, end, uncompressed size, crc, length of the compression's name
LENGTH: Final = struct.Struct("<Q")
LONGEST_NAME: Final = 64  # of a compression [bytes]
LONGEST_RECORD: Final = MAX_CHUNK_BYTES + 1024 * 1024
BATCH_BYTES: Final = 1024 * 1024  # of messages outside chunks, read together
KEPT: Final[dict[int, Any]] = {
    Opcode.HEADER: Header, Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel, Opcode.METADATA: Metadata,
    Opcode.ATTACHMENT: Attachment,
}  # fmt: skip
UNREADABLE: Final = (McapError, struct.error, ValueError, KeyError, IndexError, OverflowError, MemoryError, EOFError)


class Piece(NamedTuple):
    """Where in the file the messages of a chunk lie, those of a chunk that is not whole, or some outside chunks."""

    kind: int  # CHUNK, MESSAGE, or 0 for the beginning of a chunk
    offset: int  # of the chunk's body, or of the first message record
    length: int
    index_length: int = 0  # of the message indexes right behind it


class LostChunk(NamedTuple):
    """A chunk that cannot be read. Its times are what its head says, which may be damaged too."""

    start_ns: int
    end_ns: int
    why: str


class Stretch(NamedTuple):
    """Decompressed bytes of one chunk and where the messages in it are."""

    data: bytes
    table: MessageTable
    damaged_records: int = 0
    inner: tuple[tuple[int, bytes], ...] = ()  # opcode and body of records in it that are not messages


class McapContent:
    """What is in a file. `complete`: it ends as it should, with its data section closed and the magic at its end."""

    def __init__(self, path: Path | str) -> None:
        """Open and survey a log. Raises RecordError when it is no MCAP file or cannot be read."""
        self.path = Path(path)
        self.library = ""
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.metadata: list[Metadata] = []
        self.attachments: list[Attachment] = []
        self.pieces: list[Piece] = []
        self.tallies: dict[int, Tally] = {}  # by channel
        self._there: list[frozenset[int]] = []  # channels that each of the pieces has messages of
        self.complete = False
        self.lost_chunks: list[LostChunk] = []
        self.damage: Counter[str] = Counter()  # what else is damaged -> how often
        self.salvaged = 0  # messages out of a chunk that was not whole
        self.whole = len(MCAP_MAGIC)  # bytes up to the end of the last whole record
        try:
            if not stat.S_ISREG(os.stat(path).st_mode) and not self.path.is_dir():
                raise RecordError(f"{path}: this is a device or a pipe; a log is read from a file")
            file = open(path, "rb", buffering=1 << 16)  # noqa: SIM115 - closed with the object
            weakref.finalize(self, file.close)
            self._file: BinaryIO = file
            self.size = os.fstat(file.fileno()).st_size
            magic = file.read(len(MCAP_MAGIC))
            if magic != MCAP_MAGIC:
                raise RecordError(
                    f"{path}: this is not an MCAP file (it does not start with the bytes 89 4D 43 41 50 30)"
                )
            self._walk()
            self._survey()
        except (OSError, ValueError) as error:
            raise RecordError(f"{path}: cannot read the log: {getattr(error, 'strerror', None) or error}") from None

    # -- records of the file ---------------------------------------------------------------------------------------

    def _walk(self) -> None:
        at, ends = self.whole, False
        while at + RECORD_HEAD.size <= self.size:
            opcode, length = RECORD_HEAD.unpack(self._read(at, RECORD_HEAD.size))
            body, end = at + RECORD_HEAD.size, at + RECORD_HEAD.size + length
            if end > self.size:
                break
            if opcode == Opcode.CHUNK:
                self.pieces.append(Piece(opcode, body, length))
            elif opcode == Opcode.MESSAGE:
                self._add_message(at, end)
            elif opcode == Opcode.MESSAGE_INDEX:
                self._add_index(at, end)
            elif opcode in KEPT:
                self._take(opcode, self._read(body, length) if length <= LONGEST_RECORD else b"")
            ends = ends or opcode == Opcode.DATA_END
            at = self.whole = end
            if opcode == Opcode.FOOTER:
                ends = True
                break
        tail = self._read(self.size - len(MCAP_MAGIC), len(MCAP_MAGIC))
        self.complete = ends and tail == MCAP_MAGIC
        if not self.complete and at + RECORD_HEAD.size < self.size and self._read(at, 1)[0] == Opcode.CHUNK:
            body = at + RECORD_HEAD.size
            self.pieces.append(Piece(0, body, min(self.size - body, LONGEST_RECORD)))

    def _read(self, offset: int, length: int) -> bytes:
        self._file.seek(offset)
        return self._file.read(length)

    def _add_message(self, at: int, end: int) -> None:
        last = self.pieces[-1] if self.pieces else None
        if (
            last is not None
            and last.kind == Opcode.MESSAGE
            and last.offset + last.length == at < last.offset + BATCH_BYTES
        ):
            self.pieces[-1] = last._replace(length=end - last.offset)
        else:
            self.pieces.append(Piece(Opcode.MESSAGE, at, end - at))

    def _add_index(self, at: int, end: int) -> None:
        last = self.pieces[-1] if self.pieces else None
        if last is not None and last.kind == Opcode.CHUNK and last.offset + last.length + last.index_length == at:
            self.pieces[-1] = last._replace(index_length=end - last.offset - last.length)

    def _take(self, opcode: int, body: bytes) -> None:
        """Keep a record that is not data; a damaged one is counted."""
        name = Opcode(opcode).name.lower()
        try:
            record = KEPT[opcode].read(ReadDataStream(io.BytesIO(body)))
        except UNREADABLE:
            self.damage[f"{name} record"] += 1
            return
        match record:
            case Header():
                self.library = record.library
            case Schema():
                if self.schemas.setdefault(record.id, record) != record:
                    self.damage["schema record that contradicts another"] += 1
            case Channel():
                if self.channels.setdefault(record.id, record) != record:
                    self.damage["channel record that contradicts another"] += 1
            case Metadata():
                self.metadata.append(record)
            case Attachment():
                crc = int.from_bytes(body[-4:], "little")
                if crc and crc != zlib.crc32(body[:-4]):
                    self.damage[f"attachment {record.name[:40]!r} (its checksum does not match)"] += 1
                else:
                    self.attachments.append(record)

    # -- messages --------------------------------------------------------------------------------------------------

    def _survey(self) -> None:
        """Read every chunk once: which are damaged, how many messages of which channel and tick there are."""
        whole: list[Piece] = []
        kinds: dict[frozenset[int], frozenset[int]] = {}
        for piece in self.pieces:
            try:
                stretch = self._open(piece)
            except DamagedData as error:
                start_ns, end_ns = _read_times(self._read(piece.offset, CHUNK_HEAD.size))
                self.lost_chunks.append(LostChunk(start_ns, end_ns, str(error)))
                continue
            if stretch.damaged_records:
                self.damage["message record"] += stretch.damaged_records
            for opcode, body in stretch.inner:
                if opcode in KEPT:
                    self._take(opcode, body)
            if piece.kind == 0:
                self.salvaged = len(stretch.table.channel)
            split = list(stretch.table.split())
            for channel, rows in split:
                self.tallies.setdefault(channel, Tally()).add(
                    stretch.table.sequence[rows], stretch.table.log_time_ns[rows]
                )
            whole.append(piece)
            there = frozenset([channel for channel, _ in split])
            self._there.append(kinds.setdefault(there, there))
        self.pieces = whole

    def stretches(self, channels: Collection[int] | None = None) -> Iterator[Stretch]:
        """The chunks that can be read, in file order, one at a time.

        channels : only those with a message of one of these; None: all
        """
        for piece, there in zip(self.pieces, self._there, strict=True):
            if channels is not None and there.isdisjoint(channels):
                continue
            try:
                yield self._open(piece)
            except DamagedData as error:  # it was whole a moment ago
                raise RecordError(f"{self.path}: the log changed while it was read: {error}") from None
            except OSError as error:
                raise RecordError(f"{self.path}: cannot read the log: {error.strerror}") from None

    def _open(self, piece: Piece) -> Stretch:
        raw = self._read(piece.offset, min(piece.length, LONGEST_RECORD) + piece.index_length)
        if piece.kind == Opcode.MESSAGE:
            return _locate(raw, b"")
        if piece.length > LONGEST_RECORD:
            raise DamagedData(f"it has {piece.length} bytes, more than the {LONGEST_RECORD} that are read")
        body, indexes = raw[: piece.length], raw[piece.length :]
        if len(raw) != piece.length + piece.index_length:
            raise DamagedData("the file has become shorter")
        name, packed, size, crc = _open_chunk(body)
        if piece.kind == 0:
            data = decompress_beginning(name, packed, size)
            walk = walk_messages(data)
            return Stretch(data[: walk.whole], walk.table, walk.short, walk.inner)
        data = decompress(name, packed, size)
        if crc and zlib.crc32(data) != crc:
            raise DamagedData("its checksum does not match")
        return _locate(data, indexes)


def _locate(data: bytes, indexes: bytes) -> Stretch:
    """Find the messages of a chunk, from its indexes where those cover it byte for byte, else record by record."""
    table = read_indexes(data, indexes) if indexes else None
    if table is not None:
        return Stretch(data, table)
    walk = walk_messages(data)
    return Stretch(data, walk.table, walk.short + (walk.whole != len(data)), walk.inner)


def _open_chunk(body: bytes) -> tuple[str, bytes, int, int]:
    """Compression, packed data, declared size and checksum. Bytes behind the data are room for later MCAP versions."""
    if len(body) < CHUNK_HEAD.size:
        raise DamagedData("its head is cut short")
    _, _, size, crc, name_length = CHUNK_HEAD.unpack_from(body)
    at = CHUNK_HEAD.size + name_length
    if name_length > LONGEST_NAME or at + LENGTH.size > len(body):
        raise DamagedData("its head is cut short")
    (length,) = LENGTH.unpack_from(body, at)
    packed = body[at + LENGTH.size : at + LENGTH.size + length]
    return body[CHUNK_HEAD.size : at].decode("ascii", "replace"), packed, size, crc


def _read_times(head: bytes) -> tuple[int, int]:
    return CHUNK_HEAD.unpack(head)[:2] if len(head) == CHUNK_HEAD.size else (0, 0)
