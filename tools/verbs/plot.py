"""`hilsat plot LOG`: draw attitude error, rates, wheel torques and the fault torque against its estimate."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from bus.errors import UsageError

FORMATS = ("png", "svg", "pdf")


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("plot", help="draw a log as PNG", description=__doc__)
    parser.add_argument("log", type=Path, help="MCAP file of a run")
    parser.add_argument(
        "-o", "--out", type=Path, help="picture to write: png, svg or pdf (default: PNG beside the log)"
    )
    parser.add_argument("--force", action="store_true", help="replace a picture of that name")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Draw and print the path of the picture."""
    from tools.grading.grade import scenario_of
    from tools.log.completeness import warn_of_missing
    from tools.log.mcap_reader import read_run
    from tools.log.outputs import create
    from tools.report.plot import draw_run

    out: Path = args.out or args.log.with_suffix(".png")
    form = out.suffix.lower().lstrip(".")
    if form not in FORMATS:
        raise UsageError(f"{out}: a picture is one of {', '.join(FORMATS)}, by the end of its name")
    run_log = read_run(args.log)
    resolved = scenario_of(run_log, args.log)
    warn_of_missing(run_log, "plot")
    with create(out, args.log, args.force) as part:
        draw_run(run_log, resolved, part, form)
    print(out)
    return 0
