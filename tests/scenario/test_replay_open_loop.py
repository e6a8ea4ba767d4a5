"""`hilsat replay --set`: other settings on recorded inputs, held against runs that were really flown with them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tools.cli import main
from tools.log.mcap_reader import read_run
from tools.run.bench import Bench
from tools.verbs.replay import replay_open_loop

BASE = ["expect=[]", "faults=[]"]


def fly(path: Path, *overrides: str) -> Path:
    with Bench.open("zhang2018", [*BASE, *overrides], log=path) as bench:
        bench.run_to_end()
    return path


def test_the_same_settings_differ_in_nothing(tmp_path: Path) -> None:
    """Settings that are those of the run give no difference in any signal, and every cycle was compared."""
    log = fly(tmp_path / "a.mcap", "duration_s=20")
    outcome = replay_open_loop(log, ["fsw.controller.k1=5.6"])
    assert outcome.same
    assert (outcome.ticks, outcome.changes) == (200, [])
    assert outcome.signals > 20


def test_it_says_what_a_run_with_these_settings_says(tmp_path: Path) -> None:
    """Up to the first torque the inputs of both runs are the same: there the open loop must say what the other run said."""
    log = fly(tmp_path / "a.mcap", "duration_s=0.2")
    other = read_run(fly(tmp_path / "b.mcap", "duration_s=0.2", "fsw.controller.mu=3"))
    outcome = replay_open_loop(log, ["fsw.controller.mu=3"])
    change = next(change for change in outcome.changes if change.signal == "fsw.control.tau_cmd_b_nm")
    here, there = (run.signals("/fsw/control")["tau_cmd_b_nm"][1] for run in (read_run(log), other))
    most = int(np.argmax(np.abs(there - here)))
    assert (change.recorded, change.replayed) == (here[most], there[most])
    assert change.largest == pytest.approx(abs(there - here)[most])
    assert (change.differing, change.samples, change.first_s) == (1, 2, 0.1)


def test_what_only_one_side_has_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Another allocator has a topic of its own: named, and no pass; keys outside of fsw are refused."""
    log = fly(tmp_path / "a.mcap", "duration_s=5")
    assert main(["replay", "--json", str(log), "--set", "fsw.allocator={kind: direct}"]) == 1
    assert json.loads(capsys.readouterr().out)["only_replayed"] == ["fsw/allocator"]
    assert main(["replay", str(log), "--set", "plant.step_s=0.01"]) == 2
    assert main(["replay", str(log), "--set", "fsw.controler.k1=1"]) == 2
    assert "did you mean" in capsys.readouterr().err
