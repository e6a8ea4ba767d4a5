"""`hilsat run SCENARIO`: from a scenario file to a graded log and a picture."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bus.errors import ConfigError, UsageError
from bus.process import raise_signals
from tools.config.file_kinds import is_campaign
from tools.config.loader import load_scenario
from tools.config.scenario import Resolved
from tools.config.scenario_files import find_scenario
from tools.ground.launch import GatewayPlan, plan_gateway
from tools.ground.links import HELP
from tools.run.directory import own_directory
from tools.run.runner import RunReport, print_progress, run_processes

CLOCKS = ("lockstep", "realtime", "inprocess")


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("run", help="run a scenario", description=__doc__)
    parser.add_argument("scenario", help="scenario file or shipped name, or FILE#N or DIR#N: run N of a campaign")
    parser.add_argument("--bus", help="bus address: hub: (default), hub:DIR, socketcan:vcan0, or INTERFACE:CHANNEL")
    parser.add_argument("--clock", choices=CLOCKS, help="override the scenario's clock")
    parser.add_argument("--seed", type=int, help="override the scenario's seed")
    parser.add_argument("--duration", type=float, metavar="S", help="override the scenario's duration [s]")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override any key; repeatable")
    add_ground_options(parser)
    parser.add_argument("--out", type=Path, help="directory for the log and the picture (default: runs/NAME-TIME)")
    parser.add_argument("--no-plot", action="store_true", help="draw no picture")
    parser.add_argument("--no-scene", action="store_true", help="put no 3D scene for Foxglove into the log")
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    parser.add_argument("-q", "--quiet", action="store_true", help="no progress")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Run, grade, draw and report; return the exit code."""
    resolved = _load(args)
    with (
        raise_signals(),
        plan_gateway(args.mavlink, args.mavlink_key) as gateway,
        own_directory(args.out, resolved.scenario.name) as out_dir,
    ):
        return _conclude(args, resolved, _fly(args, resolved, out_dir, gateway))


def _load(args: argparse.Namespace) -> Resolved:
    if "#" in args.scenario:
        from tools.campaign.one_run import load_one, split_word

        if (parts := split_word(args.scenario)) is not None:
            one = load_one(*parts, _overrides(args))
            if not args.quiet:
                print(one.words, file=sys.stderr)
            return one.resolved
    path = find_scenario(args.scenario)
    try:
        return load_scenario(path, _overrides(args))
    except ConfigError:
        if is_campaign(Path(path)):
            raise UsageError(
                f"{args.scenario} is a campaign: `hilsat campaign {args.scenario}` flies it, `hilsat run "
                f"{args.scenario}#N` its run N"
            ) from None
        raise


def add_ground_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that let others into a running bench."""
    parser.add_argument("--inject", action="store_true", help="take faults from `hilsat inject` while it runs")
    parser.add_argument(
        "--mavlink",
        action="append",
        default=[],
        metavar="ADDRESS",
        help=f"link to a ground station: {HELP}; repeatable",
    )
    parser.add_argument(
        "--mavlink-key", type=Path, metavar="FILE", help="sign these links: 32 bytes or a passphrase, mode 0600"
    )


def _fly(args: argparse.Namespace, resolved: Resolved, out_dir: Path, gateway: GatewayPlan | None) -> RunReport:
    if args.quiet:
        return _execute(resolved, out_dir, lambda tick: None, gateway)
    scenario = resolved.scenario
    print(
        f"{scenario.name}: {scenario.title}\n  {scenario.duration_s:g} s at {scenario.clock.tick_hz} Hz, "
        f"{scenario.clock.mode}, seed {scenario.seed}",
        file=sys.stderr,
    )
    report = _execute(resolved, out_dir, print_progress(resolved.ticks), gateway)
    if sys.stderr.isatty():
        print(file=sys.stderr)
    return report


def _overrides(args: argparse.Namespace) -> list[str]:
    named = {"bus.address": args.bus, "clock.mode": args.clock, "seed": args.seed, "duration_s": args.duration}
    named["inject"] = "allowed" if args.inject else None
    extra: list[str] = args.set
    return [f"{key}={value}" for key, value in named.items() if value is not None] + extra


def _execute(
    resolved: Resolved, out_dir: Path, on_progress: Callable[[int], None], gateway: GatewayPlan | None
) -> RunReport:
    if resolved.scenario.clock.mode != "inprocess":
        return run_processes(resolved, out_dir, on_progress, gateway)
    from tools.run.in_process import run_in_process

    with raise_signals() as came:
        report = run_in_process(resolved, out_dir, on_progress, gateway)
    if came:
        report.exit_code = 128 + came[0]
    return report


def _conclude(args: argparse.Namespace, resolved: Resolved, report: RunReport) -> int:
    from tools.run.conclusion import conclude

    result = conclude(resolved, report, draw=not args.no_plot, scene=not args.no_scene)
    if args.json:
        print(json.dumps(result.as_dict(), allow_nan=False))
    elif text := result.as_text():
        print(text)
    for problem in (*report.problems, *report.notes):
        print(f"hilsat run: {problem}", file=sys.stderr)
    return result.exit_code
