"""`hilsat check` of a campaign: whether it can be flown, and what it comes to."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any, Final

from tools.campaign.inspection import Inspection, inspect

TRIED: Final = 400  # runs whose scenarios are loaded


def check_campaign(path: Path, *, as_json: bool) -> dict[str, Any]:
    """Report on a campaign in JSON types; for people it is printed too, problems to stderr."""
    found = inspect(os.fspath(path), (), TRIED)
    if found.campaign is None:
        if not as_json:
            _print_problems(found)
        more = {"unlisted_problems": found.unlisted} if found.unlisted else {}
        return {"file": found.path, "ok": False, "problems": [item.as_dict() for item in found.findings], **more}
    campaign = found.campaign
    points = campaign.points()
    report = {
        "file": found.path,
        "ok": True,
        "name": campaign.name,
        "title": campaign.title,
        "campaign": True,
        "runs": campaign.runs,
        "points": len(points),
        "strategy": campaign.strategy.kind,
        "axes": [
            {"name": axis.name, "kind": axis.kind, "key": axis.key, "labels": list(axis.labels), "unit": axis.unit}
            for axis in campaign.axes
        ],
        "metrics": list(campaign.metrics),
        "tried": found.tried,
        "notes": list_notes(found),
        "problems": [],
    }
    if not as_json:
        _print_summary(report)
    return report


def list_notes(found: Inspection) -> list[str]:
    """What is not wrong and may not be meant."""
    campaign, notes = found.campaign, []
    assert campaign is not None
    settings, space = campaign.settings, campaign.space
    if settings.sampling == "sobol" and settings.samples & (settings.samples - 1):
        notes.append(f"sobol: {settings.samples} samples are no power of 2, so the points are not balanced")
    if settings.samples > 1 and not space.list_columns():
        notes.append("samples: nothing is drawn, so it says nothing; for more runs at each point set repeats")
    if settings.where and settings.combine != "pairwise":
        everything = len(campaign.points())
        combinations = 1
        for items in space.lists.values():
            combinations *= 1 if settings.combine == "sampled" else len(items)
        whole = combinations * (settings.samples if space.list_columns() else 1) * settings.repeats
        notes.append(f"where: {whole - everything} of {whole} runs are left out")
    if found.tried < len(campaign.points()):
        notes.append(
            f"the scenarios of {found.tried} runs were loaded; all others differ from these in drawn values, or"
        )
        notes[-1] += " in combinations of values that were each loaded"
    return notes


def _print_problems(found: Inspection) -> None:
    for finding in found.findings:
        print(finding, file=sys.stderr)
    if found.unlisted:
        print(f"and {found.unlisted} more", file=sys.stderr)
    count = len(found.findings) + found.unlisted
    print(f"{found.path}: {count} problem{'s' if count != 1 else ''}", file=sys.stderr)


def _print_summary(report: dict[str, Any]) -> None:
    print(f"{report['file']}: OK: {report['name']}{': ' + report['title'] if report['title'] else ''}")
    runs = report["runs"]
    words = (
        f"{runs} runs" if runs is not None else f"{report['points']} points; the strategy {report['strategy']} decides"
    )
    print(f"  campaign, {words}; the scenarios of {report['tried']} were loaded")
    for axis in report["axes"]:
        unit = f" [{axis['unit']}]" if axis["unit"] else ""
        shown = ", ".join(axis["labels"][:8]) + (f", ... ({len(axis['labels'])})" if len(axis["labels"]) > 8 else "")
        print(f"  {axis['name'] + unit:<20} {axis['kind']:<16} {axis['key'] or '-'}{': ' + shown if shown else ''}")
    if report["metrics"]:
        print(f"  metrics: {', '.join(report['metrics'])}")
    for note in report["notes"]:
        print(f"  note: {note}")
