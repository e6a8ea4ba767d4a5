"""Where the fields of a telemetry message lie, from the layout text that the log carries."""

from __future__ import annotations

import re
from typing import Any, Final

import numpy as np

from bus.errors import RecordError
from bus.telemetry.cdr import PRIMITIVES, STAMP_TEXT

FIELD_LINE: Final = re.compile(r"(\w+)(?:\[(\d+)\])?\s+(\w+)\s*(?:#\s*(?:\[([^\]]*)\])?.*)?")
NUMPY_CODES: Final = {
    "float64": "<f8", "uint64": "<u8", "uint32": "<u4", "int32": "<i4", "uint8": "u1", "bool": "?",
}  # fmt: skip


def parse_layout(schema: str, where: str) -> np.dtype[Any]:
    """The numpy layout of a message of fixed size, CDR alignment included, from its ROS 2 .msg text.

    Raises RecordError when the text has a field whose size is not fixed.
    """
    names, formats, offsets = ["stamp"], ["<i8"], [0]
    offset = 8
    lines = [line.strip() for line in schema.split("=" * 80)[0].splitlines()]
    fields = [line for line in lines if line and not line.startswith("#") and line != STAMP_TEXT]
    for line in fields:
        match = FIELD_LINE.fullmatch(line)
        if match is None or match[1] not in PRIMITIVES:
            raise RecordError(f'{where}: "{line}" is not a field of fixed size, which is all that signals are made of')
        size, count = PRIMITIVES[match[1]][1], int(match[2] or 1)
        offset += -offset % size
        names.append(match[3])
        formats.append(NUMPY_CODES[match[1]] if match[2] is None else f"({count},){NUMPY_CODES[match[1]]}")
        offsets.append(offset)
        offset += size * count
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": offset})
