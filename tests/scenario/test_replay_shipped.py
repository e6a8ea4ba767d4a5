"""Every scenario that ships, flown again from its log: not one bit differs, on any clock, with deadlines missed and met."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tools.config.scenario_files import find_scenario, list_shipped
from tools.log.mcap_reader import read_run
from tools.run.bench import Bench
from tools.verbs.replay import replay

LOSSES = "[{unit: bus, kind: loss, probability: 0.2, at_s: 2}]"
SCENARIOS = list_shipped()
LEAST_S, BEHIND_ONSET_S, MOST_TICKS = 12.0, 3.0, 2500


def count_ticks(bench: Bench) -> int:
    """As many as show the first fault or the first command of the ground at work, within reason."""
    scenario = bench.resolved.scenario
    moments = [fault.at_s for fault in scenario.faults] + [entry.at_s for entry in scenario.fsw.timeline]
    until_s = max(LEAST_S, min(moments, default=0.0) + BEHIND_ONSET_S)
    return min(bench.ticks, MOST_TICKS, round(until_s / bench.tick_s))


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_shipped_scenario_is_repeated_to_the_bit(name: str, tmp_path: Path) -> None:
    """Its first seconds, and where they are not far off the first fault or command: every cycle, and no frame unheard."""
    log = tmp_path / "run.mcap"
    with Bench.open(find_scenario(name), ["expect=[]"], log=log) as bench:
        ticks = count_ticks(bench)
        bench.step(ticks)
        bench.close("enough")
    outcome = replay(log)
    assert (outcome.first, outcome.differing_ticks, outcome.unheard) == (None, 0, 0)
    assert outcome.ticks == ticks


def run_words(*words: str) -> list[str]:
    """The command line of a run without a grade, a picture and words."""
    return [sys.executable, "-P", "-m", "tools.cli", "run", *words, "--set", "expect=[]", "--no-plot", "-q"]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "faults"), [("zhang2018", LOSSES), ("ithaco-gain-fault", None)])
def test_a_run_in_lock_step_is_repeated_to_the_bit(name: str, faults: str | None, tmp_path: Path) -> None:
    """Two processes and a bus between them, with lost frames on it: what was received is all that counts."""
    out = tmp_path / "run"
    words = ["--clock", "lockstep", *(["--set", f"faults={faults}"] if faults else [])]
    done = subprocess.run([*run_words(name, *words), "--duration", "10", "--out", str(out)], check=False)
    assert done.returncode in (0, 1)
    outcome = replay(out / "run.mcap")
    assert (outcome.first, outcome.differing_ticks) == (None, 0)
    assert outcome.ticks == 100


def find_flight_software(parent: int) -> int:
    """Process id of the flight software of a run, once it flies."""
    until = time.monotonic() + 30
    while time.monotonic() < until:
        for entry in Path("/proc").glob("[0-9]*"):
            try:
                words = (entry / "cmdline").read_bytes().split(b"\0")
                mother = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            except (OSError, IndexError):
                continue
            if mother == parent and b"fsw" in words:
                return int(entry.name)
        time.sleep(0.05)
    raise AssertionError("the flight software does not run")


def await_cycles(log: Path, count: int) -> None:
    """Wait until a log that is being written has so many cycles of the flight software."""
    until = time.monotonic() + 30
    while time.monotonic() < until:
        if log.exists() and (run := read_run(log)).has("/fsw/input") and run.count("/fsw/input") >= count:
            return
        time.sleep(0.1)
    raise AssertionError("no cycle is logged")


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["skip", "catch_up", "degrade", "safe"])
def test_a_run_in_real_time_that_missed_deadlines_is_repeated_to_the_bit(policy: str, tmp_path: Path) -> None:
    """The flight software is held for 0.45 s, four of its periods: whatever it then leaves out, it leaves out again."""
    out = tmp_path / "run"
    log = out / "run.mcap"
    words = ["zhang2018", "--clock", "realtime", "--set", "faults=[]", "--set", f"fsw.executive.overrun={policy}"]
    with subprocess.Popen([*run_words(*words), "--duration", "5", "--out", str(out)]) as run:
        try:
            pid = find_flight_software(run.pid)
            await_cycles(log, 10)
            os.kill(pid, signal.SIGSTOP)
            time.sleep(0.45)
            os.kill(pid, signal.SIGCONT)
            assert run.wait(60) in (0, 1)
        finally:
            run.kill()
    executive = read_run(log).signals("/fsw/executive")
    assert executive["slips"][-1] >= 1
    assert max(executive[{"catch_up": "caught_up", "degrade": "shed"}.get(policy, "skipped")]) >= 3
    outcome = replay(log)
    assert (outcome.first, outcome.differing_ticks) == (None, 0)
    assert outcome.ticks == len(executive["tick"])


@pytest.mark.slow
def test_the_real_time_scenario_is_repeated_to_the_bit(tmp_path: Path) -> None:
    """100 Hz on the wall clock of a machine that is as loaded as it is."""
    out = tmp_path / "run"
    done = subprocess.run(
        [*run_words("realtime-60s", "--set", "faults=[]"), "--duration", "5", "--out", str(out)], check=False
    )
    assert done.returncode in (0, 1)
    outcome = replay(out / "run.mcap")
    assert (outcome.first, outcome.differing_ticks) == (None, 0)
    assert outcome.ticks > 300
