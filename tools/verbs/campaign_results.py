"""`hilsat campaign show|report|diff|export`: what a campaign's results say.

DIR is the directory that `hilsat campaign FILE` wrote; an unfinished campaign is shown as far as it got.
Exit codes: 0 done (diff: nothing worse beyond chance); 1 diff: something got worse; 2 usage, and campaigns that cannot be
compared; 3 a directory that cannot be read.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from bus.errors import UsageError

PAGE: Final = "report.html"


def add_parser(subparsers: Any) -> None:
    """Add the sub-verbs that read results."""
    show = _add(subparsers, "show", show_campaign, "tables on the terminal: cells, requirements, worst runs")
    show.add_argument("directory", type=Path, metavar="DIR", help="of the campaign")
    _add_axes(show)
    show.add_argument("--worst", type=int, default=10, metavar="N", help="runs to list, the worst first (default 10)")
    show.add_argument("--json", action="store_true", help="one JSON object on stdout")

    report = _add(subparsers, "report", write_report, "one HTML page: cells, distributions, worst runs, coverage")
    report.add_argument("directory", type=Path, metavar="DIR", help="of the campaign")
    _add_axes(report)
    report.add_argument("-o", "--out", type=Path, help=f"file to write (default: {PAGE} in the directory)")
    report.add_argument("-f", "--force", action="store_true", help="replace a file of that name")

    diff = _add(subparsers, "diff", compare_campaigns, "which cells got better or worse beyond chance")
    diff.add_argument("before", type=Path, metavar="A", help="directory of the campaign before")
    diff.add_argument("after", type=Path, metavar="B", help="directory of the campaign after")
    diff.add_argument("--confidence", type=float, default=0.95, help="that no alarm is false (default 0.95)")
    diff.add_argument("--all", action="store_true", help="every test, not only what changed")
    diff.add_argument("--json", action="store_true", help="one JSON object on stdout")

    export = _add(subparsers, "export", export_results, "one flat table, a run a row: Parquet or CSV")
    export.add_argument("directory", type=Path, metavar="DIR", help="of the campaign")
    export.add_argument("--parquet", type=Path, metavar="FILE", help="write Parquet (needs pyarrow)")
    export.add_argument("--csv", type=Path, metavar="FILE", help="write CSV; - for stdout")
    export.add_argument("-f", "--force", action="store_true", help="replace files of these names")


def _add(subparsers: Any, name: str, func: Callable[[argparse.Namespace], int], words: str) -> Any:
    parser = subparsers.add_parser(name, help=words, description=__doc__)
    parser.set_defaults(func=func)
    return parser


def _add_axes(parser: Any) -> None:
    parser.add_argument("--rows", metavar="AXIS", help="rows of the matrix (default: the axis that matters most)")
    parser.add_argument("--columns", metavar="AXIS", help="columns of the matrix (default: the axis that matters next)")


def show_campaign(args: argparse.Namespace) -> int:
    """Print tables, or one JSON object."""
    from tools.campaign.summary import load
    from tools.campaign.table import describe_loaded, list_grids, print_grids

    if args.worst < 0:
        raise UsageError(f"--worst {args.worst}: give 0 or more runs")
    loaded = load(args.directory)
    if args.json:
        print(json.dumps(describe_loaded(loaded, args.rows, args.columns, args.worst), allow_nan=False), flush=True)
    else:
        print_grids(list(list_grids(loaded, args.rows, args.columns, args.worst)))
    return 0


def write_report(args: argparse.Namespace) -> int:
    """Write the page and print its path."""
    from tools.campaign.page import write_page

    print(write_page(args.directory, args.out, args.force, args.rows, args.columns))
    return 0


def compare_campaigns(args: argparse.Namespace) -> int:
    """Print what changed; return 1 when something got worse."""
    from tools.campaign.comparison import compare
    from tools.campaign.summary import load
    from tools.campaign.table import list_changes, print_grids

    if not 0.5 < args.confidence < 1.0:
        raise UsageError(f"--confidence {args.confidence:g}: give a share above 0.5 and below 1, such as 0.95")
    comparison = compare(load(args.before), load(args.after), args.confidence)
    if args.json:
        print(json.dumps(comparison.as_dict(), allow_nan=False), flush=True)
    else:
        print_grids(list(list_changes(comparison, args.all)))
    return 1 if comparison.is_worse else 0


def export_results(args: argparse.Namespace) -> int:
    """Write the tables and print their paths."""
    from tools.campaign.export import make_columns, print_csv, write_csv, write_parquet
    from tools.campaign.results import RESULTS_FILE, read_timings
    from tools.campaign.summary import load
    from tools.log.outputs import create

    if args.parquet is None and args.csv is None:
        raise UsageError("export: say what to write: --csv FILE (- for stdout), --parquet FILE, or both")
    columns = make_columns(load(args.directory), read_timings(args.directory))
    if args.csv == Path("-"):
        print_csv(sys.stdout, columns)
        args.csv = None
    for path, write in ((args.csv, write_csv), (args.parquet, write_parquet)):
        if path is not None:
            with create(path, args.directory / RESULTS_FILE, args.force) as part:
                write(part, columns)
            print(path)
    return 0
