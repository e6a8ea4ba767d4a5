"""A run that is kept in memory is judged as its log is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bus.errors import ConfigError
from fsw.telemetry import SOURCE as FSW_SOURCE
from plant_server.truth import SOURCE as PLANT_SOURCE
from tools.campaign.fly import keep_run, list_wanted
from tools.campaign.job import Job
from tools.campaign.kept_run import Keeper
from tools.config.loader import load_scenario
from tools.config.scenario import Resolved
from tools.config.scenario_files import find_scenario, list_shipped
from tools.grading.grade import grade_run
from tools.log.mcap_reader import Run
from tools.run.bench import Bench

NO_JOB = Job(name="", bases={})
DURATION_S = 3.0
FAULT = "[{id: early, unit: wheel.2, kind: loss, effectiveness: 0.5, at_s: 1}]"
# of every sort of check and signal: across topics, slower topics, vectors, rates, after a fault, and one that is not there
EXPECT = """[
 {name: a, check: below, signal: truth.attitude.error_deg, bound: 3, unit: deg, from_s: 1},
 {name: b, check: settles, signal: norm(truth.attitude.omega_bi_b_rad_s), bound: 0.001, unit: rad/s, by_s: 2},
 {name: c, check: rms_below, signal: norm(fsw.observer.tau_fault_hat_b_nm - truth.wheels.tau_fault_b_nm), bound: 0.1},
 {name: d, check: above, signal: fsw.control.margin, bound: 0, after: "event fault onset"},
 {name: e, check: below, signal: abs(rate(fsw.attitude.error_deg)), bound: 1},
 {name: f, check: within, signal: "fsw.wheel_health.kind[0]", lower: 0, upper: 9, until_s: 2},
 {name: g, check: below, signal: plant.channel.accepted, bound: 10},
 {name: h, check: event_count, event: fault, at_most: 2},
 {name: i, check: count, signal: truth.attitude.error_deg, bound: 9, of: samples, at_most: 2, when: fsw.executive.mode > 0},
 {name: j, check: no_false_alarm, signal: max(fsw.fdi.wheel_alarm), bound: 0.5},
 {name: k, check: percentile, signal: fsw.attitude.error_deg, share: 50, bound: 1.0e+9, until: "event fault onset"}]"""


def load_short(name: str) -> Resolved:
    """A shipped scenario cut short; with its faults where those come early, else with one that does."""
    words = [
        f"duration_s={DURATION_S}",
        "clock.mode=inprocess",
        "fsw.timeline=[]",
        f"expect={EXPECT}",
        "requirements=[]",
    ]
    try:
        return load_scenario(find_scenario(name), words)
    except ConfigError:
        return load_scenario(find_scenario(name), [*words, f"faults={FAULT}"])


def list_signals(resolved: Resolved) -> list[tuple[str, str]]:
    return list_wanted(NO_JOB, resolved, ())


def log_run(resolved: Resolved) -> Run:
    with Bench(resolved, log="memory") as bench:
        bench.run_to_end()
        return bench.log


@pytest.mark.parametrize("name", ["zhang2018", "zhang2018-flight", "bus-off", "gyro-dead", "ithaco-hold"])
def test_verdicts_are_those_of_the_log(name: str) -> None:
    """Every field of every verdict equals what grading the log of the same scenario gives."""
    resolved = load_short(name)
    kept, logged = keep_run(resolved, list_signals(resolved)), log_run(resolved)
    assert grade_run(kept, resolved).as_dict() == grade_run(logged, resolved).as_dict()


@pytest.mark.slow
@pytest.mark.parametrize("name", list_shipped())
def test_verdicts_are_those_of_the_log_everywhere(name: str) -> None:
    """The same for all scenarios that ship."""
    resolved = load_short(name)
    kept, logged = keep_run(resolved, list_signals(resolved)), log_run(resolved)
    assert grade_run(kept, resolved).as_dict() == grade_run(logged, resolved).as_dict()


def test_signals_are_those_of_the_log() -> None:
    """Times, ticks and values of kept signals equal the log's to the bit; of others only the names are there."""
    resolved = load_short("zhang2018-flight")
    kept, logged = keep_run(resolved, list_signals(resolved)), log_run(resolved)
    assert kept.topics.keys() == logged.topics.keys()
    for topic, field in list_signals(resolved):
        assert np.array_equal(kept.signals(topic)[field], logged.signals(topic)[field], equal_nan=True)
        assert np.array_equal(kept.t_ns(topic), logged.t_ns(topic))
    for topic in logged.topics:
        assert kept.count(topic) == logged.count(topic)
        assert kept.topics[topic].every == logged.topics[topic].every or topic in ("/events", "/faults")
    assert kept.faults == logged.faults
    assert sorted(map(str, kept.events)) == sorted(map(str, logged.events))


def test_a_missing_tick_is_seen() -> None:
    """A record that never came is a hole in a kept run too: nothing is passed over it."""
    resolved = load_short("zhang2018")

    class Forgetful(Keeper):
        def write_ticks(self, source: int, ticks: list[int], t_ns: int, records: list[bytes]) -> None:
            if source == FSW_SOURCE and 20 in ticks:
                records[ticks.index(20)] = b""
            super().write_ticks(source, ticks, t_ns, records)

    keeper = Forgetful(list_signals(resolved))
    with Bench(resolved, keeper.link(PLANT_SOURCE), keeper.link(FSW_SOURCE)) as bench:
        bench.run_to_end()
    grade = grade_run(keeper.finish("x"), resolved)
    last = grade.verdicts[-1]
    assert (last.outcome, last.value) == ("fail", 1)
    assert next(verdict for verdict in grade.verdicts if verdict.name == "e").outcome == "not executed"


def test_no_file_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that is kept in memory leaves nothing in the working directory."""
    monkeypatch.chdir(tmp_path)
    resolved = load_short("zhang2018")
    keep_run(resolved, list_signals(resolved))
    assert list(tmp_path.iterdir()) == []
