"""`hilsat diff`: whether two logs say the same, and where they first do not.

Compared is what must not depend on the machine or the moment: topic, log time and data of every message of the topics
that are marked deterministic. Metadata, attachments and chunk boundaries may differ.

Exact to the bit, unless `--tolerance UNIT=NUMBER` says how far signals of a unit may be apart (rad_s=1e-9, nm=1e-6,
deg=1e-6, 1=1e-12 for those without a unit) or `--ignore TOPIC[.SIGNAL]` leaves something out. Exit codes: 0 the same, 1
not, 3 when nothing could be compared.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from bus.errors import RecordError
from bus.telemetry.cdr import FRAMES_SCHEMA
from tools.log.completeness import warn_of_missing
from tools.log.mcap_reader import FRAMES_AT, LogRecord, Run, read_run
from tools.log.message_index import DATA_AT
from tools.log.signal_diff import (
    DIMENSIONLESS,
    EXACT,
    Allowance,
    SignalDifference,
    compare_signals,
    count_alike,
    name_topic,
    parse_allowance,
)

SHOWN: Final = 20  # signals of the list for people
LONGEST: Final = 256  # bytes of a record that are shown


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
    signals: tuple[SignalDifference, ...] = ()  # those that differ at all, also within what is allowed


def compare_runs(a: Run, b: Run, allowed: Allowance = EXACT) -> Comparison:
    """Compare the deterministic content; `first` is the earliest difference in log time that is not allowed.

    Raises RecordError when neither has any: two logs that say nothing do not say the same.
    """
    names = {
        name: None for run in (a, b) for name, info in run.topics.items()
        if info.deterministic and not allowed.ignores(name)
    }  # fmt: skip
    if not any(run.has(name) for run in (a, b) for name in names):
        raise RecordError(f"{a.path} and {b.path}: neither has a message to compare; nothing was compared")
    digest_a, digest_b = a.digest(), b.digest()
    if digest_a == digest_b:
        return Comparison(True, digest_a, digest_b, (), None)
    signals = {name: compare_signals(a, b, name, allowed) for name in names if _has_signals(a, b, name)}
    is_exact = not allowed.tolerances and not allowed.ignored
    found = []
    for name in names:
        difference = (
            _compare_topic(a, b, name) if is_exact else _compare_loosely(a, b, name, signals.get(name), allowed)
        )
        if difference is not None:
            found.append(difference)
    first = min(found, key=lambda difference: -1.0 if difference.t_s is None else difference.t_s, default=None)
    if first is None and is_exact:
        first = Difference("*", None, None, "order of the messages of different topics", None, None)
    topics, listed = tuple(difference.topic for difference in found), tuple(itertools.chain(*signals.values()))
    return Comparison(first is None, digest_a, digest_b, topics, first, listed)


def _has_signals(a: Run, b: Run, topic: str) -> bool:
    """Whether a topic is one of signals, laid out alike in both logs."""
    if topic not in a.topics or topic not in b.topics or a.topics[topic].schema != b.topics[topic].schema:
        return False
    try:
        a.signals(topic)
    except RecordError:  # JSON, frames, or records whose size is not fixed
        return False
    return a.topics[topic].schema_name != FRAMES_SCHEMA


def _compare_loosely(
    a: Run, b: Run, topic: str, signals: list[SignalDifference] | None, allowed: Allowance
) -> Difference | None:
    """The first difference in one topic that is not allowed. signals: what its signals differ in; None: it has none."""
    if signals is None:
        return _compare_topic(a, b, topic, allowed)
    beyond = min((signal for signal in signals if signal.count), key=lambda signal: signal.row, default=None)
    rows = count_alike(a, b, topic)
    if beyond is not None:
        values = [run.signals(topic)[beyond.field][beyond.row].tolist() for run in (a, b)]
        return Difference(topic, int(a.ticks(topic)[beyond.row]), beyond.t_s, beyond.field, *values)
    counts = [run.count(topic) for run in (a, b)]
    if rows == max(counts):
        return None
    longer = a if rows < counts[0] else b
    t_s, tick = float(longer.t_ns(topic)[rows]) * 1e-9, int(longer.ticks(topic)[rows])
    if rows == min(counts):
        return Difference(topic, tick, t_s, "number of messages", *counts)
    return Difference(topic, tick, t_s, "log time [ns]", *(int(run.t_ns(topic)[rows]) for run in (a, b)))


def _compare_topic(a: Run, b: Run, topic: str, allowed: Allowance = EXACT) -> Difference | None:
    """The first difference in one topic. A declared topic without messages counts as none."""
    sides = [run.iterate(topic) if topic in run.topics else iter(()) for run in (a, b)]
    for one, two in itertools.zip_longest(*sides):
        if one is None or two is None:
            counts = [run.count(topic) if topic in run.topics else 0 for run in (a, b)]
            longer = two if one is None else one
            return Difference(topic, longer.sequence, longer.t_ns * 1e-9, "number of messages", *counts)
        if (one.t_ns, one.data) != (two.t_ns, two.data):
            field, value_a, value_b = _find_field(a, b, topic, one, two, allowed)
            if not field:
                continue
            return Difference(topic, one.sequence, one.t_ns * 1e-9, field, value_a, value_b)
    return None


def _find_field(
    a: Run, b: Run, topic: str, one: LogRecord, two: LogRecord, allowed: Allowance = EXACT
) -> tuple[str, Any, Any]:
    """Name and values of what differs in one record; no name where all that does is ignored."""
    if one.t_ns != two.t_ns:
        return "log time [ns]", one.t_ns, two.t_ns
    infos = a.topics[topic], b.topics[topic]
    if infos[0].schema != infos[1].schema:
        return "schema", infos[0].schema_name, infos[1].schema_name
    try:
        if infos[0].schema_name == FRAMES_SCHEMA:
            pairs = _pair_frames(one.data, two.data)
        elif infos[0].encoding == "cdr":
            objects = (a.decode(topic, one.data), b.decode(topic, two.data))
            pairs = _pair_objects(*objects)
        else:
            pairs = _pair_objects(json.loads(one.data), json.loads(two.data))
        ignored = False
        for name, value_a, value_b in pairs:
            if json.dumps(value_a) != json.dumps(value_b):  # NaN equals NaN here, and -0.0 is not 0.0
                if not allowed.ignores(topic, name):
                    return name, value_a, value_b
                ignored = True
        if ignored:
            return "", None, None
    except (RecordError, ValueError, TypeError, RecursionError):
        pass  # not to be decoded: the bytes have to do
    return "bytes", _shorten(one.data), _shorten(two.data)


def _pair_objects(one: dict[str, Any], two: dict[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    return ((name, one.get(name), two.get(name)) for name in one | two)


def _shorten(data: bytes) -> str:
    return data[:LONGEST].hex() + ("..." if len(data) > LONGEST else "")


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
    parser.add_argument(
        "-t", "--tolerance", action="append", default=[], metavar="UNIT=NUMBER",
        help="how far signals of a unit may be apart, such as rad_s=1e-9; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "-i", "--ignore", action="append", default=[], metavar="TOPIC[.SIGNAL]",
        help="leave out a topic or a signal, such as fsw.executive.mode; repeatable",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Compare; exit code 0 when the logs say the same, 1 when they do not, 3 when they say nothing."""
    runs = read_run(args.a), read_run(args.b)
    for log in runs:
        warn_of_missing(log, "diff")
    allowed = parse_allowance(args.tolerance, args.ignore, runs)
    result = compare_runs(*runs, allowed)
    if args.json:
        print(json.dumps(_make_plain(dataclasses.asdict(result))))
    else:
        print(format_comparison(result))
    return 0 if result.same else 1


