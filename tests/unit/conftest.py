"""Directories of campaigns that nobody flew: results with a structure that is known beforehand."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from tools.campaign.plan import derive_seed
from tools.campaign.results import (
    FOUND_FILE,
    INFO_FILE,
    RESULTS_FILE,
    TIMINGS_FILE,
    AxisInfo,
    CampaignInfo,
    Judged,
    RunResult,
    Timing,
    to_line,
)

LAWS, UNITS = ("smc", "pid"), ("wheel.1", "wheel.2", "gyro.z")
METRICS = {"effort": "N m s", "peak": "N m", "settled": "s", "energy": "J", "steady": "deg", "noise": ""}
MakeResults = Callable[..., Path]
Edit = Callable[[RunResult], RunResult | None]


@pytest.fixture
def make_results(tmp_path: Path) -> MakeResults:
    """Writes the directory of a campaign: laws x units in turn, onset and effectiveness drawn."""
    return lambda name="c", runs=60, seed=1, **keys: write_results(tmp_path / name, runs, seed, **keys)


def write_results(
    directory: Path,
    runs: int,
    seed: int = 1,
    edit: Edit = lambda result: result,
    found: Any = None,
    planned: int | None = None,
) -> Path:
    """`edit` changes a result, or leaves it out by None."""
    directory.mkdir()
    results = [changed for number in range(runs) if (changed := edit(make_result(number, seed))) is not None]
    (directory / RESULTS_FILE).write_text("".join(map(to_line, results)), encoding="utf-8")
    timings = (Timing(number=r.number, wall_s=0.5, cpu_s=0.25, ticks=100, worker=f"w{r.number % 2}") for r in results)
    (directory / TIMINGS_FILE).write_text("".join(map(to_line, timings)), encoding="utf-8")
    (directory / INFO_FILE).write_text(json.dumps(asdict(make_info(seed, planned or runs))), encoding="utf-8")
    if found is not None:
        (directory / FOUND_FILE).write_text(json.dumps(found), encoding="utf-8")
    return directory


def make_info(seed: int, runs: int) -> CampaignInfo:
    """What was asked."""
    return CampaignInfo(
        name="wheels",
        title="Wheels that lose torque <and a gyro & more>",
        seed=seed,
        file="name: wheels\naxes:\n  law: [smc, pid]   # a comment with <markup>\n",
        bases=("zhang2018-flight",),
        axes=(
            AxisInfo(name="law", kind="values", key="fsw.controller.kind", labels=LAWS),
            AxisInfo(name="unit", kind="values", labels=UNITS),
            AxisInfo(name="onset_s", kind="uniform", unit="s"),
            AxisInfo(name="effectiveness", kind="uniform"),
        ),
        runs=runs,
        strategy="plan",
        metrics=METRICS,
        provenance={"version": "0.1.0", "commit": "abc1234", "python": "3.11"},
    )


def make_result(number: int, campaign_seed: int) -> RunResult:
    """One run. It passes where 8 * (1 - effectiveness) + noise of 0.4 is below 5, for pid below 3."""
    seed = derive_seed(campaign_seed, number)
    rng = random.Random(seed)
    law, unit = LAWS[number % 2], UNITS[number // 2 % 3]
    onset_s, effectiveness = round(rng.uniform(20.0, 60.0), 6), round(rng.random(), 6)
    error = 8.0 * (1.0 - effectiveness) + rng.gauss(0.0, 0.4)
    bound = 5.0 if law == "smc" else 3.0
    settled = onset_s + 10.0 * (1.0 - effectiveness)
    verdicts = [
        _judge("R-1", "points well", error, bound - error, f"<= {bound:g} deg", "deg"),
        _judge("R-2", "settles", settled, 90.0 - settled, "within 1 deg for good: <= 90 s", "s"),
        *(_judge("", f"figure {i} stays", x := rng.random(), x + 1.0, ">= -1 N m", "N m") for i in range(5)),
        Judged(name=f"fault took effect: {unit} loss", outcome="pass", value=onset_s, margin=None, bound=f"at {onset_s} s"),
    ]  # fmt: skip
    fault = json.dumps([{"unit": unit, "kind": "loss", "effectiveness": effectiveness, "at_s": onset_s}])
    return RunResult(
        number=number,
        values={"law": law, "unit": unit, "onset_s": onset_s, "effectiveness": effectiveness},
        labels={"law": law, "unit": unit, "onset_s": f"{onset_s:.4g}", "effectiveness": f"{effectiveness:.3g}"},
        repeat=0,
        base="zhang2018-flight",
        overrides=(f"fsw.controller.kind={law}", f"faults={fault}"),
        seed=seed,
        outcome="pass" if error <= bound else "fail",
        verdicts=tuple(verdicts),
        metrics={
            "effort": 2.0 * error, "peak": error * error, "settled": settled,
            "energy": rng.random(), "steady": error / 10.0, "noise": rng.random(),
        },
        digest=f"{seed:064x}",
    )  # fmt: skip


def _judge(own_id: str, name: str, value: float, margin: float, bound: str, unit: str) -> Judged:
    outcome = "pass" if margin >= 0.0 else "fail"
    return Judged(name=name, outcome=outcome, value=value, margin=margin, id=own_id, bound=bound, unit=unit)
