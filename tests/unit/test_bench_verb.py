"""What `hilsat bench` measures of our own code is there, and means what it says. No test asserts a figure of a machine."""

from __future__ import annotations

import json
import math
import shutil
from functools import partial
from typing import Any

import pytest

from fsw import allocators, controllers, estimation, gyro_fdi, observers, wheel_health
from fsw.wheel_health.settings import WheelKalmanConfig
from tools.cli import main
from tools.measure import algorithms, instructions, set_up
from tools.measure.instructions import count_instructions
from tools.measure.other_build import set_beside
from tools.verbs import bench

ZHANG = bench.SCENARIOS["zhang2018"]


def test_set_up_is_told_for_every_scenario(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """In JSON and in the table, with nothing else measured."""
    monkeypatch.setattr(set_up, "ROUNDS", 2)
    assert main(["bench", "--only", "set-up", "--json"]) == 0
    table = json.loads(capsys.readouterr().out)
    assert table.keys() - {"build", "cpus", "python"} == {"set-up"}
    assert table["set-up"].keys() == bench.SCENARIOS.keys()
    for figures in table["set-up"].values():
        assert 0 < figures["close alone, cpu-ms, median"] < figures["set-up and close, cpu-ms, median"]
        assert figures["set-up and close, cpu-ms, best"] <= figures["set-up and close, cpu-ms, median"]
        assert figures["reading with another seed, cpu-ms, median"] > 0
    assert main(["bench", "--only", "set-up"]) == 0
    assert "set-up and close, cpu-ms, median" in capsys.readouterr().out


def test_set_up_is_that_of_a_warm_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first flight fills what is kept and does not count; each of the others has a seed of its own."""
    seeds: list[int] = []

    def fly(name: str, settings: Any, seed: int) -> tuple[float, float, float]:
        seeds.append(seed)
        return (9e9, 9e9, 9e9) if len(seeds) == 1 else (1.0, 2.0, float(seed))

    monkeypatch.setattr(set_up, "_fly", fly)
    monkeypatch.setattr(set_up, "ROUNDS", 3)
    assert list(set_up.measure_set_up("any", []).values()) == [4.0, 3.0, 2.0, 1.0]
    assert len(set(seeds)) == len(seeds) == 4


def test_every_registered_algorithm_is_measured(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One finite positive figure for each kind of each family, and no other."""
    monkeypatch.setattr(algorithms, "measure_algorithms", partial(algorithms.measure_algorithms, 20, 3))
    assert main(["bench", "--only", "algorithms", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)["algorithms"]
    families = (estimation, gyro_fdi, observers, wheel_health, controllers, allocators)
    names = [
        f"{family.__name__.removeprefix('fsw.')} {kind}, us" for family in families for kind in family.REGISTRY.kinds
    ]
    assert list(figures) == names
    assert all(math.isfinite(figure) and figure > 0.0 for figure in figures.values())


def test_algorithms_are_driven_as_a_flight_drives_them() -> None:
    """Sound wheels in a recorded hold raise no alarm, and the recording stays as it was when the flight goes on."""
    hold = algorithms.record("ithaco-hold", (), 150)
    monitor = wheel_health.REGISTRY.make(WheelKalmanConfig(kind="wheel_kalman"), hold.vehicle, algorithms.PERIOD_S)
    for moment in hold.moments:
        health = algorithms.FAMILIES["wheel_health"].step(monitor, moment)
        assert not any(health.alarm)
    assert [moment.sensors.tick for moment in hold.moments] == list(range(150))
    assert len({moment.sensors.wheels[0].speed_rad_s for moment in hold.moments}) > 100


def test_what_takes_minutes_is_measured_only_when_asked_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Instructions and the ground link take minutes: the default leaves them out."""
    monkeypatch.setattr(bench, "MEASUREMENTS", {name: lambda seconds: {"x": 1.0} for name in bench.MEASUREMENTS})
    assert main(["bench", "--json"]) == 0
    default = json.loads(capsys.readouterr().out).keys() - {"build", "cpus", "python"}
    assert default == bench.MEASUREMENTS.keys() - {"campaign", "ground", "instructions"}
    assert main(["bench", "--json", "--only", "instructions"]) == 0
    assert json.loads(capsys.readouterr().out).keys() - {"build", "cpus", "python"} == {"instructions"}


def test_without_valgrind_a_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    assert list(count_instructions("zhang2018", ZHANG)) == ["not measured"]


def test_the_difference_of_two_counts_is_what_a_tick_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Start-up, the same in both children, is not in it."""
    flown: list[int] = []

    def run_child(counter: list[str], name: str, settings: Any, ticks: int) -> None:
        flown.append(ticks)
        if counter:
            said = counter[-1].removeprefix("--log-file=")
            with open(said, "w") as file:
                file.write(f"==1== \n==1== I refs:        {7_000_000 + 1_234 * ticks:,}\n")

    monkeypatch.setattr(shutil, "which", lambda name: name)
    monkeypatch.setattr(instructions, "_run_child", run_child)
    assert count_instructions("any", [], 50) == {"instructions per tick": 1234, "ticks": 50}
    assert flown == [1, 50, 100]


def test_a_child_that_fails_is_told_with_its_last_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: name)
    words = count_instructions("zhang2018", ["no.such.key=1"], 1)
    assert list(words) == ["failed"]
    assert "no.such.key" in words["failed"] or "not a known key" in words["failed"]


def test_a_valgrind_that_does_not_count_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: name)
    monkeypatch.setattr(instructions, "_run_child", lambda *words: None)
    assert count_instructions("any", [], 1) == {"failed": "valgrind gave no count of instructions"}


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("valgrind") is None, reason="valgrind is not there: sudo apt-get install valgrind")
def test_valgrind_counts_a_tick() -> None:
    """More than a thousand bytecodes' worth and less than a start-up: start-up has gone out of the difference."""
    result = count_instructions("zhang2018", ZHANG, 20)
    assert 50_000 < result["instructions per tick"] < 5_000_000, result


def test_two_builds_stand_side_by_side() -> None:
    """Figure by figure with their ratio, group by group; what only one has, or is no number, as it is."""
    compiled = {"zhang2018": {"speed": 300.0, "note": "x"}, "only here": 1.0}
    plain = {"zhang2018": {"speed": 100.0, "note": "y"}}
    assert set_beside(compiled, plain) == {
        "zhang2018": {"speed": {"compiled": 300.0, "plain": 100.0, "compiled / plain": 3.0}, "note": "x"},
        "only here": 1.0,
    }
