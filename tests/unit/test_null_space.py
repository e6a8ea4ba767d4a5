"""Torques among the wheels: null momentum in closed form, wheels kept from zero speed, dither, and nothing on the body."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as tuning
from hypothesis import strategies as st

from bus.errors import ConfigError
from bus.units import Vec4
from fsw.config import FswConfig
from fsw.controllers.settings import SmcConfig
from fsw.estimation.settings import DirectConfig
from fsw.flight import Flight
from fsw.null_space import NullSpace
from fsw.observers.settings import NoObserverConfig
from fsw.records import HEALTHY, Allocation, Sensors, WheelHealth, WheelReading
from fsw.settings import ModelConfig, NullSpaceConfig, WheelModelConfig
from fsw.telemetry import make_diagnostics, read_internals
from fsw.vehicle import Vehicle
from tools.run.bench import Bench

INERTIA = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))
LIMIT_NM, ROTOR_KGM2, DT_S = 0.1, 0.01, 0.1
MODEL = ModelConfig(inertia_kgm2=INERTIA, wheel_max_torque_nm=LIMIT_NM, wheel_inertia_kgm2=ROTOR_KGM2)
VEHICLE = Vehicle(MODEL)
D0 = np.hstack([np.eye(3), np.full((3, 1), 1.0 / np.sqrt(3.0))])
NULL = np.array([1.0, 1.0, 1.0, -math.sqrt(3.0)]) / math.sqrt(6.0)  # D0 NULL = 0, by hand
REST: Vec4 = (0.0, 0.0, 0.0, 0.0)


def make(vehicle: Vehicle = VEHICLE, **settings: float) -> NullSpace:
    return NullSpace(NullSpaceConfig(**settings), vehicle, 0.1)


def hear(h_nms: Any, valid: tuple[bool, ...] = (True,) * 4) -> Sensors:
    sensors = Sensors(0, 0.0)
    sensors.wheels = tuple(  # type: ignore[assignment]
        WheelReading(h / ROTOR_KGM2, 0.0, 0, ok, h) for h, ok in zip(np.array(h_nms).tolist(), valid, strict=True)
    )
    return sensors


def act(stage: NullSpace, h_nms: Any, tau_rw_nm: Vec4 = REST, shares: Vec4 = (1.0,) * 4) -> np.ndarray:
    return np.array(stage.step(DT_S, tau_rw_nm, Allocation(tau_rw_nm, shares=shares), HEALTHY, hear(h_nms)))


# -- what it never does --------------------------------------------------------------------------------------------

momenta = st.tuples(*[st.floats(-9.0, 9.0)] * 4)
torques = st.tuples(*[st.floats(-LIMIT_NM, LIMIT_NM)] * 4)
shares_given = st.tuples(*[st.floats(0.05, 1.0)] * 4)


@given(
    h_nms=momenta, tau=torques, shares=shares_given, speed=st.sampled_from((0.0, 20.0, 200.0)), gain=st.floats(0.0, 1.0)
)
@tuning(max_examples=100)
def test_the_body_feels_nothing_and_limits_hold(
    h_nms: Vec4, tau: Vec4, shares: Vec4, speed: float, gain: float
) -> None:
    """Any momenta, allocation and shares: D diag(shares) u stays to 1e-12 N m, and no wheel is told more than it has."""
    stage = make(
        momentum_gain_1_s=gain, momentum_nms=1.0, avoid_speed_rad_s=speed, dither_nm=0.004, dither_period_s=2.0
    )
    told = act(stage, h_nms, tau, shares)
    assert np.abs(told).max() <= LIMIT_NM
    assert D0 @ (told * shares) == pytest.approx(D0 @ (np.array(tau) * shares), abs=1e-12)
    assert told * shares - np.array(tau) * shares == pytest.approx(stage.internals.gamma_nm * NULL, abs=1e-12)


@pytest.mark.parametrize(
    ("health", "shares", "valid", "momentum_known"),
    [
        (WheelHealth(available=(True, True, False, True)), (1.0, 1.0, 0.0, 1.0), (True,) * 4, False),
        (WheelHealth(dead=(True, False, False, False)), (0.0, 1.0, 1.0, 1.0), (True,) * 4, False),
        (HEALTHY, (1.0, 0.0, 1.0, 1.0), (True,) * 4, False),
        (HEALTHY, (1.0,) * 4, (True, True, True, False), False),
        (HEALTHY, (1.0,) * 4, (True,) * 4, True),
    ],
)
def test_nothing_without_a_null_space(health: WheelHealth, shares: Vec4, valid: Any, momentum_known: bool) -> None:
    """A wheel off, dead, or not heard: the torques allocated go on as they are; with all four they do not."""
    stage = make(momentum_gain_1_s=0.1)
    tau = (0.01, -0.02, 0.03, 0.0)
    told = stage.step(DT_S, tau, Allocation(tau, shares=shares), health, hear((1.0, 2.0, 3.0, 4.0), valid))
    assert (told != tau) is momentum_known
    assert (stage.internals.acting > 0.0) is momentum_known


def make_flight(**settings: float) -> Flight:
    config = FswConfig(
        model=MODEL,
        estimator=DirectConfig(kind="direct"),
        observer=NoObserverConfig(kind="none"),
        controller=SmcConfig(kind="smc"),
        null_space=NullSpaceConfig(**settings),
    )
    return Flight(config, DT_S, 1)


def test_off_unless_asked_for() -> None:
    """By default there is no such stage and no such topic, so that logs keep their bytes; asked for, there is one."""
    flight = make_flight()
    assert not flight.null_space.on
    assert "/fsw/null_space" not in {topic.name for topic in make_diagnostics(flight)}
    flight = make_flight(momentum_gain_1_s=0.02)
    (topic,) = (topic for topic in make_diagnostics(flight) if topic.name == "/fsw/null_space")
    assert [field.name for field in topic.fields] == ["momentum_nms", "target_nms", "gamma_nm", "acting"]
    assert read_internals(flight)["/fsw/null_space"] == (0.0, 0.0, 0.0, 0.0)


# -- null momentum -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shares", [(1.0, 1.0, 1.0, 1.0), (0.5, 1.0, 0.3, 0.9)])
def test_null_momentum_decays_as_it_should(shares: Vec4) -> None:
    """eta = (1 - k T)^n to rounding, which is exp(-k t) to k^2 T t / 2; what the body has of the wheels' momentum stays."""
    gain, reference = 0.02, 0.5
    stage = make(momentum_gain_1_s=gain, momentum_nms=reference)
    h = np.array([1.0, -2.0, 3.0, 1.5])
    start, total = NULL @ h - reference, D0 @ h
    for n in range(1, 1001):
        h = h - DT_S * act(stage, h, REST, shares) * shares
        assert NULL @ h - reference == pytest.approx(start * (1.0 - gain * DT_S) ** n, abs=1e-12)
    assert NULL @ h - reference == pytest.approx(start * math.exp(-gain * 100.0), rel=2.1e-3)
    assert D0 @ h == pytest.approx(total, abs=1e-12)
    assert stage.internals == pytest.approx((NULL @ h, reference, gain * (NULL @ h - reference), 2.0), rel=1e-2)


