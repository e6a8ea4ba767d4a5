"""Packs telemetry: values become complete MCAP Message records (MCAP 1.0, opcode 0x05) with CDR inside."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from typing import Any, Final

from bus.errors import ConfigError
from bus.native import COMPILED
from bus.telemetry.cdr import ENCAPSULATION, STAMP_SIZE, Topic

if COMPILED:  # never where librt may be missing
    from bus.telemetry.native_packing import write_floats, write_stamp

MESSAGE: Final = 0x05  # MCAP opcode
PREFIX: Final = struct.Struct("<BQH")  # opcode, length of what follows, channel
HEAD: Final = struct.Struct("<IQQ4siI")  # sequence, log_time, publish_time, CDR encapsulation, sec, nanosec
MESSAGE_FIXED: Final = 22  # channel to publish_time
FRAMES: Final = struct.Struct(f"<BQH{HEAD.size}sI")  # opcode, length, channel, head, bytes of frames
FRAMES_FIXED: Final = 2 + HEAD.size + 4  # channel to the number of bytes
INPUT: Final = struct.Struct("<IIII")  # slips, flags, checksum, bytes of the commands' text
INPUT_ALONE: Final = struct.Struct(
    f"<BQH{HEAD.size}sIIIIII"
)  # a whole record without commands: their text is one zero byte
INPUT_FIXED: Final = 2 + HEAD.size + 24
INPUT_START: Final = struct.Struct("<II")  # slips, flags
NATIVE_UNTIL_NS: Final = 1_000_000_000 << 31  # beyond that the seconds do not fit into a signed word


class TickPacker:
    """Packs one tick of several topics. Channels are numbered from `first_channel` in topic order.

    pack_stamped(head, values) -> bytes: the concatenated Message records of all topics; head from `stamp`, values flat
    in topic order. Raises struct.error for a value of the wrong kind or a wrong number of them.
    """

    __slots__ = ("_cuts", "_is_native", "_pack_values", "channels", "flat_size", "topics")

    def __init__(self, topics: Sequence[Topic], first_channel: int) -> None:
        empty = [topic.name for topic in topics if not topic.fields]
        if not topics or empty:
            raise ConfigError(f"telemetry packer: {', '.join(empty) or 'it'} has nothing to pack")
        self.topics = tuple(topics)
        self.channels = tuple(range(first_channel, first_channel + len(topics)))
        self.flat_size = sum(topic.flat_size for topic in topics)
        # Compiled, numbers are written one by one; struct would want each of them as an object.
        self._is_native = COMPILED and all(field.kind == "float64" for topic in topics for field in topic.fields)
        self._pack_values = struct.Struct("<" + "".join(topic.struct_format for topic in topics)).pack
        self._cuts: list[tuple[bytes, int, int]] = []  # of each topic: prefix, and where its values begin and end
        at = 0
        for topic, channel in zip(self.topics, self.channels, strict=True):
            end = at + topic.body_size - len(ENCAPSULATION) - STAMP_SIZE
            self._cuts.append((PREFIX.pack(MESSAGE, MESSAGE_FIXED + topic.body_size, channel), at, end))
            at = end

    @property
    def prefixes(self) -> tuple[bytes, ...]:
        """What the record of each topic begins with, ahead of the head."""
        return tuple(prefix for prefix, _, _ in self._cuts)

    def pack_stamped(self, head: bytes, values: Sequence[Any]) -> bytes:
        """The records of a tick: all values are packed by one call, then cut and laid behind the heads."""
        if self._is_native:
            if len(values) != self.flat_size:
                raise struct.error(f"{self.flat_size} values are to be packed, not {len(values)}")
            return write_floats(self._cuts, head, values)
        data = self._pack_values(*values)
        pieces: list[bytes] = []
        for prefix, start, end in self._cuts:
            pieces += (prefix, head, data[start:end])
        return b"".join(pieces)

    def pack(self, seq: int, t_ns: int, *values: float) -> bytes:
        """The records of a tick for which there is no head yet; t_ns is both log and publish time."""
        return self.pack_stamped(stamp(seq, t_ns), values)


def stamp(seq: int, t_ns: int) -> bytes:
    """What all records of a tick have behind their prefix: sequence, log and publish time, and the stamp in CDR."""
    if COMPILED and 0 <= t_ns < NATIVE_UNTIL_NS and 0 <= seq < 1 << 31:
        return write_stamp(seq, t_ns, ENCAPSULATION)
    sec = t_ns // 1_000_000_000
    return HEAD.pack(seq, t_ns, t_ns, ENCAPSULATION, sec, t_ns - sec * 1_000_000_000)


def pack_frames(channel: int, seq: int, t_ns: int, batch: bytes) -> bytes:
    """One Message record with all frames of a tick, lossless and in bus order, for /can/<bus>."""
    return pack_frames_stamped(channel, stamp(seq, t_ns), batch)


def pack_frames_stamped(channel: int, head: bytes, batch: bytes) -> bytes:
    """The same with a head from `stamp`."""
    size = len(batch)
    return FRAMES.pack(MESSAGE, FRAMES_FIXED + size, channel, head, size) + batch


def pack_input(channel: int, head: bytes, slips: int, flags: int, commands: str, frames: bytes) -> bytes:
    """One Message record of /fsw/input, see bus.telemetry.cdr.INPUT_TEXT."""
    crc = check_input(slips, flags, commands, frames)
    if not commands:  # nearly always
        size = len(frames)
        return INPUT_ALONE.pack(MESSAGE, INPUT_FIXED + size, channel, head, slips, flags, crc, 1, 0, size) + frames
    text = commands.encode() + b"\0"
    text += bytes(-len(text) % 4)
    body = INPUT.pack(slips, flags, crc, len(commands.encode()) + 1) + text + struct.pack("<I", len(frames)) + frames
    return PREFIX.pack(MESSAGE, 2 + HEAD.size + len(body), channel) + head + body


def check_input(slips: int, flags: int, commands: str, frames: bytes) -> int:
    """Checksum of what one cycle was given: a replay can only be trusted as far as its inputs."""
    crc = zlib.crc32(INPUT_START.pack(slips, flags))
    if commands:
        crc = zlib.crc32(commands.encode(), crc)
    return zlib.crc32(frames, crc)