def _make_plain(value: Any) -> Any:
    """A result in what JSON has: no number that is none."""
    if isinstance(value, dict):
        return {key: _make_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_make_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def format_comparison(result: Comparison) -> str:
    """The outcome for people."""
    if result.first is None:
        if result.digest_a == result.digest_b:
            return f"the same: {result.digest_a}"
        return "\n".join(["the same within what is allowed", *_list_signals(result)])
    first = result.first
    place = "" if first.tick is None else f", tick {first.tick}, {first.t_s:.6f} s"
    lines = [
        f"they differ first in {first.topic}{place}: {first.field}",
        f"  a: {first.a}",
        f"  b: {first.b}",
        f"topics that differ: {', '.join(result.differing_topics) or 'none by themselves'}",
        *_list_signals(result),
    ]
    return "\n".join(lines)


def _list_signals(result: Comparison) -> Iterator[str]:
    """The signals that differ, a line each: where first, on how many records, by how much at most."""
    shown = sorted(result.signals, key=lambda signal: (not signal.count, signal.t_s))[:SHOWN]
    for signal in shown:
        unit = "" if signal.unit == DIMENSIONLESS else f" {signal.unit}"
        where = f"first at {signal.t_s:g} s, on {signal.count} records" if signal.count else "within what is allowed"
        yield f"  {name_topic(signal.topic)}.{signal.field}: by {signal.largest:.3g}{unit} at most, {where}"
    if len(result.signals) > len(shown):
        yield f"  and {len(result.signals) - len(shown)} more signals"