def test_a_busy_wheel_slows_it_down() -> None:
    """With a wheel at its limit the null torque is cut to what leaves it there: none one way, all of it the other."""
    stage = make(momentum_gain_1_s=1.0)
    up, down = NULL, -NULL  # gamma > 0 pushes x further up
    busy = (LIMIT_NM, 0.0, 0.0, 0.0)
    assert act(stage, 0.05 * up, busy) == pytest.approx(busy, abs=1e-15)
    assert stage.internals.acting == 3.0
    assert act(stage, 0.05 * down, busy) == pytest.approx(np.array(busy) - 0.05 * NULL, abs=1e-15)
    assert stage.internals.acting == 2.0
    told = act(stage, 5.0 * up)  # far more than there is room for: the skew wheel is at its limit, and no other
    assert told == pytest.approx(NULL / abs(NULL[3]) * LIMIT_NM, abs=1e-15)
    assert act(stage, (0.0, 0.0, 0.0, 0.0)) == pytest.approx(REST, abs=0.0)
    assert stage.internals.acting == 1.0


# -- zero speed ----------------------------------------------------------------------------------------------------


@given(h_nms=st.tuples(*[st.floats(-3.0, 3.0)] * 4))
@tuning(max_examples=50)
def test_the_target_is_the_nearest_at_which_no_wheel_is_slow(h_nms: Vec4) -> None:
    """Against a search over a fine grid of null momenta: where a wheel is too slow, the nearest at which none is."""
    least_rad_s, most_rad_s = 30.0, 950.0
    stage = make(avoid_speed_rad_s=least_rad_s)
    act(stage, h_nms)
    grid = np.linspace(-12.0, 12.0, 24001)
    speeds = np.abs(np.array(h_nms) + grid[:, None] * NULL) / ROTOR_KGM2
    good = grid[((speeds >= least_rad_s) & (speeds <= most_rad_s)).all(axis=1)]
    nearest = np.abs(good).min()
    found = stage.internals.target_nms - stage.internals.momentum_nms
    assert abs(found) == pytest.approx(nearest, abs=1.1e-3)
    at_target = np.abs(np.array(h_nms) + found * NULL) / ROTOR_KGM2
    assert at_target.min() >= least_rad_s * (1.0 - 1e-9)


