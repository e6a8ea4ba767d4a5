"""`hilsat plot LOG`: draw attitude error, rates, wheel torques and the fault torque against its estimate.

hilsat plot run.mcap                                                     the usual picture, run.png beside the log
hilsat plot run.mcap --signals 'truth.attitude.error_deg,fsw.control.tau_cmd_b_nm' --out torque.svg
hilsat plot run.mcap --compare other.mcap --signals 'norm(truth.attitude.omega_bi_b_rad_s)' --until 60

Signals are written as in expectations; one that is a vector is drawn element by element. Faults are shaded. Of every
stretch of a long log the smallest and the largest value are drawn, so that no peak is lost. Exit codes: 0 drawn; 2 usage,
or a signal that the log has not; 3 a log that cannot be read.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from bus.errors import UsageError

FORMATS = ("png", "svg", "pdf")


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        "plot", help="draw a log, or any signals of some logs", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("log", type=Path, help="MCAP file of a run")
    parser.add_argument(
        "-s", "--signals", action="append", default=[], metavar="A,B", help="signals to draw, a panel each; repeatable"
    )
    parser.add_argument(
        "-c", "--compare", action="append", default=[], type=Path, metavar="LOG2",
        help="draw the same signals of another log into the same panels; repeatable",
    )  # fmt: skip
    parser.add_argument("--from", dest="from_s", type=float, metavar="S", help="draw from this simulated time on [s]")
    parser.add_argument("--until", dest="until_s", type=float, metavar="S", help="draw up to this simulated time [s]")
    parser.add_argument(
        "-o", "--out", type=Path,
        help="picture to write: png, svg or pdf (default: PNG beside the log, with --signals run.signals.png)",
    )  # fmt: skip
    parser.add_argument("--force", action="store_true", help="replace a picture of that name")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Draw and print the path of the picture."""
    from tools.grading.grade import scenario_of
    from tools.log.completeness import warn_of_missing
    from tools.log.mcap_reader import read_run
    from tools.log.outputs import create
    from tools.report.plot import draw_run

    window = (args.from_s, args.until_s)
    free = bool(args.signals or args.compare or window != (None, None))
    out: Path = args.out or args.log.with_suffix(".signals.png" if free else ".png")
    form = out.suffix.lower().lstrip(".")
    if form not in FORMATS:
        raise UsageError(f"{out}: a picture is one of {', '.join(FORMATS)}, by the end of its name")
    if None not in window and not args.from_s < args.until_s:
        raise UsageError(f"--from {args.from_s:g} --until {args.until_s:g}: nothing lies between them")
    logs = [args.log, *args.compare]
    runs = [read_run(log) for log in logs]
    resolved = None if free else scenario_of(runs[0], args.log)
    for log in runs:
        warn_of_missing(log, "plot")
    with create(out, logs, args.force) as part:
        if resolved is not None:
            draw_run(runs[0], resolved, part, form)
        else:
            _draw_free(args, runs, part, form)
    print(out)
    return 0


def _draw_free(args: argparse.Namespace, runs: list[Any], part: Path, form: str) -> None:
    from tools.report.signal_plot import USUAL, Window, draw_signals, split_signals

    signals = split_signals(args.signals) if args.signals else list(USUAL)
    if not signals:
        raise UsageError("--signals names none; write them as in expectations: truth.attitude.error_deg")
    draw_signals(runs, signals, part, form, Window(args.from_s, args.until_s))
