"""`hilsat check FILE...`: validate scenarios and campaigns without running them."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from tools.config.check import check
from tools.config.file_kinds import is_campaign
from tools.config.scenario_files import find_scenario, list_shipped


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("check", help="validate scenario and campaign files", description=__doc__)
    parser.add_argument("scenario", nargs="+", help="scenario or campaign: file or shipped name")
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Check every file; return 0, or 2 when anything is wrong."""
    return check([find_file(name) for name in args.scenario], as_json=args.json, check_other=_check_campaign)


def _check_campaign(path: Path, as_json: bool) -> dict[str, Any] | None:
    """Report on a campaign; None for what is none."""
    if not is_campaign(path):
        return None
    from tools.campaign.check import check_campaign

    return check_campaign(path, as_json=as_json)


def find_file(name: str) -> Path:
    """The file of a scenario or campaign. Raises UsageError with the near miss."""
    if "/" not in name and name not in list_shipped():
        from tools.campaign.definition import find_campaign, list_campaigns

        if name in list_campaigns():
            return find_campaign(name)
    return find_scenario(name)
