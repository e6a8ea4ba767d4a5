"""`hilsat plot LOG`: draw attitude error, rates, wheel torques and the fault torque against its estimate."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("plot", help="draw a log as PNG", description=__doc__)
    parser.add_argument("log", type=Path, help="MCAP file of a run")
    parser.add_argument("-o", "--out", type=Path, help="PNG to write (default: beside the log)")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Draw and print the path of the picture."""
    from tools.grading.grade import scenario_of
    from tools.log.mcap_reader import read_run
    from tools.report.plot import draw_run

    run_log = read_run(args.log)
    print(draw_run(run_log, scenario_of(run_log, args.log), args.out or args.log.with_suffix(".png")))
    return 0
