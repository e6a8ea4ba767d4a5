"""Which wheels give what they are told: alarms from wheel speeds, shares from the fault torque."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bus.units import Vec3, Vec4
from fsw.records import ALL_WHEELS, NO_WHEEL, FourReadings, WheelHealth, WheelReading
from fsw.settings import ModelConfig
from fsw.vehicle import Vehicle
from fsw.wheel_health.settings import ShareLearnerConfig, TorqueMonitorConfig
from fsw.wheel_health.share_learner import ShareLearner
from fsw.wheel_health.torque_monitor import TorqueMonitor

VEHICLE = Vehicle(ModelConfig(inertia_kgm2=((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))))
D0 = np.hstack([np.eye(3), np.full((3, 1), 1.0 / np.sqrt(3.0))])
TICK_S = 0.05
COMMAND = np.array([0.05, -0.05, 0.03, 0.02])
ZERO: Vec3 = (0.0, 0.0, 0.0)


def read_wheels(h: np.ndarray, valid: tuple[bool, ...] = (True,) * 4) -> FourReadings:
    a, b, c, d = (WheelReading(valid=ok, h_nms=x) for x, ok in zip(h.tolist(), valid, strict=True))
    return (a, b, c, d)


def watch(reaction: str, ticks: int = 1000, silent: range = range(0)) -> list[WheelHealth]:
    """Wheel 1 gives half its torque from tick 200 to 500; the wheels are silent on some ticks."""
    monitor = TorqueMonitor(TorqueMonitorConfig(kind="torque_monitor", reaction=reaction), VEHICLE, TICK_S)  # type: ignore[arg-type]
    h, heard, found = np.zeros(4), np.zeros(4), []
    command: Vec4 = tuple(COMMAND.tolist())  # type: ignore[assignment]
    for k in range(ticks):
        h = h - COMMAND * np.array([1.0, 0.5 if 200 <= k < 500 else 1.0, 1.0, 1.0]) * TICK_S
        heard = heard if k in silent else h
        found.append(monitor.step(TICK_S, read_wheels(heard, (k not in silent,) * 4), command, None))
    return found


def test_a_weak_wheel_is_named_and_let_go() -> None:
    """Half its torque: named once 0.01 N m are missing through a 1 s filter; released 5 s after it has healed."""
    named = np.array([health.alarm for health in watch("report")])
    assert not named[:, [0, 2, 3]].any()
    # 0.025 (1 - exp(-t)) = 0.01 at t = 0.51 s
    assert np.flatnonzero(named[:, 1])[0] * TICK_S == pytest.approx(10.0 + 0.51, abs=0.1)
    # 0.025 exp(-t) = 0.005 at t = 1.61 s, and 5 s of quiet
    assert np.flatnonzero(named[:, 1])[-1] * TICK_S == pytest.approx(25.0 + 1.61 + 5.0, abs=0.2)


def test_only_a_monitor_that_is_to_isolate_takes_wheels_out_of_use() -> None:
    """`report` leaves shares and availability alone; `isolate` switches the wheel off for good."""
    assert all(h.available == ALL_WHEELS and h.effectiveness == (1.0,) * 4 for h in watch("report"))
    isolated = watch("isolate")
    first = next(k for k, health in enumerate(isolated) if health.available != ALL_WHEELS)
    assert isolated[first].alarm == (False, True, False, False)
    for health in isolated[first:]:
        assert (health.available, health.effectiveness) == ((True, False, True, True), (1.0, 0.0, 1.0, 1.0))
    assert isolated[-1].alarm == NO_WHEEL


def test_silent_wheels_are_not_accused() -> None:
    """Speeds held while the frames are missing, and the jump when they come back, are no torque."""
    found = watch("isolate", ticks=200, silent=range(50, 90))
    assert all(health == WheelHealth() for health in found)


def test_shares_are_learnt() -> None:
    """Fed with the fault torque of known shares under rich commands, it finds each to 0.02, and explains the torque.

    One wheel is dead, one gives a third, and the observer's lag is as told.
    """
    true = np.array([0.35, 1.0, 0.75, 0.0])
    learner = ShareLearner(ShareLearnerConfig(kind="share_learner"), VEHICLE, 0.1)
    v, health = np.zeros(3), WheelHealth()
    for k in range(1500):
        tau = 0.08 * np.sin(np.array([0.03, 0.037, 0.023, 0.045]) * k + np.array([0.0, 1.0, 2.0, 3.0]))
        v += (1.0 - math.exp(-0.1 / 0.3)) * (D0 @ ((true - 1.0) * tau) - v)
        health = learner.step(0.1, read_wheels(np.zeros(4)), tuple(tau.tolist()), tuple(v.tolist()))  # type: ignore[arg-type]
    assert health.effectiveness == pytest.approx(true, abs=0.02)
    assert health.explained_b_nm == pytest.approx(v, abs=2e-3)
    assert np.linalg.norm(v) > 0.02
    assert health.available == ALL_WHEELS


def test_what_no_share_explains_is_left_to_the_law() -> None:
    """With no torque commanded a fault torque is not explained and teaches nothing."""
    learner = ShareLearner(ShareLearnerConfig(kind="share_learner"), VEHICLE, 0.1)
    for _ in range(200):
        health = learner.step(0.1, read_wheels(np.zeros(4)), (0.0, 0.0, 0.0, 0.0), (0.01, -0.02, 0.01))
    assert health.effectiveness == (1.0, 1.0, 1.0, 1.0)
    assert health.explained_b_nm == pytest.approx(ZERO, abs=0.0)


def test_without_an_observer_nothing_is_learnt_and_nothing_forgotten() -> None:
    """Outside of pointing there is no fault torque: the shares stay as they were."""
    learner = ShareLearner(ShareLearnerConfig(kind="share_learner"), VEHICLE, 0.1)
    tau: Vec4 = (0.08, 0.0, 0.0, 0.0)
    for _ in range(50):
        learnt = learner.step(0.1, read_wheels(np.zeros(4)), tau, (-0.04, 0.0, 0.0))
    assert learnt.effectiveness[0] < 0.7
    for _ in range(50):
        kept = learner.step(0.1, read_wheels(np.zeros(4)), tau, None)
    assert kept.effectiveness == learnt.effectiveness


def test_telemetry_that_is_held_is_no_torque() -> None:
    """Half of all frames lost, the momentum held meanwhile, commands that change: sound wheels have no residual at all."""
    monitor = TorqueMonitor(TorqueMonitorConfig(kind="torque_monitor"), VEHICLE, TICK_S)
    rng = np.random.default_rng(5)
    h, held, command = np.zeros(4), np.zeros(4), np.zeros(4)
    for _ in range(2000):
        h = h - command * TICK_S
        new = rng.random(4) < 0.5
        held = np.where(new, h, held)
        readings = tuple(WheelReading(h_nms=x, new=bool(ok)) for x, ok in zip(held.tolist(), new, strict=True))
        health = monitor.step(TICK_S, readings, tuple(command.tolist()), None)  # type: ignore[arg-type]
        assert health.alarm == NO_WHEEL
        assert max(map(abs, monitor.internals.residual_nm)) < 1e-12
        command = rng.uniform(-0.1, 0.1, 4)