def hold(stage: NullSpace | None, disturb: Any, h: np.ndarray, t_end_s: float) -> np.ndarray:
    """Speeds of wheels that take up a torque on the body by the pseudo-inverse [rad/s]."""
    pinv, speeds = np.linalg.pinv(D0), []
    for k in range(int(t_end_s / DT_S)):
        tau = tuple((-pinv @ disturb(k * DT_S)).tolist())
        told = np.array(tau) if stage is None else act(stage, h, tau)  # type: ignore[arg-type]
        h = h - DT_S * told
        speeds.append(h / ROTOR_KGM2)
    return np.array(speeds)


def count_crossings(speeds: np.ndarray) -> int:
    return int((np.sign(speeds[1:]) != np.sign(speeds[:-1])).sum())


def test_zero_crossings_are_avoided_in_a_hold() -> None:
    """A torque that comes and goes takes two wheels through zero twelve times in ten minutes; with the stage none does."""

    def disturb(t_s: float) -> np.ndarray:
        return np.array([2e-3, -1e-3, 5e-4]) * math.cos(2.0 * math.pi * t_s / 200.0)

    start = np.array([0.03, 0.01, 0.25, -0.3])
    alone = hold(None, disturb, start, 600.0)
    kept = hold(make(avoid_speed_rad_s=3.0), disturb, start, 600.0)
    assert count_crossings(alone) >= 10
    assert count_crossings(kept[200:]) == 0  # after it has brought the slow ones out
    assert np.abs(kept[200:]).min() > 2.0
    assert kept @ D0.T == pytest.approx(alone @ D0.T, abs=1e-9)  # the body has the same of both


def test_a_wheel_whose_way_is_barred_goes_through_fast() -> None:
    """A torque that never ends leaves no null momentum at which all stay as they are: the wheel then changes sign in
    seconds, not minutes, and no wheel is driven to its largest speed to put it off."""

    def disturb(_: float) -> np.ndarray:
        return np.array([4e-4, 3e-4, -5e-4])

    start = np.array([-0.1, -0.1, 0.12, 0.1])
    alone, kept = hold(None, disturb, start, 1200.0), hold(make(avoid_speed_rad_s=5.0), disturb, start, 1200.0)
    slow_alone, slow = (np.abs(alone) < 2.5).sum(axis=0) * DT_S, (np.abs(kept) < 2.5).sum(axis=0) * DT_S
    assert count_crossings(alone) >= 2
    assert slow_alone.sum() > 100.0
    assert slow.sum() < 0.1 * slow_alone.sum()
    assert np.abs(kept).max() < 2.0 * np.abs(alone).max()


def test_momentum_goes_no_further_than_wheels_may() -> None:
    """Momentum and zero speed at once: the null momentum comes as near to its reference as no wheel is slow there."""
    stage = make(momentum_gain_1_s=0.1, avoid_speed_rad_s=10.0)
    h = np.array([0.9, 0.5, 0.4, -1.2])
    for _ in range(3000):
        h = h - DT_S * act(stage, h)
    speeds = np.abs(h) / ROTOR_KGM2
    assert speeds.min() == pytest.approx(10.0, abs=0.01)
    further = h - 1e-3 * np.sign(NULL @ h) * NULL  # nearer to the reference, and too slow
    assert (np.abs(further) / ROTOR_KGM2).min() < 10.0


