"""`hilsat verify` tells a run that is repeated from one that is not."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tools.cli import main
from tools.run.verification import Way, list_ways, try_ways

SHORT = ["duration_s=3", "faults=[]", "expect=[]"]


def test_every_way_gives_the_same_bytes(capsys: pytest.CaptureFixture[str]) -> None:
    """A noisy scenario is repeated to the byte in every way of this machine, and what was not tried is said."""
    words = [word for override in SHORT for word in ("--set", override)]
    assert main(["verify", "zhang2018-flight", "--json", *words]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["same"] is True
    assert len({way["digest"] for way in said["ways"]}) == 1
    assert len(said["ways"]) == len(list_ways()[0]) >= 3
    assert any("real time" in words for words in said["not_tried"])


def test_a_run_that_differs_is_found_with_its_place(tmp_path: Path) -> None:
    """Another seed is another run: the first difference is named; a way that cannot be run is no pass."""
    clock = ("--clock", "inprocess")
    ways = [
        Way("one", clock),
        Way("other", (*clock, "--seed", "5")),
        Way("none", ("--clock", "lockstep", "--bus", "nonsense:")),
    ]
    one, other, none = try_ways("zhang2018-flight", SHORT, ways, tmp_path)
    assert one.same is True
    assert other.same is False
    assert other.comparison is not None
    assert other.comparison.first is not None
    assert none.same is None
    assert "nonsense" in none.trouble


def test_a_scenario_with_mistakes_is_named_before_anything_runs(capsys: pytest.CaptureFixture[str]) -> None:
    """The mistake is said once, with its place, as `hilsat run` does."""
    assert main(["verify", "zhang2018", "--set", "duration_s=-1"]) == 2
    assert capsys.readouterr().err.count("is out of range") == 1
