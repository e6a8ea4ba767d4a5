"""A long log for measuring what reading costs: the chunks of a run again and again, each time with later ticks.

python -m tools.design.repeat_log RUN.mcap LONG.mcap 72     300 s become 6 h

Numeric topics are repeated; what is said now and then, faults among it, stands there once. The attached scenario says the
longer duration, so that the log can be graded; it is no run of anything.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import Final

import numpy as np

from bus.errors import RecordError, UsageError
from tools.grading.grade import SCENARIO_ATTACHMENT, make_timetable, scenario_of
from tools.log.mcap_reader import read_run
from tools.log.mcap_records import McapContent, Stretch
from tools.log.mcap_writer import McapWriter

SEQUENCE_AT: Final = 11  # in a Message record
TIMES_AT: Final = (15, 23)  # log time and publish time


def repeat(source: Path, out: Path, copies: int) -> None:
    """Write the longer log. Raises RecordError for what is no log of a run, and where it cannot be written."""
    run, content = read_run(source), McapContent(source)
    timetable = make_timetable(scenario_of(run, source))
    text = (run.attachment(SCENARIO_ATTACHMENT) or b"").decode()
    length_s = timetable.ticks / timetable.tick_hz
    writer = McapWriter(out)
    once = set()
    for channel in content.channels.values():
        schema = content.schemas.get(channel.schema_id)
        words = (schema.name, schema.encoding, schema.data) if schema else ("", "", b"")
        writer.add_channel(channel.id, channel.topic, channel.message_encoding, words, channel.metadata)
        if channel.message_encoding == "json":
            once.add(channel.id)
    for record in content.metadata:
        writer.add_metadata(record.name, record.metadata)
    longer = re.sub(r"^duration_s: .*$", f"duration_s: {copies * length_s}", text, flags=re.MULTILINE)
    writer.add_attachment(SCENARIO_ATTACHMENT, "application/yaml", longer.encode())
    for copy in range(copies):
        shift_ns = round(copy * length_s * 1e9)
        for stretch in content.stretches():
            writer.write_chunk([_shift(stretch, copy * timetable.ticks, shift_ns, once if copy else set())])
    writer.close()


def _shift(stretch: Stretch, ticks: int, shift_ns: int, left_out: set[int]) -> bytes:
    """The messages of a chunk so many ticks and ns later, without those of some channels."""
    table, data = stretch.table, np.frombuffer(stretch.data, np.uint8).copy()
    numbers = [(SEQUENCE_AT, (table.sequence + ticks).astype("<u4"))]
    numbers += [(at, (table.log_time_ns + shift_ns).astype("<i8")) for at in TIMES_AT]
    for at, values in numbers:
        width = values.dtype.itemsize
        data[(table.offset + at)[:, None] + np.arange(width)] = values.view(np.uint8).reshape(-1, width)
    keep = ~np.isin(table.channel, list(left_out))
    if keep.all():
        return data.tobytes()
    places = zip(table.offset[keep].tolist(), table.size[keep].tolist(), strict=True)
    return b"".join([data[at : at + size].tobytes() for at, size in places])


def main() -> None:
    """Write one longer log."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path, help="log of a run")
    parser.add_argument("out", type=Path, help="file to write")
    parser.add_argument("copies", type=int, help="how many times as long")
    args = parser.parse_args()
    try:
        repeat(args.source, args.out, args.copies)
    except (RecordError, UsageError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
