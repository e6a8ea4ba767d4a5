"""Where the messages of a chunk lie, found by walking it: for the compiled build. The plain one never imports this."""

from __future__ import annotations

from typing import Final

from librt.strings import BytesWriter, read_i16_le, read_i64_le, write_i64_le
from mypy_extensions import i64

from bus.telemetry.packing import MESSAGE, MESSAGE_FIXED

RECORD_HEAD: Final = 9  # opcode and length
SHORTEST: Final = RECORD_HEAD + MESSAGE_FIXED  # bytes of a message record without data


def find_messages(data: bytes) -> tuple[dict[int, bytes], int, int] | None:
    """Return log time and offset of the messages of each channel, as pairs of 64-bit words, and the first and last time.

    None unless `data` is whole message records and nothing else.
    """
    found: dict[int, BytesWriter] = {}
    at: i64 = 0
    end: i64 = len(data)
    first: i64 = 0
    last: i64 = 0
    while at < end:
        if end - at < SHORTEST or data[at] != MESSAGE:
            return None
        size = read_i64_le(data, at + 1) + RECORD_HEAD
        if size < SHORTEST or size > end - at:
            return None
        channel = int(i64(read_i16_le(data, at + RECORD_HEAD)) & 0xFFFF)
        t_ns = read_i64_le(data, at + 15)
        writer = found.get(channel)
        if writer is None:
            writer = found[channel] = BytesWriter()
        write_i64_le(writer, t_ns)
        write_i64_le(writer, at)
        first = t_ns if at == 0 or t_ns < first else first
        last = t_ns if at == 0 or t_ns > last else last
        at += size
    return {channel: found[channel].getvalue() for channel in sorted(found)}, int(first), int(last)
