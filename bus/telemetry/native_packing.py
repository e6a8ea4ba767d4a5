"""Packs numbers one by one: for the compiled build, where that costs next to nothing. The plain one never imports this."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from librt.strings import BytesWriter, write_f64_le


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
            write_f64_le(writer, float(numbers[i]))
    return writer.getvalue()
