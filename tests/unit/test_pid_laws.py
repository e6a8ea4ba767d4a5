"""The PID laws of paper 003, sample by sample against recorded flights of an independent integration, and their integral."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.errors import ConfigError
from bus.settings import build
from bus.units import Vec3, Vec4
from fsw.controllers import REGISTRY
from fsw.controllers.fuzzy_pid import FuzzyPid
from fsw.controllers.pid import Pid
from fsw.controllers.rate_pid import RatePid
from fsw.controllers.settings import FuzzyPidConfig, PidConfig, RatePidConfig
from fsw.records import HEALTHY, PointingError, WheelHealth
from fsw.settings import ModelConfig, WheelModelConfig
from fsw.vehicle import Vehicle

RECORD = np.load(Path(__file__).resolve().parents[1] / "data" / "wheel" / "closed_loop_excerpt.npz")
PERIOD_S = 0.1
LIMIT_NM = 0.0275
INERTIA = ((12.49, 0.0, 0.0), (0.0, 13.85, 0.0), (0.0, 0.0, 15.75))
ZERO: Vec3 = (0.0, 0.0, 0.0)
THREE = WheelHealth((1.0, 1.0, 1.0, 0.0), (True, True, True, False))  # the wheels of the record: along x, y and z


def make_vehicle() -> Vehicle:
    axes: tuple[Vec3, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0))
    a, b, c, d = (WheelModelConfig(axis_b=axis, max_torque_nm=LIMIT_NM) for axis in axes)
    return Vehicle(ModelConfig(inertia_kgm2=INERTIA, wheels=(a, b, c, d)))


VEHICLE = make_vehicle()


def read(data: dict[str, Any]) -> Any:
    """A law from settings as a scenario has them."""
    config = build(REGISTRY.kinds[data["kind"]][0], data, "test")
    return REGISTRY.make(config, VEHICLE, PERIOD_S)


def point(angle_rad: float, rate_rad_s: float, axis: int = 0) -> PointingError:
    """An error about one body axis."""
    q, w = [math.cos(0.5 * angle_rad), 0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
    q[1 + axis], w[axis] = math.sin(0.5 * angle_rad), rate_rad_s
    return PointingError((q[0], q[1], q[2], q[3]), (w[0], w[1], w[2]))


# -- against the record --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("case", "law"),
    [
        ("A_pid_fault1_dist1", {"kind": "rate_pid"}),
        ("A_fuzzy_fault1_dist1", {"kind": "fuzzy_pid"}),
        ("B_pid_fault1_dist1", {"kind": "pid"}),
        ("A_pid_fault1_dist1", {"kind": "fuzzy_pid", "kp_span": 0.0, "ki_span": 0.0, "kd_span": 0.0}),
        ("B_pid_fault1_dist1", {"kind": "fuzzy_pid", "base": "engineering", "rho": 0.0}),
    ],
)
def test_laws_give_the_recorded_torques(case: str, law: dict[str, Any]) -> None:
    """A minute of attitudes and rates at 10 Hz, saturated start included: torque and gains to 1e-12, with the defaults."""
    controller = read(law)
    torques, gains = RECORD[f"{case}/u"], RECORD[f"{case}/gains"]
    for k, (q, w) in enumerate(zip(RECORD[f"{case}/q"].tolist(), RECORD[f"{case}/omega"].tolist(), strict=True)):
        torque = controller.step(PERIOD_S, PointingError(tuple(q), tuple(w)), ZERO, THREE)
        assert torque == pytest.approx(torques[k], abs=1e-12)
        if law["kind"] == "fuzzy_pid" and len(gains) > 1:
            found = controller.internals
            assert (*found.kp, *found.ki, *found.kd) == pytest.approx(gains[k], abs=1e-10)
    if law["kind"] == "pid":
        assert np.abs(torques[0]).max() > LIMIT_NM  # the limit was reached, so that the anti-windup has been tried


def test_default_gains_are_those_of_the_record() -> None:
    """Poles (0.25 rad/s, 1, 0.02 rad/s) on the record's inertia are the record's gains."""
    law = Pid(PidConfig(kind="pid"), VEHICLE, PERIOD_S)
    kp, ki, kd = np.split(RECORD["B_pid_fault1_dist1/gains"][0], 3)
    assert law._kp == pytest.approx(kp, rel=1e-12)
    assert law._ki == pytest.approx(ki, rel=1e-12)
    assert law._kd == pytest.approx(kd, rel=1e-12)


def test_gains_place_the_poles() -> None:
    """The roots of p^3 + kd/I p^2 + kp/I p + ki/I are the poles asked for (numpy is the oracle), per axis."""
    config = PidConfig(kind="pid", frequency_rad_s=0.3, damping=0.6, integral_rad_s=0.05)
    law = Pid(config, VEHICLE, PERIOD_S)
    expected = np.sort_complex([-0.05, *np.roots([1.0, 2.0 * 0.6 * 0.3, 0.09])])
    for axis, inertia in enumerate((12.49, 13.85, 15.75)):
        roots = np.roots([1.0, law._kd[axis] / inertia, law._kp[axis] / inertia, law._ki[axis] / inertia])
        assert np.sort_complex(roots) == pytest.approx(expected, abs=1e-12)


# -- the rate PID --------------------------------------------------------------------------------------------------


def test_rate_pid_is_per_axis_and_smooths_the_acceleration() -> None:
    """By hand: a(1) = 0, a(2) = 1/2 dw/dt, a(3) = 1/2 a(2) where the rate stands; each axis has gains of its own."""
    law = RatePid(
        RatePidConfig(kind="rate_pid", kp=(1.0, 2.0, 3.0), ki=(4.0, 5.0, 6.0), kd=(7.0, 8.0, 9.0)), VEHICLE, 0.1
    )
    q: Vec4 = (0.8, 0.36, -0.48, 0.0)
    rates = [(0.01, 0.02, 0.03), (0.02, 0.0, 0.03), (0.02, 0.0, 0.03)]
    accelerations = [np.zeros(3), 0.5 * np.array([0.1, -0.2, 0.0]), 0.25 * np.array([0.1, -0.2, 0.0])]
    for rate, alpha in zip(rates, accelerations, strict=True):
        torque = law.step(0.1, PointingError(q, rate), (0.1, 0.2, 0.3), HEALTHY)
        expected = -np.array([1, 2, 3]) * rate - 2 * np.array([4, 5, 6]) * q[1:] - np.array([7, 8, 9]) * alpha
        assert torque == pytest.approx(expected - (0.1, 0.2, 0.3), abs=1e-12)  # the observer's torque is made up for


@pytest.mark.parametrize("kind", ["rate_pid", "fuzzy_pid", "pid"])
def test_observed_torque_is_made_up_for(kind: str) -> None:
    """What an observer says is subtracted as it stands, below the limit of the wheels."""
    error, v = point(2e-3, 1e-4), (1e-3, -2e-3, 3e-3)
    without, with_it = (read({"kind": kind}).step(PERIOD_S, error, torque, HEALTHY) for torque in (ZERO, v))
    assert np.subtract(without, with_it) == pytest.approx(v, abs=1e-15)


# -- fuzzy gains ---------------------------------------------------------------------------------------------------


def test_gains_are_base_plus_share_of_the_span() -> None:
    """K = K0 + span (1 + F)/2, F as shown, never below K0; the inputs are -sigma and -w over their scales."""
    law = FuzzyPid(FuzzyPidConfig(kind="fuzzy_pid"), VEHICLE, PERIOD_S)
    for angle, rate in ((0.05, 0.0), (-0.013, 0.004), (0.002, -0.05)):
        sigma = 2.0 * math.sin(0.5 * angle)
        law.step(PERIOD_S, point(angle, rate), ZERO, HEALTHY)
        found, f = law.internals, law._tables.infer(-sigma / 0.04, -rate / 0.04)
        assert (found.f_kp[0], found.f_ki[0], found.f_kd[0]) == pytest.approx(f, abs=1e-12)
        assert found.kp[0] == pytest.approx(0.7 + 50.0 * (1.0 + f[0]))
        assert found.ki[0] == pytest.approx(3.0 + 0.5 * (1.0 + f[1]))
        assert found.kd[0] == pytest.approx(5.0 * (1.0 + f[2]))


def test_fuzzy_on_the_engineering_base_varies_its_gains() -> None:
    """K = K0 (1 + rho F) about the gains of `pid`, on scales of 0.02 rad and 0.005 rad/s."""
    config = FuzzyPidConfig(kind="fuzzy_pid", base="engineering", tables="even")
    law, plain = FuzzyPid(config, VEHICLE, PERIOD_S), Pid(PidConfig(kind="pid"), VEHICLE, PERIOD_S)
    angle, rate = 0.011, -0.002
    law.step(PERIOD_S, point(angle, rate, axis=1), ZERO, HEALTHY)
    f = law._tables.infer(-2.0 * math.sin(0.5 * angle) / 0.02, -rate / 0.005)
    found = law.internals
    assert found.kp[1] == pytest.approx(plain._kp[1] * (1.0 + 0.5 * f[0]))
    assert found.ki[1] == pytest.approx(plain._ki[1] * (1.0 + 0.5 * f[1]))
    assert found.kd[1] == pytest.approx(plain._kd[1] * (1.0 + 0.5 * f[2]))


@pytest.mark.parametrize("kind", ["pid", "fuzzy_pid"])
def test_two_gains_of_three_are_refused(kind: str) -> None:
    """It says which law, what is missing and what to do."""
    with pytest.raises(ConfigError, match=rf"{kind}: ki not given.*give kp, ki and kd, or none"):
        read({"kind": kind, "kp": [1.0, 1.0, 1.0], "kd": [1.0, 1.0, 1.0]})


@pytest.mark.parametrize("kind", ["pid", "fuzzy_pid", "rate_pid"])
def test_negative_gains_are_refused_where_they_stand(kind: str) -> None:
    """With the key of the axis."""
    gains = {key: [1.0, -1.0, 1.0] if key == "kd" else [1.0, 1.0, 1.0] for key in ("kp", "ki", "kd")}
    with pytest.raises(ConfigError, match=r"kd\[1\].*>= 0"):
        read({"kind": kind, **gains})


# -- the integral --------------------------------------------------------------------------------------------------


def fly_axis(law: Pid, angle_rad: float, until_s: float, gain: float = 1.0, friction_nm: float = 0.0) -> np.ndarray:
    """Angles of a body of 12.49 kg m^2 that one wheel of 27.5 mN m turns about x, every period, by exact steps."""
    rate, found = 0.0, []
    for _ in range(round(until_s / PERIOD_S)):
        found.append(angle_rad)
        torque = law.step(PERIOD_S, point(angle_rad, rate), ZERO, THREE)[0]
        given = gain * max(-LIMIT_NM, min(LIMIT_NM, torque)) + friction_nm
        angle_rad += rate * PERIOD_S + 0.5 * given / 12.49 * PERIOD_S**2
        rate += given / 12.49 * PERIOD_S
    return np.array(found)


def test_integral_does_not_wind_up_in_a_long_turn() -> None:
    """From 1 rad, saturated for long: the overshoot is a third of that with no limit set, and the target is reached."""
    config = PidConfig(kind="pid", integral_rad_s=0.05)
    held = fly_axis(Pid(config, VEHICLE, PERIOD_S), 1.0, 400.0)
    wound = fly_axis(Pid(replace(config, limit_nm=1e3), VEHICLE, PERIOD_S), 1.0, 400.0)
    assert -held.min() < -wound.min() / 3.0
    assert abs(held[-1]) < 1e-4


def test_integral_ends_any_steady_error() -> None:
    """Half the gain lost and 2 mN m of friction in hold, 15 mrad off: no error is so large that the integral sleeps."""
    law = Pid(PidConfig(kind="pid"), VEHICLE, PERIOD_S)
    angles = fly_axis(law, 0.015, 600.0, gain=0.5, friction_nm=0.002)
    assert np.abs(angles[-1000:]).max() < 1e-5
    assert law.internals.integral_b_rad_s[0] * law._ki[0] == pytest.approx(-0.004, rel=1e-2)


def test_integral_stands_at_the_limit_and_runs_back_from_it() -> None:
    """About a saturated axis z stands while the torque drives towards the target, and moves where it drives away."""
    config = PidConfig(kind="pid", ki=(1.0, 1.0, 1.0), kp=(0.0, 0.0, 0.0), kd=(100.0, 0.0, 0.0))
    law = Pid(config, VEHICLE, PERIOD_S)
    law.step(PERIOD_S, point(0.01, 1.0), ZERO, THREE)  # -100 N m by the rate, towards a target at -0.01 rad: stands
    assert law.internals.integral_b_rad_s == ZERO
    law.step(PERIOD_S, point(0.01, -1.0), ZERO, THREE)  # away from it: runs
    assert law.internals.integral_b_rad_s[0] == pytest.approx(-0.001, rel=1e-4)
    law.step(PERIOD_S, point(0.01, 0.0), ZERO, THREE)  # within the limit: runs
    assert law.internals.integral_b_rad_s[0] == pytest.approx(-0.002, rel=1e-4)


def test_limit_is_what_the_wheels_can_give() -> None:
    """Three wheels: each axis its own. A fourth adds to each axis what it has along it. A weak wheel gives its share."""
    law = Pid(PidConfig(kind="pid"), VEHICLE, PERIOD_S)
    skew = LIMIT_NM / math.sqrt(3.0)
    weak = replace_share(THREE, (0.5, 1.0, 1.0, 0.0))
    dead = WheelHealth((1.0, 1.0, 1.0, 1.0), (True, True, False, False))
    for health, expected in (
        (THREE, (LIMIT_NM,) * 3),
        (HEALTHY, (LIMIT_NM + skew,) * 3),
        (weak, (0.5 * LIMIT_NM, LIMIT_NM, LIMIT_NM)),
        (dead, (LIMIT_NM, LIMIT_NM, 0.0)),
        (THREE, (LIMIT_NM,) * 3),
    ):
        law.step(PERIOD_S, point(0.0, 0.0), ZERO, health)
        assert law.internals.limit_b_nm == pytest.approx(expected, abs=1e-11)
    fixed = Pid(PidConfig(kind="pid", limit_nm=0.01), VEHICLE, PERIOD_S)
    fixed.step(PERIOD_S, point(0.0, 0.0), ZERO, weak)
    assert fixed.internals.limit_b_nm == (0.01, 0.01, 0.01)


def replace_share(health: WheelHealth, share: Vec4) -> WheelHealth:
    return WheelHealth(share, health.available)
