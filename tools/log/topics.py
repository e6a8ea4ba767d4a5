"""What a log says of its topics: encoding, layout, units, and whether they must be equal from run to run."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from mcap.records import Channel, Schema

from bus.errors import RecordError
from bus.telemetry.cdr import PRIMITIVES, STAMP_TEXT
from tools.log.decompression import MAX_CHUNK_BYTES

FIELD_LINE: Final = re.compile(r"(\w+)(?:\[(\d{1,6})\])?\s+(\w+)\s*(?:#\s*(?:\[([^\]]*)\])?.*)?", re.ASCII)
NUMPY_CODES: Final = {
    "float64": "<f8", "uint64": "<u8", "uint32": "<u4", "int32": "<i4", "uint8": "u1", "bool": "?",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic of a log."""

    name: str
    channels: tuple[int, ...]
    encoding: str
    schema_name: str
    schema: str  # of a binary schema: whatever of it is text
    deterministic: bool
    units: Mapping[str, str]  # of its fields; empty where the log has none that can be read
    source: str = ""  # number of the process that wrote it, where the recorder says so
    every: str = ""  # how often there is a record, likewise: see bus.telemetry.cdr.Rate


def list_topics(channels: Iterable[Channel], schemas: Mapping[int, Schema]) -> dict[str, TopicInfo]:
    """The topics of these channels by name. Channels of one topic are put together when they are alike.

    Of channels that differ in encoding or schema the first counts: the others' messages cannot be read with its layout.
    """
    topics: dict[str, TopicInfo] = {}
    for channel in channels:
        schema = schemas.get(channel.schema_id)
        info = TopicInfo(
            name=channel.topic,
            channels=(channel.id,),
            encoding=channel.message_encoding,
            schema_name=schema.name if schema else "",
            schema=schema.data.decode("utf-8", "replace") if schema else "",
            deterministic=channel.metadata.get("deterministic") != "false",
            units=_read_units(channel.metadata.get("units", "{}")),
            source=channel.metadata.get("source", ""),
            every=channel.metadata.get("every", ""),
        )
        before = topics.setdefault(channel.topic, info)
        if before is not info and (before.encoding, before.schema) == (info.encoding, info.schema):
            topics[channel.topic] = TopicInfo(
                before.name, (*before.channels, channel.id), before.encoding, before.schema_name, before.schema,
                before.deterministic, before.units, before.source, before.every,
            )  # fmt: skip
    return topics


def _read_units(text: str) -> dict[str, str]:
    try:
        units = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    if not isinstance(units, dict):
        return {}
    return {name: unit for name, unit in units.items() if isinstance(unit, str)}


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
            short = line if len(line) <= 60 else line[:57] + "..."
            raise RecordError(f'{where}: "{short}" is not a field of fixed size, which is all that signals are made of')
        if match[3] in names:
            raise RecordError(f"{where}: its schema has two fields called {match[3]}")
        size, count = PRIMITIVES[match[1]][1], int(match[2] or 1)
        if offset + size * count > MAX_CHUNK_BYTES:
            raise RecordError(f"{where}: its schema wants records of more than {MAX_CHUNK_BYTES} bytes")
        offset += -offset % size
        names.append(match[3])
        formats.append(NUMPY_CODES[match[1]] if match[2] is None else f"({count},){NUMPY_CODES[match[1]]}")
        offsets.append(offset)
        offset += size * count
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": offset})
