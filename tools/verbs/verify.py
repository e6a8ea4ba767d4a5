"""`hilsat verify SCENARIO`: whether this machine repeats a run to the byte, on every clock and bus that it has.

The scenario is run twice in process, by two processes over the embedded bus, on vcan where an interface is up, and by the
other build where there is one; the deterministic content of all logs must be the same. Grades do not matter here.

Exit codes: 0 all the same; 1 one differs; 3 one could not be run.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from bus.process import raise_signals
from tools.config.loader import load_scenario
from tools.config.scenario_files import find_scenario
from tools.log.diff import format_comparison
from tools.run.verification import Tried, list_ways, try_ways


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("verify", help="whether this machine repeats a run to the byte", description=__doc__)
    parser.add_argument("scenario", help="scenario file, or the name of one that ships with hilsat")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override any key; repeatable")
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Run it in every way; a line each."""
    path = find_scenario(args.scenario)
    load_scenario(path, args.set)  # what is wrong with it is said once, before anything runs
    ways, missing = list_ways()
    tried: list[Tried] = []
    with raise_signals(), tempfile.TemporaryDirectory(prefix="hilsat-verify-") as place:
        for result in try_ways(str(path), args.set, ways, Path(place)):
            tried.append(result)
            if not args.json:
                print(_format(result), flush=True)
    same = all(result.same for result in tried)
    ran = all(result.digest for result in tried)
    if args.json:
        print(json.dumps({"same": same, "ways": [result.as_dict() for result in tried], "not_tried": missing}))
    else:
        for words in missing:
            print(f"not tried  {words}", file=sys.stderr)
        print(f"{'the same bytes' if same else 'NOT THE SAME' if ran else 'NOT EXECUTED'}: {len(tried)} ways")
    return 0 if same else 1 if ran else 3


def _format(result: Tried) -> str:
    if not result.digest:
        return f"TROUBLE    {result.way}: {result.trouble}"
    line = f"{'same' if result.same else 'DIFFERS':<10} {result.digest[:16]}  {result.way}"
    if result.comparison is not None:
        line += "\n  " + format_comparison(result.comparison).replace("\n", "\n  ")
    return line
