"""Runs over a bus that fails: the same bytes on every clock, replayed without a difference, and what they end in."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tools.config.loader import load_scenario
from tools.config.scenario_files import find_scenario
from tools.grading.grade import grade_run
from tools.log.mcap_reader import read_run
from tools.replay.compare import compare_replay
from tools.replay.flight_again import FlightAgain
from tools.run.bench import Bench

WRONG = [
    {"kind": "loss", "probability": 0.2}, {"kind": "jitter", "jitter_s": 0.03}, {"kind": "duplicate", "probability": 0.3},
    {"kind": "bit_errors", "probability": 0.1}, {"kind": "bus_off", "node": "fsw"}, {"kind": "bus_off", "node": "wheel.2"},
    {"kind": "babble", "rate_hz": 4000}, {"kind": "masquerade"}, {"kind": "masquerade", "node": "gyro", "can_id": 0x110},
    {"kind": "dominant"}, {"kind": "reorder"}, {"kind": "wrong_dlc", "node": "gyro"},
]  # fmt: skip


def fly(out: Path, *words: str, scenario: str) -> None:
    command = [sys.executable, "-P", "-m", "tools.cli", "run", scenario, "--out", str(out), "--no-plot", "--json", "-q"]
    done = subprocess.run(
        [*command, *words], capture_output=True, text=True, timeout=300, env=dict(os.environ), check=False
    )
    assert done.stdout, done.stderr
    assert json.loads(done.stdout)["run"]["exit_code"] == 0, done.stderr


def replay(bench: Bench) -> Any:
    scenario = bench.resolved.scenario
    again = FlightAgain(scenario.fsw, bench.tick_ns, bench.resolved.run_hash)
    return compare_replay(bench.log, again, bench.tick_ns)


@pytest.mark.parametrize("timing", ["none", "real"])
@pytest.mark.parametrize("fault", WRONG, ids=lambda fault: f"{fault['kind']}-{fault.get('node', '')}")
def test_a_replay_of_a_run_over_a_bad_bus_has_no_difference(fault: dict[str, Any], timing: str) -> None:
    """What the flight software got to see is what is in its log, and what it sent is in the plant's: cycle by cycle."""
    with Bench.open("zhang2018-flight", ["faults=[]", f"bus.timing={timing}"], log="memory") as bench:
        bench.inject(at_tick=30, unit="bus", until_s=0.9, **fault)
        bench.step(130)
        outcome = replay(bench)
    assert outcome.same, outcome.first and outcome.first.describe()
    assert (outcome.ticks, outcome.unheard) == (130, 0)


def test_a_fault_that_is_cleared_leaves_a_sound_bus() -> None:
    """Commands add and clear: effect and cleared are announced, and after that nothing is lost any more."""
    with Bench.open("zhang2018-flight", ["faults=[]"], log="memory") as bench:
        bench.inject(at_tick=20, unit="bus", kind="loss", probability=0.5, id="wet")
        bench.clear(at_tick=60, id="wet")
        bench.step(120)
        run = bench.log
        phases = [(fault["id"], fault["phase"], fault["tick"]) for fault in run.faults]
        assert phases == [("wet", "onset", 20), ("wet", "effect", 20), ("wet", "cleared", 60)]
        ticks, lost = run.ticks("/plant/bus"), run.signals("/plant/bus")["lost_loss"].sum(axis=1)
    assert ticks[0] == 20
    assert lost[ticks == 59] == lost[-1] > 0


def test_a_run_with_a_masquerade_is_not_failed_for_its_second_sender() -> None:
    """It was asked for; without the fault in the scenario it is a failure as before."""
    fault = {"unit": "bus", "kind": "masquerade", "at_s": 0.2}
    words = ["duration_s=2", "expect=[]", "faults=" + json.dumps([fault])]
    with Bench.open("zhang2018-flight", words, log="memory") as bench:
        bench.step(200)
        grade = grade_run(bench.log, bench.resolved)
    assert grade.outcome == "pass", grade.verdicts
    assert bench.flight.inputs.count_rivals() > 100


@pytest.mark.slow
@pytest.mark.parametrize("timing", ["none", "real"])
def test_in_process_and_lock_step_give_the_same_bytes_over_a_bad_bus(tmp_path: Path, timing: str) -> None:
    """Two processes over the embedded bus log exactly what one process logs, error frames and the wire included."""
    faults = [
        {"unit": "bus", "at_s": 0.2 + 0.1 * i, "until_s": 1.5 + 0.1 * i, **fault} for i, fault in enumerate(WRONG)
    ]
    words = [f"bus.timing={timing}", "duration_s=5", "expect=[]", "faults=" + json.dumps(faults)]
    for clock in ("inprocess", "lockstep"):
        sets = [word for item in words for word in ("--set", item)]
        fly(tmp_path / clock, "--clock", clock, *sets, scenario="zhang2018-flight")
    one, two = (read_run(tmp_path / clock / "run.mcap") for clock in ("inprocess", "lockstep"))
    assert one.frames().tobytes() == two.frames().tobytes()
    assert one.digest() == two.digest()


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["bus-loss", "bus-off"])
def test_the_shipped_scenarios_pass_in_process_and_in_lock_step(tmp_path: Path, scenario: str) -> None:
    """Every expectation holds, and both clocks log the same bytes."""
    digests = []
    for clock in ("inprocess", "lockstep"):
        fly(tmp_path / clock, "--clock", clock, scenario=scenario)
        run = read_run(tmp_path / clock / "run.mcap")
        resolved = load_scenario(find_scenario(scenario), [f"clock.mode={clock}"])
        assert grade_run(run, resolved).outcome == "pass"
        digests.append(run.digest())
    assert digests[0] == digests[1]