# -- dither --------------------------------------------------------------------------------------------------------


def test_dither_is_a_square_wave_of_the_size_asked_for() -> None:
    """+-4 mN m of the wheel most moved, 1.6 s a period, no mean; at lost ticks the wave goes on; reset starts it over."""
    stage = make(dither_nm=0.004, dither_period_s=1.6)
    told = np.array([act(stage, REST) for _ in range(160)])
    assert np.abs(told).max(axis=0) == pytest.approx(0.004 * np.abs(NULL) / np.abs(NULL).max(), abs=1e-15)
    assert told.mean(axis=0) == pytest.approx(REST, abs=1e-15)
    signs = np.sign(told[:, 0])
    assert (signs[:8] == 1.0).all()
    assert (signs[8:16] == -1.0).all()
    assert (signs[16:24] == 1.0).all()
    stage.step(0.8, REST, Allocation(REST), HEALTHY, hear(REST))
    assert act(stage, REST)[0] < 0.0
    stage.reset()
    assert act(stage, REST)[0] > 0.0
    deaf = stage.step(DT_S, REST, Allocation(REST), HEALTHY, hear(REST, (False,) * 4))
    assert max(map(abs, deaf)) == pytest.approx(0.004)  # takes no telemetry


# -- settings ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"dither_nm": 0.01}, "dither_period_s > 0 s"),
        ({"dither_nm": 0.2, "dither_period_s": 2.0}, "more than a wheel has, 0.1 N m"),
        ({"dither_nm": 0.01, "dither_period_s": 0.15}, "less than two control periods of 0.1 s"),
        ({"momentum_gain_1_s": 0.1, "momentum_nms": 1000.0}, "more than the wheels can hold"),
        ({"avoid_speed_rad_s": 500.0}, "below 475 rad/s"),
    ],
)
def test_settings_beyond_the_wheels_are_refused(settings: dict[str, float], word: str) -> None:
    """Each says what is wrong and how far it may go."""
    with pytest.raises(ConfigError, match=word):
        make(**settings)


def test_three_wheels_are_refused() -> None:
    """They have no null space; with everything off they are welcome."""
    axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0))
    a, b, c, d = (WheelModelConfig(axis_b=axis, fitted=i < 3) for i, axis in enumerate(axes))
    three = Vehicle(ModelConfig(inertia_kgm2=INERTIA, wheels=(a, b, c, d)))
    with pytest.raises(ConfigError, match="four are needed"):
        make(three, momentum_gain_1_s=0.1)
    assert not make(three).on


# -- in flight -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_wheels_with_friction_hold_better_away_from_zero() -> None:
    """Five minutes of ithaco-hold with slow wheels and a steady torque: minutes below 2 rad/s become seconds, and the
    largest error after 150 s falls."""
    speeds = (12.0, -9.0, 10.0, -14.0)
    mounts = [
        f"{{mount: {mount}, model: ithaco, speed_rad_s: {speed}, speed_noise_rad_s: 0.05, current_noise_a: 0.001}}"
        for mount, speed in zip(("x", "y", "z", "skew"), speeds, strict=True)
    ]
    changes = ["expect=[]", f"plant.wheels=[{', '.join(mounts)}]"]
    changes.append("plant.torques=[{kind: constant, torque_nm: [-4e-4, 3e-4, -2e-4]}]")
    slow_s, worst_deg = [], []
    for more in ([], ["fsw.null_space={avoid_speed_rad_s: 6}"]):
        with Bench.open("ithaco-hold", [*changes, *more], log="memory") as bench:
            bench.run_to_end()
            speed = bench.log.signals("/truth/wheels")["speed_rad_s"]
            slow_s.append((np.abs(speed) < 2.0).sum() * DT_S)
            worst_deg.append(bench.log.signals("/truth/attitude")["error_deg"][1500:].max())
    assert slow_s[0] > 60.0
    assert slow_s[1] < 10.0
    assert worst_deg[1] < worst_deg[0]
