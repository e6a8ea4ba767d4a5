"""`hilsat shootout [SCENARIO]`: every attitude law times every allocator through the same faults; one table, one picture.

Each law flies with its defaults and with what it is made for (docs/laws.md); a pair that cannot fly is a row that says why.
Exit codes: 0 all flew; 1 a pair could not; 2 usage, or nobody could; 3 a pair failed on the way; 130 cut short.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

from bus.errors import ConfigError, UsageError
from bus.process import raise_signals
from tools.config.scenario_files import find_scenario
from tools.shootout.pairs import Contest, choose_pairs

TABLE, OBJECT, PICTURE = "table.md", "shootout.json", "shootout.png"
MOST_JOBS = 64


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("shootout", help="every law times every allocator, one table", description=__doc__)
    parser.add_argument(
        "scenario", nargs="?", default="zhang2018", help="scenario file, or the name of one that ships (zhang2018)"
    )
    parser.add_argument("--controllers", metavar="A,B", help="only these laws, by their kinds")
    parser.add_argument("--allocators", metavar="X,Y", help="only these allocators")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override any key; repeatable")
    parser.add_argument("--until", type=float, metavar="S", help="fly so long [s]; faults that come later are left out")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="fly N pairs at a time (default 1)")
    parser.add_argument("--out", type=Path, metavar="DIR", help=f"write {TABLE}, {OBJECT} and {PICTURE} there")
    parser.add_argument(
        "--plot", action=argparse.BooleanOptionalAction, default=None, help="draw a picture (default: with --out)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    parser.add_argument("-q", "--quiet", action="store_true", help="no progress")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Fly all pairs, print and write the table; return the exit code."""
    from tools.shootout.flights import FAILED, FLEW, REFUSED, Outcome, fly_all
    from tools.shootout.table import Shootout, describe

    _check(args)
    pairs = choose_pairs(args.controllers, args.allocators)
    contest = Contest(find_scenario(args.scenario), tuple(args.set), args.until)
    contest.check()
    common = contest.load_common()
    files = _claim_files(args)

    def tell(outcome: Outcome) -> None:
        if not args.quiet:
            print(describe(outcome), file=sys.stderr, flush=True)

    with raise_signals() as came:
        outcomes, number = fly_all(contest, pairs, args.jobs, tell)
    shootout = Shootout(common.scenario, contest.settings, outcomes, came[0] if came else number)
    states = {outcome.state for outcome in outcomes}
    if states == {REFUSED}:
        raise ConfigError(f"no pair can fly; {outcomes[0].pair.name}:\n{outcomes[0].reason}")
    print(json.dumps(shootout.as_dict(), allow_nan=False) if args.json else shootout.as_text(), flush=True)
    _write(shootout, files)
    if shootout.signal:
        return 128 + shootout.signal
    return 3 if FAILED in states else 0 if states == {FLEW} else 1


def _check(args: argparse.Namespace) -> None:
    if not 1 <= args.jobs <= MOST_JOBS:
        raise UsageError(f"--jobs {args.jobs}: give 1 to {MOST_JOBS} pairs at a time")
    if args.plot and args.out is None:
        raise UsageError("--plot: say where the picture is to go, with --out DIR")


def _claim_files(args: argparse.Namespace) -> dict[str, Path]:
    """What is to be written, in a directory that is there from now on. Raises UsageError for what is there already."""
    if args.out is None:
        return {}
    names = [TABLE, OBJECT] + ([PICTURE] if args.plot is not False else [])
    try:
        args.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{args.out}: cannot make the directory: {error.strerror}; use --out") from None
    for name in names:
        if os.path.lexists(args.out / name):
            raise UsageError(f"{args.out}: there is a {name} in it already; name another directory with --out")
    return {name: args.out / name for name in names}


def _write(shootout: Any, files: dict[str, Path]) -> None:
    """Table, object and picture, of what was flown."""
    from tools.shootout.flights import FLEW
    from tools.shootout.picture import draw_shootout

    try:
        if TABLE in files:
            files[TABLE].write_text(shootout.as_text() + "\n", encoding="utf-8")
        if OBJECT in files:
            files[OBJECT].write_text(json.dumps(shootout.as_dict(), allow_nan=False, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{error.filename}: cannot be written: {error.strerror}; use --out") from None
    if PICTURE in files and any(outcome.state == FLEW for outcome in shootout.outcomes):
        draw_shootout(shootout, files[PICTURE])
