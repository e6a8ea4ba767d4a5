"""Packs numbers one by one: for the compiled build, where that costs next to nothing. The plain one never imports this."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from librt.strings import BytesWriter, write_f64_le, write_i16_le, write_i32_le, write_i64_le
from mypy_extensions import i16, i32, i64

from bus.units import Vec3, Vec4

MESSAGE: Final = 0x05  # MCAP opcode


def write_floats(cuts: list[tuple[bytes, int, int]], head: bytes, values: Sequence[Any]) -> bytes:
    """Return the records of a tick: of each topic its prefix, the head, and its values as doubles.

    cuts : of each topic the prefix, and where its values begin and end among all [bytes]
    """
    writer = BytesWriter()
    numbers = values if isinstance(values, tuple) else tuple(values)
    for prefix, start, end in cuts:
        writer.write(prefix)
        writer.write(head)
        for i in range(start // 8, end // 8):
            number = numbers[i]
            if isinstance(number, float):
                write_f64_le(writer, number)
            else:
                write_f64_le(writer, float(number))
    return writer.getvalue()


def write_stamp(seq: int, t_ns: int, encapsulation: bytes) -> bytes:
    """Return what `bus.telemetry.packing.stamp` does, for what fits into signed words: a time before 2038."""
    writer = BytesWriter()
    t: i64 = t_ns
    write_i32_le(writer, i32(seq))
    write_i64_le(writer, t)
    write_i64_le(writer, t)
    writer.write(encapsulation)
    write_i32_le(writer, i32(t // 1_000_000_000))
    write_i32_le(writer, i32(t % 1_000_000_000))
    return writer.getvalue()


def write_frames(writer: BytesWriter, channel: int, head: bytes, frames: bytes) -> None:
    """Write what `bus.telemetry.packing.pack_frames_stamped` returns."""
    size: i64 = len(frames)
    writer.append(MESSAGE)
    write_i64_le(writer, 2 + len(head) + 4 + size)
    write_i16_le(writer, i16(channel))
    writer.write(head)
    write_i32_le(writer, i32(size))
    writer.write(frames)


def write3(writer: BytesWriter, v: Vec3) -> None:
    """Write three doubles."""
    x, y, z = v
    write_f64_le(writer, x)
    write_f64_le(writer, y)
    write_f64_le(writer, z)


def write4(writer: BytesWriter, v: Vec4) -> None:
    """Write four doubles."""
    a, b, c, d = v
    write_f64_le(writer, a)
    write_f64_le(writer, b)
    write_f64_le(writer, c)
    write_f64_le(writer, d)
