"""`hilsat check FILE...`: validate scenarios without running them."""

from __future__ import annotations

import argparse
from typing import Any

from tools.config.check import check
from tools.config.scenario_files import find_scenario


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("check", help="validate scenario files", description=__doc__)
    parser.add_argument("scenario", nargs="+", help="scenario file or shipped name")
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Check every file; return 0, or 2 when anything is wrong."""
    return check([find_scenario(name) for name in args.scenario], as_json=args.json)
