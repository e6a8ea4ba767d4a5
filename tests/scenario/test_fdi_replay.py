"""Recorded sensor streams through the detector: the tick, the axis and the rate of an independent detector.

Each stream is 100 s of a closed loop with wheel faults and misalignment; two have a gyro fault from 60.13 s on.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from fsw.gyro_fdi.classification import FaultKind
from fsw.gyro_fdi.practical import PracticalDetector, PracticalInternals
from fsw.gyro_fdi.settings import PracticalDetectorConfig
from fsw.records import Detection, Estimate, Sensors, WheelReading
from fsw.settings import ModelConfig
from fsw.vehicle import Vehicle
from fsw.wheel_health.settings import TorqueMonitorConfig
from fsw.wheel_health.torque_monitor import TorqueMonitor

DATA = Path(__file__).parents[1] / "data" / "gyro"
VEHICLE = Vehicle(ModelConfig(inertia_kgm2=((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))))
ARCSEC = math.pi / 648000.0
STAR_ARCSEC = (5e-5 / ARCSEC, 5e-5 / ARCSEC, 2.5e-4 / ARCSEC)
TICK_S, FRAME_TICKS, SETTLED = 0.05, 5, 100
STREAMS = ("const_0p1_all", "nominal", "sin_0p01_z")
ALARM = 2


class Replay(NamedTuple):
    states: np.ndarray
    rates: np.ndarray
    faults: np.ndarray
    internals: PracticalInternals


def make_sensors(data: dict[str, np.ndarray], k: int, frames: dict[int, list[float]]) -> Sensors:
    q, (a, b, c, d) = frames.get(k), (WheelReading(h_nms=h) for h in data["h_tacho"][k].tolist())
    return Sensors(
        k, k * TICK_S, tuple(data["gyro"][k].tolist()), (True, True, True), tuple(q) if q else (1.0, 0.0, 0.0, 0.0),
        q is not None, True, 0.0, (a, b, c, d),
    )  # fmt: skip


def load(name: str) -> tuple[list[Sensors], list[tuple[float, ...]]]:
    """Sensors of each tick, and the torques commanded over the tick that ends there."""
    data = dict(np.load(DATA / f"stream_{name}.npz"))
    frames = dict(zip(data["st_tick"].tolist(), data["q_st"].tolist(), strict=True))
    sensors = [make_sensors(data, k, frames) for k in range(len(data["gyro"]))]
    return sensors, [(0.0,) * 4, *(tuple(row) for row in data["tau_cmd_next"].tolist())]


def step(detector: PracticalDetector, sensors: Sensors, command: tuple[float, ...]) -> Detection:
    unknown = Estimate((1.0, 0.0, 0.0, 0.0), sensors.omega_meas_b_rad_s, (0.0, 0.0, 0.0), False)
    return detector.step(sensors, unknown, command)  # type: ignore[arg-type]


@cache
def replay(name: str, observer: str = "static") -> Replay:
    config = PracticalDetectorConfig(kind="practical", star_noise_arcsec=STAR_ARCSEC, observer=observer)  # type: ignore[arg-type]
    detector = PracticalDetector(config, VEHICLE, TICK_S)
    states, rates, faults = [], [], []
    for sensors, command in zip(*load(name), strict=False):
        found = step(detector, sensors, command)
        states.append(found.gyro_state)
        rates.append(found.estimate.omega_bi_b_rad_s)
        faults.append(found.fault_hat_b_rad_s)
    return Replay(np.array(states), np.array(rates), np.array(faults), detector.internals)


def watch_wheels(name: str) -> np.ndarray:
    """Alarms of the torque monitor on a stream, shape (ticks, 4)."""
    monitor = TorqueMonitor(TorqueMonitorConfig(kind="torque_monitor", reaction="report"), VEHICLE, TICK_S)
    ticks = zip(*load(name), strict=False)
    return np.array([monitor.step(TICK_S, sensors.wheels, command, None).alarm for sensors, command in ticks])  # type: ignore[arg-type]


def first(flags: np.ndarray) -> int:
    return int(np.argmax(flags)) if flags.any() else -1


@pytest.mark.parametrize("name", STREAMS)
def test_alarm_comes_at_the_reference_tick_on_the_right_axis(name: str) -> None:
    """Every axis raises its alarm within one star-tracker frame of the reference, and no other axis raises one."""
    data, result = np.load(DATA / f"stream_{name}.npz"), replay(name)
    for axis, expected in enumerate(data["ref_alarm_tick"].tolist()):
        got = first(result.states[:, axis] >= ALARM)
        assert (got == -1) == (expected == -1)
        assert abs(got - expected) <= FRAME_TICKS


@pytest.mark.parametrize("name", ["const_0p1_all", "sin_0p01_z"])
def test_rate_handed_on_is_as_good_as_the_reference(name: str) -> None:
    """rms(y - omega_hat - fault) per axis at fault is within 10 % of the reference detector's."""
    data, result = np.load(DATA / f"stream_{name}.npz"), replay(name)
    axes = np.flatnonzero(data["ref_alarm_tick"] >= 0)
    ours, theirs = (
        np.sqrt(((data["gyro"] - hat - data["fault"])[SETTLED:, axes] ** 2).mean(axis=0))
        for hat in (result.rates, data["ref_omega_used"])
    )
    assert ours == pytest.approx(theirs, rel=0.10)


