"""Prints what logging one tick costs: JSON against CDR, the mcap library's writer against ours, compression.

The measurement behind docs/decisions/0001-telemetry-encoding.md. The ticks are those of a real run in process.

    python -P -m tools.design.telemetry_cost [SCENARIO] [--ticks N]
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

from bus.telemetry.link import Field, Link, PackRows, Row, TickPacker, Topic, pack_frames
from tools.config.loader import load_scenario
from tools.config.scenario_files import find_scenario
from tools.log import mcap_writer
from tools.log.message_index import DATA_AT, walk_messages
from tools.log.recorder import Recorder
from tools.log.topics import parse_layout
from tools.run.bench import Bench

Tick = tuple[int, int, int, bytes]  # source, tick, t_ns, records


class KeepingLink(Link):
    """Keeps what a side says."""

    def __init__(self, source: int, kept: list[Tick], tables: dict[int, bytes]) -> None:
        super().__init__(hold_ticks=1)
        self._source, self._kept, self._tables = source, kept, tables

    def announce(self, topics_json: bytes, pack_rows: PackRows | None = None) -> None:
        super().announce(topics_json, pack_rows)
        self._tables[self._source] = topics_json

    def _write_ticks(self, rows: list[Row], records: list[bytes]) -> None:
        self._kept += [(self._source, *row[:2], data) for row, data in zip(rows, records, strict=True)]

    def write_json(self, topic: str, t_ns: int, payload: bytes) -> None:
        pass


def measure(what: Callable[[], object], per: int, repeats: int = 9) -> float:
    """Least CPU time of one unit of work [us]."""
    best = float("inf")
    for _ in range(repeats):
        start = time.process_time_ns()
        what()
        best = min(best, time.process_time_ns() - start)
    return best / per / 1e3


def keep_ticks(scenario: str, ticks: int) -> tuple[list[Tick], dict[int, bytes]]:
    """What both sides of a scenario write in its first ticks, and their channel tables."""
    kept: list[Tick] = []
    tables: dict[int, bytes] = {}
    bench = Bench(load_scenario(find_scenario(scenario)), KeepingLink(1, kept, tables), KeepingLink(2, kept, tables))
    bench.step(ticks)
    return kept, tables


def split(kept: list[Tick]) -> list[tuple[int, int, int, bytes]]:
    """Channel, sequence, log time, data of every message."""
    messages = []
    for _, tick, _, records in kept:
        table = walk_messages(records).table
        for channel, t_ns, at, size in zip(*(column.tolist() for column in table), strict=True):
            messages.append((channel, tick, t_ns, records[at + DATA_AT : at + size]))
    return messages


def record_ours(kept: list[Tick], tables: dict[int, bytes], path: Path, compression: mcap_writer.Compression) -> None:
    recorder = Recorder(path, metadata={}, compression=compression)
    links = {source: recorder.link(source) for source in tables}
    for source, table in tables.items():
        links[source].announce(table)
    for source, tick, t_ns, records in kept:
        links[source].write_tick(tick, t_ns, records)
    recorder.close()


def record_library(
    messages: list[tuple[int, int, int, bytes]], tables: dict[int, bytes], path: Path, compression: CompressionType
) -> None:
    with open(path, "wb") as file:
        writer = Writer(file, chunk_size=256 * 1024, compression=compression)
        writer.start()
        channels = {}
        for row in (row for table in tables.values() for row in json.loads(table)):
            schema = writer.register_schema(row["schema_name"], "ros2msg", row["schema"].encode())
            channels[row["channel"]] = writer.register_channel(row["topic"], "cdr", schema)
        for channel, sequence, t_ns, data in messages:
            writer.add_message(channels[channel], t_ns, data, t_ns, sequence)
        writer.finish()  # type: ignore[no-untyped-call]


def list_values(kept: list[Tick], tables: dict[int, bytes]) -> tuple[list[dict[str, Any]], list[Topic]]:
    """The signals of the last tick, a dictionary for each topic, and the topics they belong to."""
    last: dict[int, bytes] = {channel: data for channel, _, _, data in split(kept[-2:])}
    values, topics = [], []
    for row in (row for table in tables.values() for row in json.loads(table)):
        # Frames, inputs, and what speaks seldom are no signals of a tick.
        if row["schema_name"].endswith(("CanFrames", "CycleInput")) or row["channel"] not in last:
            continue
        dtype = parse_layout(row["schema"], row["topic"])
        record = np.frombuffer(last[row["channel"]][4:], dtype)[0]
        names = [name for name in dtype.names or () if name != "stamp"]
        values.append({name: record[name].tolist() for name in names})
        fields = tuple(Field(name, "float64", int(np.size(record[name]))) for name in names)
        topics.append(Topic(row["topic"], row["schema_name"], fields))
    return values, topics


def print_encodings(kept: list[Tick], tables: dict[int, bytes]) -> None:
    """CPU time and bytes of encoding the signals of one tick."""
    values, topics = list_values(kept, tables)
    flat = [
        float(x)
        for record in values
        for value in record.values()
        for x in (value if isinstance(value, list) else [value])
    ]
    packer = TickPacker(topics, 2)
    loops = range(2000)
    stamp = {"sec": 1, "nsec": 2}
    texts = [json.dumps({"timestamp": stamp} | record) for record in values]

    def pack_json() -> None:
        for _ in loops:
            for record in values:
                json.dumps({"timestamp": stamp} | record).encode()

    def pack_cdr() -> None:
        pack = packer.pack
        for tick in loops:
            pack(tick, 10_000_000 * tick, *flat)

    def pack_raw() -> None:
        batch = bytes(16 * 15)
        for tick in loops:
            pack_frames(1, tick, 10_000_000 * tick, batch)

    size = sum(topic.body_size for topic in topics)
    print(f"\nencode the signals of one tick: {len(topics)} topics, {len(flat)} numbers\n")
    print("| encoding | us per tick | us per record | bytes per tick |\n|---|---|---|---|")
    for name, function, length in (("JSON", pack_json, sum(map(len, texts))), ("CDR", pack_cdr, size)):
        cost = measure(function, len(loops))
        print(f"| {name} | {cost:.2f} | {cost / len(topics):.2f} | {length} |")
    print(f"| raw frames (15) | {measure(pack_raw, len(loops)):.2f} | | {15 * 16} |")


def print_writers(kept: list[Tick], tables: dict[int, bytes], ticks: int, path: Path) -> None:
    """CPU time and file size of the writers, packed ticks in, file out."""
    messages = split(kept)
    raw = sum(len(records) for *_, records in kept)
    print(f"\nwrite {ticks} ticks of {len(messages) / ticks:.1f} messages, {raw / ticks:.0f} bytes\n")
    print("| writer | us per tick | bytes per tick |\n|---|---|---|")
    names: tuple[tuple[str, mcap_writer.Compression, CompressionType], ...] = (
        ("none", "", CompressionType.NONE), ("lz4", "lz4", CompressionType.LZ4), ("zstd", "zstd", CompressionType.ZSTD),
    )  # fmt: skip
    for name, _, theirs in names:
        cost = measure(lambda theirs=theirs: record_library(messages, tables, path, theirs), ticks, 3)  # type: ignore[misc]
        print(f"| mcap library, {name} | {cost:.2f} | {path.stat().st_size / ticks:.0f} |")
    for name, ours, _ in names[:2]:
        cost = measure(lambda ours=ours: record_ours(kept, tables, path, ours), ticks)  # type: ignore[misc]
        print(f"| ours, {name} | {cost:.2f} | {path.stat().st_size / ticks:.0f} |")
    chosen = mcap_writer.ZSTD_LEVEL
    for level in (3, 1, -1, -3, -5, -10):
        mcap_writer.ZSTD_LEVEL = level  # type: ignore[misc]
        cost = measure(lambda: record_ours(kept, tables, path, "zstd"), ticks)
        mark = " (chosen)" if level == chosen else ""
        print(f"| ours, zstd level {level}{mark} | {cost:.2f} | {path.stat().st_size / ticks:.0f} |")
    mcap_writer.ZSTD_LEVEL = chosen  # type: ignore[misc]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="zhang2018")
    parser.add_argument("--ticks", type=int, default=3000)
    args = parser.parse_args()
    kept, tables = keep_ticks(args.scenario, args.ticks)
    print_encodings(kept, tables)
    with tempfile.TemporaryDirectory() as directory:
        print_writers(kept, tables, args.ticks, Path(directory) / "a.mcap")


if __name__ == "__main__":
    main()
