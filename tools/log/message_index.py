"""Where the messages lie in a stretch of MCAP Message records: found by walking it, or by knowing how ticks look.

Walking costs 0.3 us a record. A run's ticks all look alike, so `LayoutIndex` walks one tick of each length and checks
the others against it, byte by byte of every record head, all at once; what does not match is walked.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus.errors import RecordError
from bus.native import COMPILED

Ints = NDArray[np.int64]
Words = NDArray[np.uint64]
Pairs = NDArray[np.uint64]  # one row a message: log time [ns], offset

HEAD: Final = struct.Struct("<BQHIq")  # opcode, length, channel, sequence, log_time
INDEX_HEAD: Final = struct.Struct("<BQHI")  # opcode, length, channel, bytes of entries
MESSAGE: Final = 0x05
RECORD_HEAD: Final = 9  # opcode and length
SIZE_AT, CHANNEL_AT, TIME_AT = 0, 7, 15  # eight bytes each: opcode and length; its end, channel, sequence; log time
CHANNEL_BITS: Final = np.uint64(0xFFFFFFFF)  # of the second: without the sequence
DATA_AT: Final = 31
FEW: Final = 4  # below this many alike, walking is quicker


class MessageTable(NamedTuple):
    """One row a message, in file order."""

    channel: Ints
    sequence: Ints
    log_time_ns: Ints  # beyond the year 2262 these turn negative
    offset: Ints  # of the record's first byte
    size: Ints  # of the record, head included

    def split(self) -> Iterator[tuple[int, Ints]]:
        """Each channel with the rows of its messages."""
        order = np.argsort(self.channel.astype(np.uint16), kind="stable")  # 16 bits are sorted by counting
        found, starts = np.unique(self.channel[order], return_index=True)
        yield from zip(found.tolist(), np.split(order, starts[1:]), strict=False)


EMPTY: Final = MessageTable(*(np.empty(0, np.int64),) * 5)


class Walk(NamedTuple):
    """What walking some bytes found."""

    table: MessageTable
    whole: int  # bytes that are whole records
    short: int  # message records too short to be any
    inner: tuple[tuple[int, bytes], ...]  # opcode and body of the records that are not messages


def walk_messages(data: bytes, base: int = 0) -> Walk:
    """The messages in `data`, record by record. Offsets count from `base`."""
    rows: list[tuple[int, int, int, int, int]] = []
    inner: list[tuple[int, bytes]] = []
    at, end, short, unpack = 0, len(data), 0, HEAD.unpack_from
    while at + RECORD_HEAD <= end:
        size = RECORD_HEAD + int.from_bytes(data[at + 1 : at + RECORD_HEAD], "little")
        if at + size > end:
            break
        if data[at] != MESSAGE:
            inner.append((data[at], data[at + RECORD_HEAD : at + size]))
        elif size < DATA_AT:
            short += 1
        else:
            _, _, channel, sequence, log_time = unpack(data, at)
            rows.append((channel, sequence, log_time, base + at, size))
        at += size
    table = MessageTable(*np.array(rows, np.int64).T) if rows else EMPTY
    return Walk(table, at, short, tuple(inner))


def read_indexes(data: bytes, indexes: bytes) -> MessageTable | None:
    """The messages at the offsets that the MessageIndex records name; None when those do not cover `data` whole.

    Only offsets are taken from the index, and only when the records there join up from the first byte to the last:
    that is what walking would find. Channel, sequence and time are the message's own.
    """
    found, at = [], 0
    while at < len(indexes):
        if at + INDEX_HEAD.size > len(indexes):
            return None
        _, length, _, size = INDEX_HEAD.unpack_from(indexes, at)
        start, end = at + INDEX_HEAD.size, at + RECORD_HEAD + length
        if size % 16 or start + size > min(end, len(indexes)):
            return None
        found.append(np.frombuffer(indexes, "<i8", size // 8, start)[1::2])
        at = end
    offset = np.sort(np.concatenate(found)) if found else np.empty(0, np.int64)
    size_of = np.diff(offset, append=len(data))
    if not offset.size or offset[0] != 0 or (size_of < DATA_AT).any():
        return None
    words = view_words(data)
    middle = words[offset + CHANNEL_AT]
    if (words[offset + 1].view("<i8") + RECORD_HEAD != size_of).any() or (words[offset] & 0xFF != MESSAGE).any():
        return None
    channel, sequence = (middle >> np.uint64(16)) & np.uint64(0xFFFF), middle >> np.uint64(32)
    log_time = words[offset + TIME_AT].view("<i8")
    return MessageTable(channel.astype(np.int64), sequence.astype(np.int64), log_time, offset, size_of)


@dataclass(frozen=True, slots=True)
class Layout:
    """What one tick looks like: its channels, where its records start, and what their heads begin with."""

    channels: tuple[int, ...]
    offsets: Ints
    sizes: Words
    tails: Words


class Located(NamedTuple):
    """The messages of some ticks: channel -> (log time, offset), and the first and last log time [ns]."""

    pairs: dict[int, Pairs]
    first_ns: int
    last_ns: int


class LayoutIndex:
    """Log times and offsets of the messages in ticks, by channel. Layouts are remembered by tick length."""

    def __init__(self) -> None:
        self._layouts: dict[int, Layout] = {}

    def locate(self, parts: list[bytes], data: bytes) -> Located:
        """Where the messages are in `data`, which is the concatenation of `parts`. Offsets rise in each channel.

        Each part is whole Message records; raises RecordError if not.
        """
        if COMPILED:
            from tools.log.native_index import find_messages  # never where librt may be missing

            walked = find_messages(data)
            if walked is not None:
                words, first_ns, last_ns = walked
                return Located({c: np.frombuffer(w, "<u8").reshape(-1, 2) for c, w in words.items()}, first_ns, last_ns)
        lengths = np.fromiter(map(len, parts), np.int64, len(parts))
        starts = np.cumsum(lengths) - lengths
        # Ticks with the same channels in the same order are put together, whatever their lengths: a tick with one
        # frame more is the same sort of tick.
        found: dict[tuple[int, ...], list[Pairs]] = {}
        for length in set(lengths.tolist()):
            mine = starts[lengths == length]
            if len(mine) < FEW or not self._match(data, length, mine, found):
                for start in mine.tolist():
                    table = _walk_whole(data[start : start + length], start)
                    pairs = np.stack((table.log_time_ns, table.offset), axis=1)[:, None, :].astype("<u8")
                    found.setdefault(tuple(table.channel.tolist()), []).append(pairs)
        return _merge(found)

    def _match(self, data: bytes, length: int, starts: Ints, found: dict[tuple[int, ...], list[Pairs]]) -> bool:
        """Add the messages of parts that all have the layout known for this length; False when one has not."""
        layout = self._layouts.get(length)
        if layout is None:
            first = int(starts[0])
            layout = self._layouts[length] = _learn_layout(data[first : first + length])
        words = view_words(data)
        heads = starts + layout.offsets[:, None]
        if (words[heads] != layout.sizes).any() or (words[heads + CHANNEL_AT] & CHANNEL_BITS != layout.tails).any():
            del self._layouts[length]
            return False
        found.setdefault(layout.channels, []).append(np.stack((words[heads + TIME_AT], heads.view("<u8")), axis=2))
        return True


def view_words(data: bytes) -> Words:
    """The eight bytes from every byte of `data` on as a number each: an overlapping view, nothing is copied."""
    return np.ndarray(len(data) - 7, "<u8", data, 0, (1,))


def _merge(found: dict[tuple[int, ...], list[Pairs]]) -> Located:
    """Put the ticks of each sort in order, then the sorts together. Shapes: (messages of a tick, ticks, 2)."""
    by_channel: dict[int, list[Pairs]] = {}
    first_ns, last_ns = [], []
    for channels, blocks in found.items():
        if not channels:
            continue
        block = blocks[0]
        if len(blocks) > 1:
            joined = np.concatenate(blocks, axis=1)
            block = joined[:, np.argsort(joined[0, :, 1])]
        first_ns.append(int(block[:, :, 0].min()))
        last_ns.append(int(block[:, :, 0].max()))
        for row, channel in enumerate(channels):
            by_channel.setdefault(channel, []).append(block[row])
    merged = {}
    for channel, rows in sorted(by_channel.items()):
        pairs = rows[0]
        if len(rows) > 1:
            pairs = np.concatenate(rows)
            pairs = pairs[np.argsort(pairs[:, 1])]
        merged[channel] = pairs
    return Located(merged, min(first_ns, default=0), max(last_ns, default=0))


def _walk_whole(part: bytes, start: int) -> MessageTable:
    table, whole, short, _ = walk_messages(part, start)
    if short:
        raise RecordError(f"telemetry of {len(part)} bytes has message records of less than {DATA_AT} bytes")
    if whole != len(part):
        raise RecordError(f"telemetry of {len(part)} bytes ends inside a record, at byte {whole}")
    return table


def _learn_layout(part: bytes) -> Layout:
    table = _walk_whole(part, 0)
    words, heads = view_words(part), table.offset[:, None]
    return Layout(tuple(table.channel.tolist()), table.offset, words[heads], words[heads + CHANNEL_AT] & CHANNEL_BITS)