def test_fault_free_stream_raises_nothing() -> None:
    """No gyro alarm, no suspicion, no wheel alarm over 100 s of healthy units with misaligned wheels."""
    assert replay("nominal").states.max() == 0
    assert not watch_wheels("nominal").any()


def test_a_jump_is_suspect_within_a_tick() -> None:
    """The constant 0.1 rad/s from 60.13 s on makes its axes suspect at the next sample or the one after."""
    result = replay("const_0p1_all")
    onset = first(np.load(DATA / "stream_const_0p1_all.npz")["fault"][:, 0] != 0.0)
    for axis in range(3):
        assert 0 <= first(result.states[:, axis] > 0) - onset <= 1


@pytest.mark.parametrize(
    ("name", "axis", "kind", "size", "frequency"),
    [
        ("const_0p1_all", 0, FaultKind.CONSTANT, 0.1, 0.0),
        ("const_0p1_all", 1, FaultKind.CONSTANT, 0.1, 0.0),
        ("const_0p1_all", 2, FaultKind.CONSTANT, 0.1, 0.0),
        ("sin_0p01_z", 2, FaultKind.PERIODIC, 0.01, 0.5),
    ],
)
def test_kind_and_size(name: str, axis: int, kind: FaultKind, size: float, frequency: float) -> None:
    """Constant drift to 0.1 %; the 0.01 sin 0.5 t, near the star tracker's noise, to 0.5 % in both parameters."""
    found = replay(name).internals
    assert found.fault_kind[axis] == kind
    assert abs(found.fault_magnitude_rad_s[axis]) == pytest.approx(size, rel=0.005)
    assert found.fault_frequency_rad_s[axis] == pytest.approx(frequency, rel=0.005)
    assert found.fault_confidence[axis] > 0.99
    assert found.onset_t_s[axis] == pytest.approx(60.13, abs=0.3)


def test_fault_estimate_is_accurate() -> None:
    """From 2 s after the alarm on the raw estimate is within 2e-4 rad/s rms, its 20 s mean within 1e-4."""
    data, result = np.load(DATA / "stream_const_0p1_all.npz"), replay("const_0p1_all")
    error = (result.faults - data["fault"])[1250:]
    assert np.sqrt((error**2).mean(axis=0)).max() <= 2e-4
    assert np.abs(error[:400].mean(axis=0)).max() <= 1e-4


def test_wheels_are_named() -> None:
    """The published wheel faults raise the alarms of wheels 2, 3 and 1 after their onsets, gyro fault or not."""
    alarms = watch_wheels("sin_0p01_z")
    for wheel, onset_s in ((0, 30.0), (1, 10.0), (2, 20.0), (3, 30.0)):
        assert 0.0 <= first(alarms[:, wheel]) * TICK_S - onset_s <= 15.0


@pytest.mark.parametrize("observer", ["linear", "ts_b", "ts_bx"])
def test_choice_of_observer_leaves_detection_with_stars_alone(observer: str) -> None:
    """The observer's residual decides only without a star tracker: with one, every choice gives the same alarms."""
    assert np.array_equal(replay("const_0p1_all", observer).states, replay("const_0p1_all").states)
