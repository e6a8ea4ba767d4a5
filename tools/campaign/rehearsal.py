"""What a campaign would fly, and how long that would take: one run is flown to know."""

from __future__ import annotations

import json
from typing import Any, Final

from tools.campaign.fly import fly
from tools.campaign.job import Job
from tools.campaign.progress import format_time

SHOWN: Final = 40  # runs of a table for people


def print_plan(campaign: Any, job: Job, jobs: int, *, as_json: bool) -> int:
    """Print the runs of the plan, their number and the time they will take; return the exit code."""
    plans = [campaign.plan(number, point) for number, point in enumerate(campaign.points())]
    flown = fly(job, plans[0]) if plans else None
    if flown is not None and flown.result.outcome == "infra":
        job.resolve(plans[0])  # raises in full what is wrong with it
    each_s = flown.timing.wall_s if flown is not None else 0.0
    total_s = each_s * len(plans) / jobs
    if as_json:
        runs = [
            {"number": plan.number, "base": plan.base, "labels": dict(plan.point.labels), "values": dict(plan.point.values),
             "repeat": plan.point.repeat, "seed": plan.seed, "overrides": list(plan.overrides)}
            for plan in plans
        ]  # fmt: skip
        print(json.dumps({"runs": runs, "count": campaign.runs, "each_s": each_s, "total_s": total_s}, allow_nan=False))
        return 0
    for line in _format_table(plans):
        print(line)
    count = (
        f"{len(plans)} runs" if campaign.runs is not None else f"{len(plans)} runs in the plan; the strategy decides"
    )
    print(f"{count}, {each_s:.2g} s each: about {format_time(total_s)} with -j {jobs}")
    return 0


def _format_table(plans: list[Any]) -> list[str]:
    """The first runs as a table, and how many more there are."""
    names = list(dict.fromkeys(name for plan in plans for name in plan.point.labels))
    rows = [["run", "base", *names, "repeat", "seed"]]
    rows += [
        [str(plan.number), plan.base, *(str(plan.point.labels.get(name, "")) for name in names), str(plan.point.repeat),
         str(plan.seed)]
        for plan in plans[:SHOWN]
    ]  # fmt: skip
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return lines + ([f"... and {len(plans) - SHOWN} more"] if len(plans) > SHOWN else [])
