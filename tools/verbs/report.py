"""`hilsat report LOG...`: one HTML file to read, print or send: verdicts and margins first, then what lies behind them.

It needs no network, no server and no script. Exit codes: 0 written; 2 there is such a file already; 3 a log that cannot be
graded.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("report", help="one HTML page about one or more logs", description=__doc__)
    parser.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="MCAP file of a run")
    parser.add_argument("-o", "--out", type=Path, help="file to write (default: report.html beside the first log)")
    parser.add_argument("-f", "--force", action="store_true", help="replace a file of that name")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Write the page and print its path."""
    from tools.log.outputs import create
    from tools.report.page.content import gather
    from tools.report.page.page import render

    out: Path = args.out or args.logs[0].with_name("report.html")
    with create(out, args.logs, args.force) as part:
        sections = [gather(log, number) for number, log in enumerate(args.logs, 1)]
        part.write_text(render(sections), encoding="utf-8")
    print(out)
    return 0
