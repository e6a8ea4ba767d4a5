"""`hilsat replay LOG...`: fly the flight software again on what it was given, and compare what it says bit for bit.

Everything that a cycle consumed is in the log: the frames received since the cycle before, the commands of the ground,
what its executive told it. The same software makes the same frames and the same telemetry of it.

With --set, other settings of the flight software are flown on the same inputs, with --fsw another version of it: an open
loop, which tells how each of its signals would have differed, and not how the run would have ended.

With --to, nothing is flown: the frames of the log are played onto a bus.

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
from tools.log.outputs import create
from tools.replay.compare import Outcome, compare_replay
from tools.replay.open_loop import OpenLoop, compare_open_loop
from tools.replay.opening import Choice, Opened, list_logs, open_log
from tools.replay.origin import describe_origin
from tools.replay.process import check_home
from tools.verbs import play

FORMATS = ("png", "svg", "pdf")


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        "replay", help="fly a log's flight software again, bit for bit; play its frames onto a bus", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument(
        "logs", type=Path, nargs="+", metavar="LOG", help="MCAP file of a run, or a directory: every run.mcap in it"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="fsw.KEY=VALUE",
        help="fly with other settings, open loop; repeatable",
    )
    parser.add_argument(
        "--fsw", type=Path, metavar="DIR", help="fly another version, open loop: DIR has its bus/ and fsw/ (a checkout)"
    )
    parser.add_argument("--process", action="store_true", help="fly in a process of its own, fed cycle by cycle")
    parser.add_argument(
        "--plot", type=Path, metavar="FILE", help="open loop of one log: picture of what differs most (png, svg, pdf)"
    )
    parser.add_argument("--force", action="store_true", help="replace a picture of that name")
    parser.add_argument("--json", action="store_true", help="one JSON object a log on stdout")
    play.add_options(parser)
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Replay each log; a line each, and where the first divergence is."""
    if play.is_asked(args):
        return play.run(args)
    choice = _read_choice(args)
    logs = list_logs(args.logs)
    if args.plot is not None:
        _check_plot(args.plot, choice, logs)
    code = 0
    for log in logs:
        try:
            outcome, lines = _replay_one(log, choice, args)
        except HilsatError as error:
            code = max(code, error.exit_code)
            if args.json:
                print(json.dumps({"log": str(log), "error": str(error)}))
            print(f"hilsat replay: {error}", file=sys.stderr)
            continue
        code = max(code, 0 if outcome.same else 1)
        print(json.dumps({"log": str(log), **outcome.as_dict()}) if args.json else "\n".join(lines))
    return code


def _read_choice(args: argparse.Namespace) -> Choice:
    strange = [words for words in args.set if not words.startswith("fsw.")]
    if strange:
        raise UsageError(
            f"--set {strange[0]}: a replay has no plant and no faults of its own; only keys under fsw. can be set"
        )
    home = None if args.fsw is None else check_home(args.fsw)
    return Choice(tuple(args.set), args.process, home)


def _check_plot(plot: Path, choice: Choice, logs: Sequence[Path]) -> None:
    if not choice.is_other:
        raise UsageError("--plot shows what another setting or version says; give --set or --fsw too")
    if len(logs) != 1:
        raise UsageError(f"--plot shows one log, and there are {len(logs)}")
    if plot.suffix.lower().lstrip(".") not in FORMATS:
        raise UsageError(f"{plot}: a picture is one of {', '.join(FORMATS)}, by the end of its name")


def _replay_one(log: Path, choice: Choice, args: argparse.Namespace) -> tuple[Outcome | OpenLoop, list[str]]:
    """What came of one log, and the lines about it."""
    opened = open_log(log, choice)
    if not choice.is_other:
        with opened.fly() as again:
            outcome = compare_replay(opened.run, again, opened.tick_ns)
        return outcome, _format(log, outcome, opened)
    with opened.fly() as again:
        changes = compare_open_loop(opened.run, again, opened.tick_ns)
    lines = _format_open_loop(log, changes, choice)
    if args.plot is not None and changes.changes:
        _draw(opened, changes, args.plot, log, args.force)
        lines.append(f"  picture  {args.plot}")
    elif args.plot is not None:
        lines.append("  no signal differs, so there is no picture")
    return changes, lines


def _draw(opened: Opened, changes: OpenLoop, path: Path, log: Path, force: bool) -> None:
    from tools.replay.picture import choose_signals, draw_series, read_series

    chosen = choose_signals(changes)
    with create(path, log, force) as part:
        with opened.fly() as again:
            rows = read_series(opened.run, again, opened.tick_ns, chosen)
        title = f"{log.name}, open loop: {len(changes.changes)} of {changes.signals} signals differ"
        draw_series(rows, title, part, path.suffix.lower().lstrip("."))


def replay(log: Path, *, process: bool = False) -> Outcome:
    """What flying the log's inputs again gives. Raises RecordError or ConfigError where that cannot be done."""
    opened = open_log(log, Choice(process=process))
    with opened.fly() as again:
        return compare_replay(opened.run, again, opened.tick_ns)


def replay_open_loop(
    log: Path, overrides: Sequence[str] = (), *, home: Path | None = None, process: bool = False
) -> OpenLoop:
    """What other settings, or the version in `home`, make of the log's inputs.

    Raises RecordError or ConfigError where that cannot be done.
    """
    opened = open_log(log, Choice(tuple(overrides), process, home))
    with opened.fly() as again:
        return compare_open_loop(opened.run, again, opened.tick_ns)


def _format(log: Path, outcome: Outcome, opened: Opened) -> list[str]:
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
        lines.append(f"  {describe_origin(opened.run)}")
    return lines


def _format_open_loop(log: Path, outcome: OpenLoop, choice: Choice) -> list[str]:
    what = f" with the flight software of {choice.home}" if choice.home else ""
    lines = [
        f"{log}: open loop{what}: {len(outcome.changes)} of {outcome.signals} signals and {outcome.frames_differing} of "
        f"{outcome.frames} frames differ in {outcome.ticks} ticks",
        *(f"  {change.describe()}" for change in outcome.changes),
    ]
    if outcome.first_frame:
        lines.append(f"  frames: first {outcome.first_frame}")
    for side, names in (("recorded", outcome.only_recorded), ("replayed", outcome.only_replayed)):
        if names:
            lines.append(f"  only {side}: {', '.join(names)}")
    return lines
