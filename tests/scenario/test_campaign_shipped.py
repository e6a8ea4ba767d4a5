"""Campaigns that ship, flown."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.campaign.results import read_results, read_timings
from tools.cli import main

pytestmark = pytest.mark.slow


def test_mixed_100_passes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The campaign for machines that build passes whole, with every base, law and fault as often as the others."""
    out = tmp_path / "mixed"
    assert main(["campaign", "mixed-100", "-j", "2", "-q", "--out", str(out)]) == 0
    results = read_results(out)
    assert [result.outcome for result in results] == ["pass"] * 100
    assert len(read_timings(out)) == 100
    for axis, times in (("base", {20}), ("law", {25}), ("fault", {15, 16, 17, 18})):
        labels = [result.labels[axis] for result in results]
        assert {labels.count(label) for label in labels} <= times
    # one of them alone, from the file and from its results: the same bytes
    words = ["--clock", "inprocess", "--no-plot", "-q"]
    assert main(["run", "mixed-100#42", *words, "--out", str(tmp_path / "a")]) == 0
    assert main(["run", f"{out}#42", *words, "--out", str(tmp_path / "b")]) == 0
    logs = [str(next((tmp_path / name).glob("*.mcap"))) for name in ("a", "b")]
    capsys.readouterr()
    assert main(["diff", *logs]) == 0
    assert "the same" in capsys.readouterr().out
