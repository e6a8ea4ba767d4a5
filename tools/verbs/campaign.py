"""`hilsat campaign FILE`: many runs from one file, flown by all processors, judged, and kept in one directory.

Exit codes: 0 every run passed; 1 some did not; 2 usage; 3 a run could not be flown or judged, or results could not be
written; 130 and 143 stopped: `--resume DIR` goes on.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bus.errors import UsageError
from tools.verbs import campaign_results as results

CLOCKS = ("inprocess", "lockstep", "realtime")
SHOWN = 5  # worst runs in the table at the end
OTHERS = ("report", "diff", "show", "export")  # what is done with results: words that are no file


def expand(words: list[str]) -> list[str]:
    """The words behind `campaign`: a file is run."""
    if words and words[0] in ("run", *OTHERS, "-h", "--help"):
        return words
    return ["run", *words]


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        "campaign", help="many runs from one file, one answer", description=__doc__,
        usage="hilsat campaign FILE [options]   or   hilsat campaign WORD ...",
    )  # fmt: skip
    inner = parser.add_subparsers(metavar="FILE | WORD", required=True)
    _add_run(inner)
    results.add_parser(inner)


def _add_run(subparsers: Any) -> None:
    parser = subparsers.add_parser(
        "run", prog="hilsat campaign", help="fly a campaign; the word may be left out", description=__doc__
    )
    parser.add_argument("file", nargs="?", help="campaign file, or the name of one that ships with hilsat")
    parser.add_argument("--out", type=Path, metavar="DIR", help="directory of the results (default: runs/NAME-TIME)")
    parser.add_argument("--resume", type=Path, metavar="DIR", help="go on where the campaign in DIR stopped")
    parser.add_argument("--retry-infra", action="store_true", help="with --resume: fly again what could not be flown")
    parser.add_argument(
        "-j",
        "--jobs",
        type=int,
        default=None,
        metavar="N",
        help="runs at a time (default: one a processor)",
    )
    parser.add_argument(
        "--keep-logs", metavar="WHICH", help="none, failures, all, or 'worst N' (default: as the file says)"
    )
    parser.add_argument("--limit", type=float, metavar="S", help="wall time after which a run is taken to hang [s]")
    parser.add_argument("--seed", type=int, help="override the campaign's seed")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override any key; repeatable")
    parser.add_argument("--clock", choices=CLOCKS, help="another clock than in process: one run after the other")
    parser.add_argument("--bus", metavar="ADDRESS", help="with --clock: hub:, socketcan:vcan0, or INTERFACE:CHANNEL")
    parser.add_argument("--dask", metavar="ADDRESS", help="fly on a Dask cluster: tcp://HOST:PORT, or local")
    parser.add_argument("--dry-run", action="store_true", help="print the runs, how many, and how long they will take")
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    parser.add_argument("-q", "--quiet", action="store_true", help="no progress")
    parser.set_defaults(func=run)


@dataclass(frozen=True, slots=True)
class _Asked:
    """A campaign as it was asked for."""

    campaign: Any
    path: Path
    overrides: list[str]
    noted: dict[str, str]  # of the campaign that is gone on with


def run(args: argparse.Namespace) -> int:
    """Fly the campaign, or what is left of it; return the exit code."""
    from tools.campaign.job import make_job
    from tools.campaign.launch import Options, check_options, fly_campaign, make_directory
    from tools.campaign.progress import make_progress

    asked = _read(args)
    campaign = asked.campaign
    clock = args.clock or asked.noted.get("clock") or "inprocess"
    bus = args.bus or asked.noted.get("bus") or None
    options = Options(
        jobs=len(os.sched_getaffinity(0)) if args.jobs is None else args.jobs,
        keep_logs=args.keep_logs or asked.noted.get("keep_logs") or campaign.keep_logs,
        limit_s=campaign.limit_s if args.limit is None else args.limit,
        clock=clock, bus=bus, dask=args.dask, retry=args.retry_infra,
        noted={"path": str(asked.path.absolute()), "overrides": json.dumps(asked.overrides)},
    )  # fmt: skip
    check_options(options)
    job = make_job(
        campaign.name, campaign.bases, folder=asked.path.parent, requirements=campaign.requirements,
        metrics=campaign.metrics, clock=clock, bus=bus,
    )  # fmt: skip
    if args.dry_run:
        from tools.campaign.rehearsal import print_plan

        return print_plan(campaign, job, options.jobs, as_json=args.json)
    directory = args.resume or make_directory(args.out, campaign.name)
    progress, started_s = make_progress(args.quiet), time.monotonic()
    try:
        conclusion = fly_campaign(campaign, job, directory, options, progress, resume=args.resume is not None)
    finally:
        progress.close()
    _tell(args, directory, conclusion, time.monotonic() - started_s)
    return conclusion.exit_code


def _read(args: argparse.Namespace) -> _Asked:
    """The campaign that is asked for: a file's, or the one that was begun in a directory."""
    from tools.campaign.definition import find_campaign, load_campaign
    from tools.campaign.launch import read_overrides
    from tools.campaign.results import read_info

    overrides = [*([f"seed={args.seed}"] if args.seed is not None else []), *args.set]
    if args.resume is None:
        if args.file is None:
            raise UsageError("name a campaign file, or a directory to go on in with --resume DIR")
        if args.retry_infra:
            raise UsageError("--retry-infra: goes with --resume DIR")
        path = Path(find_campaign(args.file))
        return _Asked(load_campaign(path, overrides), path, overrides, {})
    if args.out is not None:
        raise UsageError("--out: a campaign that is gone on with stays in its directory; leave it out")
    info = read_info(args.resume)
    noted = dict(info.provenance)
    path = Path(find_campaign(args.file)) if args.file is not None else Path(noted.get("path", ""))
    if not path.is_file():
        raise UsageError(f"{args.resume}: its campaign file {path} is not there any more; name it: FILE --resume DIR")
    overrides = overrides or list(read_overrides(info))
    return _Asked(load_campaign(path, overrides), path, overrides, noted)


def _show(directory: Path) -> None:
    """The tables of `hilsat campaign show`, shorter."""
    from tools.campaign.summary import load
    from tools.campaign.table import list_grids, print_grids

    print_grids(list(list_grids(load(directory), None, None, SHOWN)))


def _tell(args: argparse.Namespace, directory: Path, conclusion: Any, wall_s: float) -> None:
    """What came of it, on stdout; how to go on, on stderr."""
    from tools.campaign.progress import describe_counts

    runs = sum(conclusion.counts.values())
    if args.json:
        summary = {
            "directory": str(directory), "runs": runs, "counts": dict(conclusion.counts), "flown": conclusion.flown,
            "logs": conclusion.logs, "wall_s": wall_s, "exit_code": conclusion.exit_code, "found": dict(conclusion.found),
        }  # fmt: skip
        print(json.dumps(summary, allow_nan=False), flush=True)
    else:
        if runs:
            _show(directory)
        what = "1 run" if runs == 1 else f"{runs} runs"
        print(f"{what}: {describe_counts(conclusion.counts)}\nresults  {directory}", flush=True)
    if conclusion.signal:
        print(f"hilsat campaign: stopped; go on with: hilsat campaign --resume {directory}", file=sys.stderr)
