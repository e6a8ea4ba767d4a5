"""`hilsat report LOG...`: one HTML file to read, print or send: verdicts and margins first, then what lies behind them.

It needs no network, no server and no script. `hilsat report --layout` writes a layout of panels for Foxglove and
Lichtblick instead; with a LOG, one without the panels that this log has nothing for. Exit codes: 0 written; 2 there is such
a file already; 3 a log that cannot be graded.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, Final

from bus.errors import UsageError

LAYOUT: Final = "hilsat-foxglove.json"


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("report", help="one HTML page about one or more logs", description=__doc__)
    parser.add_argument("logs", type=Path, nargs="*", metavar="LOG", help="MCAP file of a run")
    parser.add_argument(
        "-o", "--out", type=Path, help=f"file to write (default: report.html beside the first log; layout: {LAYOUT})"
    )
    parser.add_argument(
        "--layout", nargs="?", type=Path, const=Path(), metavar="FILE", help="write a layout for Foxglove, no report"
    )
    parser.add_argument("-f", "--force", action="store_true", help="replace a file of that name")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Write the page, or the layout, and print its path."""
    from tools.log.outputs import create

    if args.layout is not None:
        return _write_layout(args)
    if not args.logs:
        raise UsageError("name the log of a run: hilsat report runs/NAME/run.mcap")
    from tools.report.page.content import gather
    from tools.report.page.page import render

    out: Path = args.out or args.logs[0].with_name("report.html")
    with create(out, args.logs, args.force) as part:
        sections = [gather(log, number) for number, log in enumerate(args.logs, 1)]
        part.write_text(render(sections), encoding="utf-8")
    print(out)
    return 0


def _write_layout(args: argparse.Namespace) -> int:
    from tools.foxglove.layout import format_layout, make_layout
    from tools.foxglove.scene_log import has_scene
    from tools.log.mcap_reader import read_run
    from tools.log.outputs import create

    named = None if args.layout == Path() else args.layout
    if named is not None and named.suffix == ".mcap":
        raise UsageError(
            f"--layout {named}: this would be the file to write; put the log first: report {named} --layout"
        )
    if len(args.logs) > 1:
        raise UsageError("a layout is for one log, or for any without one; name one LOG at most")
    topics = None
    for log in args.logs:
        run_log = read_run(log)
        topics = run_log.topics
        if not has_scene(run_log):
            print(
                f"hilsat report: {log}: no 3D scene is in it; `hilsat export {log} --to scene -o FILE.mcap` makes a copy "
                "that has one",
                file=sys.stderr,
            )
    out: Path = args.out or named or Path(LAYOUT)
    with create(out, args.logs, args.force) as part:
        part.write_text(format_layout(make_layout(topics)), encoding="utf-8")
    print(out)
    return 0
