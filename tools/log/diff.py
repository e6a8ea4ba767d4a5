"""`hilsat diff`: whether two logs say the same, and where they first do not.

Compared is what must not depend on the machine or the moment: topic, log time and data of every message of the topics
that are marked deterministic. Metadata, attachments and chunk boundaries may differ.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bus.telemetry.cdr import FRAMES_SCHEMA
from tools.log.mcap_reader import FRAMES_AT, Run, read_run
from tools.log.message_index import DATA_AT


@dataclass(frozen=True, slots=True)
class Difference:
    """Where two logs part."""

    topic: str
    tick: int | None  # sequence number of the record; None: the whole topic is missing in one of them
    t_s: float | None
    field: str
    a: Any
    b: Any


@dataclass(frozen=True, slots=True)
class Comparison:
    """What comparing two logs gave."""

    same: bool
    digest_a: str
    digest_b: str
    differing_topics: tuple[str, ...]
    first: Difference | None


def compare_runs(a: Run, b: Run) -> Comparison:
    """Compare the deterministic content; `first` is the earliest difference in log time."""
    digest_a, digest_b = a.digest(), b.digest()
    if digest_a == digest_b:
        return Comparison(True, digest_a, digest_b, (), None)
    names = {name: None for run in (a, b) for name, info in run.topics.items() if info.deterministic}
    found = [difference for name in names if (difference := _compare_topic(a, b, name)) is not None]
    first = min(found, key=lambda difference: -1.0 if difference.t_s is None else difference.t_s, default=None)
    if first is None:
        first = Difference("*", None, None, "order of the messages of different topics", None, None)
    return Comparison(False, digest_a, digest_b, tuple(difference.topic for difference in found), first)


def _compare_topic(a: Run, b: Run, topic: str) -> Difference | None:
    """The first difference in one topic. A declared topic without messages counts as none."""
    sides = [_list_records(run, topic) for run in (a, b)]
    for index, (one, two) in enumerate(zip(*sides, strict=False)):
        if one != two:
            field, value_a, value_b = _find_field(a, b, topic, index, one, two)
            return Difference(topic, a.sequences(topic)[index], one[0] * 1e-9, field, value_a, value_b)
    counts = [len(side) for side in sides]
    if counts[0] == counts[1]:
        return None
    shared = min(counts)
    longer = a if counts[0] > shared else b
    first_s = sides[counts.index(max(counts))][shared][0] * 1e-9
    tick = longer.sequences(topic)[shared]
    return Difference(topic, tick, first_s, "number of messages", counts[0], counts[1])


def _list_records(run: Run, topic: str) -> list[tuple[int, bytes]]:
    if topic not in run.topics:
        return []
    return list(zip(run.t_ns(topic).tolist(), run.payloads(topic), strict=True))


def _find_field(
    a: Run, b: Run, topic: str, index: int, one: tuple[int, bytes], two: tuple[int, bytes]
) -> tuple[str, Any, Any]:
    """Name and values of what differs in one record."""
    if one[0] != two[0]:
        return "log time [ns]", one[0], two[0]
    pairs: Iterator[tuple[str, Any, Any]]
    if a.topics[topic].schema != b.topics[topic].schema:
        return "schema", a.topics[topic].schema_name, b.topics[topic].schema_name
    if a.topics[topic].schema_name == FRAMES_SCHEMA:
        pairs = _pair_frames(one[1], two[1])
    elif a.topics[topic].encoding == "cdr":
        sides = (a.signals(topic), b.signals(topic))
        pairs = ((name, sides[0][name][index].tolist(), sides[1][name][index].tolist()) for name in sides[0])
    else:
        objects = (json.loads(one[1]), json.loads(two[1]))
        pairs = ((name, objects[0].get(name), objects[1].get(name)) for name in objects[0] | objects[1])
    for name, value_a, value_b in pairs:
        if json.dumps(value_a) != json.dumps(value_b):  # NaN equals NaN here, and -0.0 is not 0.0
            return name, value_a, value_b
    return "bytes", one[1].hex(), two[1].hex()


def _pair_frames(one: bytes, two: bytes) -> Iterator[tuple[str, Any, Any]]:
    start = FRAMES_AT - DATA_AT
    for number, at in enumerate(range(start, max(len(one), len(two)), 16)):
        yield f"frame {number}", _format_frame(one[at : at + 16]), _format_frame(two[at : at + 16])


def _format_frame(frame: bytes) -> str | None:
    if len(frame) < 16:
        return None
    return f"{int.from_bytes(frame[:4], 'little'):03X}#{frame[8 : 8 + min(frame[4], 8)].hex().upper()}"


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("diff", help="compare the deterministic content of two logs", description=__doc__)
    parser.add_argument("a", type=Path, help="MCAP file")
    parser.add_argument("b", type=Path, help="MCAP file")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Compare; exit code 0 when the logs say the same, 1 when they do not."""
    result = compare_runs(read_run(args.a), read_run(args.b))
    if args.json:
        print(json.dumps(dataclasses.asdict(result)))
    else:
        print(format_comparison(result))
    return 0 if result.same else 1


def format_comparison(result: Comparison) -> str:
    """The outcome for people."""
    if result.first is None:
        return f"the same: {result.digest_a}"
    first = result.first
    place = "" if first.tick is None else f", tick {first.tick}, {first.t_s:.6f} s"
    lines = [
        f"they differ first in {first.topic}{place}: {first.field}",
        f"  a: {first.a}",
        f"  b: {first.b}",
        f"topics that differ: {', '.join(result.differing_topics) or 'none by themselves'}",
    ]
    return "\n".join(lines)
