"""Topics of the flight software: the log and a bench in Python show the same, field by field."""

from __future__ import annotations

import numpy as np
import pytest

from fsw.records import WheelHealth
from fsw.telemetry import CONTROL_TOPICS, TICK_TOPICS, Topic
from tools.run.bench import Bench
from tools.run.bench_signals import list_topics, list_values

TOPICS = [topic for topic in (*TICK_TOPICS, *CONTROL_TOPICS) if topic.deterministic]


@pytest.fixture(scope="module")
def bench() -> Bench:
    """A bench after 3 s of the published scenario, in which no value is what it was at the start."""
    return Bench.open("zhang2018", log="memory").step(30)


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_bench_reads_what_the_log_holds(topic: Topic, bench: Bench) -> None:
    """Every field of a topic reads on the bench as its last record in the log: a value under a neighbour's name is seen."""
    logged = bench.log.signals(topic.name)
    for field in topic.fields:
        value = bench.read(f"{topic.name.strip('/').replace('/', '.')}.{field.name}")
        assert np.array_equal(np.atleast_1d(value), np.atleast_1d(logged[field.name][-1])), field.name


def test_fields_hold_what_they_are_named_for(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """One field of each topic against where it comes from: a whole table shifted by a field would pass the test above."""
    flight, truth = bench.flight, bench.truth
    assert bench.read("fsw.attitude.q_it") == (1.0, 0.0, 0.0, 0.0)
    assert bench.read("fsw.attitude.q_ib_hat") == pytest.approx(truth.q_ib, abs=2e-3)  # a tick old, at 0.6 deg/s
    assert bench.read("fsw.guidance.omega_ti_t_rad_s") == (0.0, 0.0, 0.0)
    assert bench.read("fsw.control.tau_rw_cmd_nm") == pytest.approx(truth.tau_rw_cmd_nm, abs=1e-12)
    assert bench.read("fsw.observer.tau_fault_hat_b_nm") == flight.tau_fault_hat_b_nm != (0.0, 0.0, 0.0)
    health = WheelHealth((0.9, 0.8, 0.7, 0.6), (True, True, False, True), (False, True, False, False), (0.1, 0.2, 0.3))
    monkeypatch.setattr(flight, "health", health)
    assert bench.read("fsw.fdi.wheel_alarm") == health.alarm
    assert bench.read("fsw.wheel_health.effectiveness") == health.effectiveness
    assert bench.read("fsw.wheel_health.available") == health.available
    assert bench.read("fsw.wheel_health.explained_b_nm") == health.explained_b_nm
    assert (bench.read("fsw.executive.tick"), bench.read("fsw.executive.mode")) == (29, 2)
    assert bench.read("fsw.executive.torques_saturated") == 0


def test_every_listed_topic_can_be_read(bench: Bench) -> None:
    """What the refusal of an unknown topic offers is there, but for algorithms that have nothing to show."""
    names = list_topics(bench.flight)
    assert {topic.name.strip("/").replace("/", ".") for topic in TOPICS} < set(names)
    empty = {name for name in names if not list_values(name, bench.truth, bench.flight)}
    assert empty <= {
        "fsw.detector",
        "fsw.estimator",
        "fsw.wheel_state",
        "fsw.allocator",
        "fsw.null_space",
        "fsw.wheel_power",
    }
