"""`hilsat info LOG...`: what a log holds, how its run ended, its verdict, faults, warnings and versions, on one screen.

Exit codes: 0 said; 3 when a file is no log that can be read.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from bus.errors import HilsatError
from tools.log.mcap_reader import read_run
from tools.report.info import collect_info, format_info


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("info", help="what a log holds and how its run ended", description=__doc__)
    parser.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="MCAP file of a run")
    parser.add_argument("--json", action="store_true", help="one JSON object a log on stdout")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Say it for each log; one that cannot be read does not keep the others from being told."""
    code = 0
    for i, log in enumerate(args.logs):
        try:
            info = collect_info(read_run(log))
        except HilsatError as error:
            code = max(code, error.exit_code)
            print(f"hilsat info: {error}", file=sys.stderr)
            continue
        if args.json:
            print(json.dumps(info.as_dict(), allow_nan=False))
        else:
            print(("\n" if i else "") + format_info(info))
    return code
