"""`hilsat plant SCENARIO` and `hilsat fsw SCENARIO`: one side alone, to meet the other on a bus.

Start them in two terminals, on one machine or on two with a CAN cable between them:

    hilsat plant zhang2018 --bus hub:/tmp/bench        hilsat fsw zhang2018 --bus hub:/tmp/bench
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from bus.errors import RecordError, UsageError
from bus.process import raise_signals
from tools.config.loader import load_scenario
from tools.config.scenario import Resolved
from tools.config.scenario_files import find_scenario
from tools.ground.launch import GatewayPlan, end_gateway, plan_gateway
from tools.log.mcap_writer import is_taken
from tools.run.children import Process, make_pipe, start, stop
from tools.run.run_file import describe_bench, ground_of, write_run_file
from tools.run.runner import describe, make_private
from tools.run.watch import RECORDER_PATIENCE_S
from tools.verbs.run import add_ground_options


def add_parser(subparsers: Any) -> None:
    """Add both verbs to the command line."""
    for verb, what in (("plant", "the plant: truth, sensors, wheels"), ("fsw", "the flight software")):
        parser = subparsers.add_parser(
            verb, help=f"run {what}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        parser.add_argument("scenario", help="scenario file or shipped name; the same on both sides")
        parser.add_argument("--bus", help="bus address: hub:DIR, socketcan:vcan0, or INTERFACE:CHANNEL")
        parser.add_argument("--clock", choices=("lockstep", "realtime"), help="override the scenario's clock")
        parser.add_argument("--seed", type=int, help="override the scenario's seed")
        parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override any key")
        add_ground_options(parser)
        parser.add_argument("--log", type=Path, help="MCAP file for this side's telemetry (default: none)")
        parser.set_defaults(func=run, verb=verb)


def run(args: argparse.Namespace) -> int:
    """Become that side; return its exit code."""
    named = {"bus.address": args.bus, "clock.mode": args.clock, "seed": args.seed}
    named["inject"] = "allowed" if args.inject else None
    overrides = [f"{key}={value}" for key, value in named.items() if value is not None]
    resolved = load_scenario(find_scenario(args.scenario), overrides + args.set)
    if resolved.scenario.bus.address == "hub:":
        raise UsageError("two separate programs need a bus to meet on: name it with --bus, for example hub:/tmp/bench")
    if args.log is not None and is_taken(args.log):
        raise UsageError(f"{args.log}: there is a file of that name already; name another one with --log")
    with (
        raise_signals(),
        make_private() as directory,
        plan_gateway(args.mavlink, args.mavlink_key) as gateway,
        contextlib.ExitStack() as stack,
    ):
        config = _write_files(resolved, args, directory, stack, gateway)
        if args.log is None:
            return _become(args.verb, ["--config", str(config)])
        return _run_logged(resolved, args, config)


def _write_files(
    resolved: Resolved,
    args: argparse.Namespace,
    private: Path,
    stack: contextlib.ExitStack,
    gateway: GatewayPlan | None,
) -> Path:
    """Write what the side is told and says of itself, start its gateway; return the path of the former."""
    address, out = resolved.scenario.bus.address, None if args.log is None else args.log.parent
    bench = describe_bench(resolved, private, address=address, out=out, side=args.verb, linked=gateway is not None)
    config = private / f"{args.verb}.json"
    text = (
        resolved.fsw_json(ground=ground_of(bench, bench.fsw))
        if args.verb == "fsw"
        else resolved.plant_json(ground=ground_of(bench, bench.plant))
    )
    config.write_text(text, encoding="utf-8")
    write_run_file(private, bench)
    if gateway is not None:
        process = gateway.start(private, bench)
        stack.callback(lambda: _tell(end_gateway(process)))
    return config


def _tell(notes: list[str]) -> None:
    for note in notes:
        print(f"hilsat: {note}", file=sys.stderr)


def _become(verb: str, arguments: list[str]) -> int:
    if verb == "fsw":
        from fsw.__main__ import main
    else:
        from plant_server.__main__ import main
    return main(arguments)


def _run_logged(resolved: Resolved, args: argparse.Namespace, config: Path) -> int:
    """Become that side with a recorder beside it. Raises RecordError when the recorder failed."""
    read_end, write_end = make_pipe()
    pipe = os.fstat(write_end)
    recorder = _start_recorder(resolved, args, config, read_end)
    os.close(read_end)
    try:
        code = _become(args.verb, ["--config", str(config), "--telemetry-fd", str(write_end)])
    finally:
        # The side closes its end, but not when it fails before it has opened the bus.
        with contextlib.suppress(OSError):
            if os.path.samestat(pipe, os.fstat(write_end)):
                os.close(write_end)
        with contextlib.suppress(subprocess.TimeoutExpired):
            recorder.popen.wait(RECORDER_PATIENCE_S)
        stop([recorder])
    if recorder.code:
        raise RecordError(recorder.words() or recorder.fate())
    return code


def _start_recorder(resolved: Resolved, args: argparse.Namespace, config: Path, read_end: int) -> Process:
    source = 2 if args.verb == "fsw" else 1
    meta = config.with_name("meta.json")
    meta.write_text(json.dumps(describe(resolved, resolved.scenario.bus.address)), encoding="utf-8")
    words = ["--out", str(args.log), "--meta", str(meta), "--source", f"{source}:{read_end}"]
    return start(
        "recorder", "tools.run.recorder_process", words, [read_end], config.with_name("recorder.err"), orphan=True
    )
