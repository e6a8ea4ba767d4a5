"""`hilsat live SCENARIO`: fly a scenario at the pace of the clock, to be watched and broken in Foxglove or Lichtblick.

hilsat live zhang2018-flight                        then open ws://127.0.0.1:8765, with the layout of hilsat report --layout
hilsat live nominal --speed 10 --out runs/mine      ten times as fast, and logged

Everything runs in this process and is served on 127.0.0.1 alone: every topic with the schemas of the log, the scene, events,
and one service for every kind of fault. Ctrl-C ends it. Exit codes: 0 flown (with --out: graded as `hilsat run` does, 1 for
a fail); 2 usage, a port that is taken, a missing extra; 130 interrupted.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bus.errors import UsageError
from bus.process import raise_signals
from tools.config.loader import load_scenario
from tools.config.scenario import Resolved
from tools.config.scenario_files import find_scenario

if TYPE_CHECKING:
    from tools.foxglove.live import LiveBench

PORT: Final = 8765
MISSING: Final = "hilsat live needs Foxglove's SDK, which is not installed: pip install 'hilsat[live]'"


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        "live", help="fly a scenario served to Foxglove", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("scenario", help="scenario file, or the name of one that ships with hilsat")
    parser.add_argument("--port", type=int, default=PORT, help=f"of 127.0.0.1 (default {PORT}; 0: any that is free)")
    parser.add_argument("--speed", type=float, default=1.0, metavar="X", help="times the pace of the clock (default 1)")
    parser.add_argument("--duration", type=float, metavar="S", help="override the scenario's duration [s]")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override any key; repeatable")
    parser.add_argument("--out", type=Path, help="directory for a log (default: none is kept)")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Fly and serve; return the exit code."""
    if importlib.util.find_spec("foxglove") is None:
        raise UsageError(MISSING)
    if not (math.isfinite(args.speed) and args.speed > 0.0):
        raise UsageError(f"--speed {args.speed:g}: must be above 0; 1 is the pace of the clock")
    if not 0 <= args.port <= 65535:
        raise UsageError(f"--port {args.port}: must be 0 to 65535")
    named = [] if args.duration is None else [f"duration_s={args.duration}"]
    overrides = ["clock.mode=inprocess", "inject=allowed", *named, *args.set]
    resolved = load_scenario(find_scenario(args.scenario), overrides)
    from tools.foxglove.live import LiveBench

    with raise_signals() as came, _place_log(args.out, resolved) as log:
        started_s = time.monotonic()
        live = LiveBench(resolved, args.port, log)
        reason = "failed"
        try:
            _greet(live, resolved)
            live.fly(args.speed, _say_behind)
            reason = "done"
        except KeyboardInterrupt:
            reason = "interrupted"
        finally:
            live.close(reason)
        if log is None:
            return 128 + came[0] if came else 0
        return _conclude(resolved, log, live, came, time.monotonic() - started_s)


@contextlib.contextmanager
def _place_log(out: Path | None, resolved: Resolved) -> Iterator[Path | None]:
    if out is None:
        yield None
        return
    from tools.run.directory import LOG, own_directory

    with own_directory(out, resolved.scenario.name) as directory:
        yield directory / LOG


def _greet(live: LiveBench, resolved: Resolved) -> None:
    print(live.url, flush=True)
    print(
        f"{resolved.scenario.name}: {resolved.scenario.duration_s:g} s. In Foxglove or Lichtblick: open a connection, "
        f"Foxglove WebSocket, {live.url}; or {live.app_url}\n"
        "panels with a button for every fault: hilsat report --layout. Ctrl-C ends it.",
        file=sys.stderr,
    )


def _say_behind(by_s: float) -> None:
    print(f"hilsat live: the machine is too slow for this pace: {by_s:.1f} s behind, and let go", file=sys.stderr)


def _conclude(resolved: Resolved, log: Path, live: LiveBench, came: list[int], wall_s: float) -> int:
    """Grade as a run is graded, and say where the log is."""
    from tools.run.conclusion import conclude
    from tools.run.runner import RunReport

    report = RunReport(log, 128 + came[0] if came else 0, ticks=live.bench.tick, wall_s=wall_s)
    result = conclude(resolved, report, draw=False)
    print(result.as_text())
    for problem in report.problems:
        print(f"hilsat live: {problem}", file=sys.stderr)
    return result.exit_code
