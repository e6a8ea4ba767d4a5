"""Campaigns that are flown for what they are to find, with the answer known beforehand."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tools.campaign.results import read_results
from tools.cli import main

CAMPAIGN = """
name: spin
base: nominal
seed: 3
set:
  duration_s: 0.5
  faults: []
  plant.body.rate_deg_s: [$spin, 0, 0]
  expect:
    - {id: S-1, name: slow, check: below, signal: deg(norm(truth.attitude.omega_bi_b_rad_s)), bound: 1.7, until_s: 0.02}
axes:
  spin: {uniform: [0.1, 3], unit: deg/s}
samples: 2
strategy: STRATEGY
"""


def fly(tmp_path: Path, strategy: str) -> Path:
    """The directory of a campaign that was flown."""
    file = tmp_path / "spin.yaml"
    file.write_text(CAMPAIGN.replace("STRATEGY", strategy))
    directory = tmp_path / "spin"
    assert main(["campaign", str(file), "--out", str(directory), "-q", "-j", "1"]) in (0, 1)
    return directory


def test_a_boundary_is_found_where_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The body starts with the rate it is given: a bound of 1.7 deg/s begins to fail at a spin of 1.7, and is bracketed."""
    strategy = "{kind: boundary, axis: spin, lower: 0.5, upper: 3, tolerance: 0.1, repeats: 1, requirement: S-1}"
    directory = fly(tmp_path, strategy)
    (item,) = json.loads((directory / "found.json").read_text())["boundaries"]
    (change,) = item["changes"]
    assert change["lower"] <= 1.7 + 0.01
    assert change["upper"] >= 1.7 - 0.01
    assert change["upper"] - change["lower"] <= 0.1
    assert len(read_results(directory)) == len(item["levels"])
    capsys.readouterr()
    assert main(["campaign", "show", str(directory)]) == 0
    assert "S-1 along spin: pass at" in capsys.readouterr().out
    assert main(["campaign", "report", str(directory)]) == 0
    assert main(["campaign", "diff", str(directory), str(directory)]) == 0


@pytest.mark.slow
def test_the_worst_start_is_the_fastest(tmp_path: Path) -> None:
    """The margin falls with the spin: the search ends at the end of its range, and asks the same when it is flown again."""
    directory = fly(tmp_path, "{kind: worst, requirement: S-1, generations: 6, population: 6}")
    worst = json.loads((directory / "found.json").read_text())["worst"]
    assert worst["values"]["spin"] > 2.8
    (tmp_path / "again").mkdir()
    again = fly(tmp_path / "again", "{kind: worst, requirement: S-1, generations: 6, population: 6}")
    assert (again / "results.jsonl").read_bytes() == (directory / "results.jsonl").read_bytes()
