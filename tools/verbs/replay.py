"""`hilsat replay LOG...`: fly the flight software again on what it was given, and compare what it says bit for bit.

Everything that a cycle consumed is in the log: the frames received since the cycle before, the commands of the ground,
what its executive told it. The same software makes the same frames and the same telemetry of it.

With --set, other settings of the flight software are flown on the same inputs: an open loop, which tells how each of its
signals would have differed, and not how the run would have ended.

Exit codes: 0 nothing differs; 1 something does; 3 a log cannot be replayed.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bus.errors import HilsatError, UsageError
from tools.grading.grade import scenario_of
from tools.log.mcap_reader import Run, read_run
from tools.replay.compare import Outcome, compare_replay
from tools.replay.flight_again import FlightAgain
from tools.replay.open_loop import OpenLoop, compare_open_loop


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("replay", help="fly a log's flight software again, bit for bit", description=__doc__)
    parser.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="MCAP file of a run")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="fsw.KEY=VALUE",
        help="fly with other settings, open loop; repeatable",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object a log on stdout")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Replay each log; a line each, and where the first divergence is."""
    strange = [words for words in args.set if not words.startswith("fsw.")]
    if strange:
        raise UsageError(
            f"--set {strange[0]}: a replay has no plant and no faults of its own; only keys under fsw. can be set"
        )
    code = 0
    for log in args.logs:
        try:
            outcome = replay_open_loop(log, args.set) if args.set else replay(log)
        except HilsatError as error:
            code = max(code, error.exit_code)
            if args.json:
                print(json.dumps({"log": str(log), "error": str(error)}))
            print(f"hilsat replay: {error}", file=sys.stderr)
            continue
        code = max(code, 0 if outcome.same else 1)
        if args.json:
            print(json.dumps({"log": str(log), **outcome.as_dict()}))
        else:
            print(_format(log, outcome) if isinstance(outcome, Outcome) else _format_open_loop(log, outcome))
    return code


def replay(log: Path) -> Outcome:
    """What flying the log's inputs again gives. Raises RecordError or ConfigError where that cannot be done."""
    run, again, tick_ns = _open(log, ())
    return compare_replay(run, again, tick_ns)


def replay_open_loop(log: Path, overrides: Sequence[str]) -> OpenLoop:
    """What other settings make of the log's inputs. Raises RecordError or ConfigError where that cannot be done."""
    run, again, tick_ns = _open(log, overrides)
    return compare_open_loop(run, again, tick_ns)


def _open(log: Path, overrides: Sequence[str]) -> tuple[Run, FlightAgain, int]:
    recorded = read_run(log)
    scenario = scenario_of(recorded, log, overrides).scenario
    run_hash = int(recorded.metadata.get("run", {}).get("run_hash", "0"), 16)
    tick_ns = 1_000_000_000 // scenario.clock.tick_hz
    return recorded, FlightAgain(scenario.fsw, tick_ns, run_hash), tick_ns


def _format(log: Path, outcome: Outcome) -> str:
    lines = [
        f"{log}: {outcome.differing_ticks} differences in {outcome.ticks} ticks "
        f"({outcome.records} records, {outcome.frames} frames compared)"
    ]
    if outcome.unheard:
        lines.append(f"  {outcome.unheard} frames that the plant did not log were not compared")
    if outcome.torn:
        lines.append(f"  the log was cut: {outcome.torn} ticks of the bus behind its last cycle were not compared")
    if outcome.first is not None:
        lines += ["  " + line for line in outcome.first.describe().splitlines()]
    return "\n".join(lines)


def _format_open_loop(log: Path, outcome: OpenLoop) -> str:
    lines = [
        f"{log}: open loop: {len(outcome.changes)} of {outcome.signals} signals differ in {outcome.ticks} ticks",
        *(f"  {change.describe()}" for change in outcome.changes),
    ]
    for side, names in (("recorded", outcome.only_recorded), ("replayed", outcome.only_replayed)):
        if names:
            lines.append(f"  only {side}: {', '.join(names)}")
    return "\n".join(lines)
