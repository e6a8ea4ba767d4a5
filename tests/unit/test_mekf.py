"""The Kalman filter against closed forms: what it starts from, late frames, wrong frames, lost gyro, covariance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from fsw import estimation
from fsw.estimation.mekf import Mekf
from fsw.estimation.settings import MekfConfig
from fsw.records import Estimate, Sensors
from fsw.settings import ModelConfig
from fsw.vehicle import Vehicle

VEHICLE = Vehicle(ModelConfig(inertia_kgm2=((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))))
CONFIG = MekfConfig(kind="mekf")
TICK_S = 0.05
START = (1.0, 0.0, 0.0, 0.0)


def make_sensors(
    k: int,
    rate: tuple[float, float, float],
    q: tuple[float, ...] | None = None,
    age_s: float = 0.0,
    gyro_valid: tuple[bool, bool, bool] = (True, True, True),
) -> Sensors:
    meas = tuple(q) if q is not None else START
    return Sensors(k, k * TICK_S, rate, gyro_valid, meas, q is not None, True, age_s)  # type: ignore[arg-type]


def scipy_to_q(rotation: Rotation) -> tuple[float, ...]:
    x, y, z, w = rotation.as_quat()
    return (float(w), float(x), float(y), float(z))


def angle_between(estimate: Estimate, truth: Rotation) -> float:
    w, x, y, z = estimate.q_ib
    return float((Rotation.from_quat([x, y, z, w]) * truth.inv()).magnitude())


def test_not_valid_before_the_first_star_frame() -> None:
    """Without any attitude the estimate must say that it is not fit for pointing."""
    mekf = Mekf(CONFIG, VEHICLE, TICK_S)
    assert not mekf.step(make_sensors(0, (0.0, 0.0, 0.0))).valid
    assert mekf.step(make_sensors(1, (0.0, 0.0, 0.0), START)).valid


def test_gyro_propagation_is_the_exact_rotation() -> None:
    """A constant rate for 10 s is the closed-form rotation exp(w t), whatever the axis (scipy is the oracle)."""
    mekf = Mekf(CONFIG, VEHICLE, TICK_S)
    rate = (0.11, -0.07, 0.05)
    estimate = mekf.step(make_sensors(0, rate, START))
    for k in range(1, 201):
        estimate = mekf.step(make_sensors(k, rate))
    assert angle_between(estimate, Rotation.from_rotvec(np.array(rate) * 10.0)) < 1e-9


@pytest.mark.parametrize("late_ticks", [0, 1, 3, 7])
def test_a_late_frame_is_used_at_the_tick_it_was_taken(late_ticks: int) -> None:
    """With perfect sensors a rotating body is followed exactly whatever the latency: no lag of rate times latency."""
    mekf = Mekf(CONFIG, VEHICLE, TICK_S)
    rate = np.array([0.05, 0.08, -0.06])
    estimate = None
    for k in range(0, 400):
        fresh = k % 5 == 0 and k >= late_ticks
        frame = scipy_to_q(Rotation.from_rotvec(rate * (k - late_ticks) * TICK_S)) if fresh else None
        estimate = mekf.step(make_sensors(k, tuple(rate), frame, late_ticks * TICK_S))
    assert estimate is not None
    assert angle_between(estimate, Rotation.from_rotvec(rate * 399 * TICK_S)) < 1e-8
    assert mekf.internals.rejected == 0


def test_bias_converges_to_the_truth() -> None:
    """A constant gyro offset with a perfect star tracker ends up in the bias state and out of the rate."""
    mekf = Mekf(CONFIG, VEHICLE, TICK_S)
    bias = (2e-4, -1e-4, 3e-4)
    estimate = None
    for k in range(2400):
        estimate = mekf.step(make_sensors(k, bias, START if k % 5 == 0 else None))
    assert estimate is not None
    assert estimate.bias_b_rad_s == pytest.approx(bias, abs=2e-6)
    assert estimate.omega_bi_b_rad_s == pytest.approx((0.0, 0.0, 0.0), abs=2e-6)


def test_covariance_over_an_outage_is_the_matrix_exponential() -> None:
    """Without frames the covariance follows the Van Loan solution of the error equations (scipy's expm)."""
    mekf = Mekf(CONFIG, VEHICLE, TICK_S)
    mekf.step(make_sensors(0, (0.0, 0.0, 0.0), START))
    for k in range(1, 601):
        mekf.step(make_sensors(k, (0.0, 0.0, 0.0)))
    arw2, rrw2 = CONFIG.gyro_arw_rad_sqrt_s**2, CONFIG.gyro_rrw_rad_s_sqrt_s**2
    drift, noise = np.array([[0.0, -1.0], [0.0, 0.0]]), np.diag([arw2, rrw2])
    block = expm(np.block([[-drift, noise], [np.zeros((2, 2)), drift.T]]) * 30.0)
    phi = block[2:, 2:].T
    start = np.diag([math.radians(1.0) ** 2, CONFIG.initial_bias_sigma_rad_s**2])
    expected = phi @ start @ phi.T + phi @ block[:2, 2:]
    internals = mekf.internals
    assert internals.attitude_cov_i_rad2[0] == pytest.approx(expected[0, 0], rel=1e-6)
    assert internals.cross_cov_rad2_s[0] == pytest.approx(expected[0, 1], rel=1e-6)
    assert internals.bias_cov_b_rad2_s2[3] == pytest.approx(expected[1, 1], rel=1e-9)


def test_a_wild_frame_is_refused_and_counted() -> None:
    """One frame 1 degree off leaves the estimate alone; the same offset for good makes the filter start again."""
    mekf = Mekf(CONFIG, VEHICLE, TICK_S)
    still = (0.0, 0.0, 0.0)
    for k in range(400):
        mekf.step(make_sensors(k, still, START if k % 5 == 0 else None))
    wild = Rotation.from_rotvec([0.0, math.radians(1.0), 0.0])
    estimate = mekf.step(make_sensors(400, still, scipy_to_q(wild)))
    assert mekf.internals.rejected == 1
    assert angle_between(estimate, Rotation.identity()) < 1e-9
    for k in range(401, 440):
        estimate = mekf.step(make_sensors(k, still, scipy_to_q(wild) if k % 5 == 0 else None))
    assert mekf.internals.restarts == 1
    assert angle_between(estimate, wild) < 1e-6


def test_a_lost_axis_makes_the_estimate_not_valid_and_leaves_the_bias_alone() -> None:
    """A dead axis holds its last rate: the filter says so, follows the star tracker, and learns no false bias."""
    mekf = Mekf(CONFIG, VEHICLE, TICK_S)
    for k in range(400):
        mekf.step(make_sensors(k, (0.0, 0.0, 0.0), START if k % 5 == 0 else None))
    truth, estimate = Rotation.identity(), None
    for k in range(400, 600):
        truth = Rotation.from_rotvec([0.0, 0.0, 0.01 * (k - 399) * TICK_S])
        frame = scipy_to_q(truth) if k % 5 == 0 else None
        estimate = mekf.step(make_sensors(k, (0.0, 0.0, 0.0), frame, 0.0, (True, True, False)))
    assert estimate is not None
    assert not estimate.valid
    assert angle_between(estimate, truth) < 0.01 * 0.25 + 1e-4
    assert max(abs(b) for b in estimate.bias_b_rad_s) < 1e-6


def test_reset_repeats_bit_for_bit() -> None:
    """The filter holds nothing across a reset, and the registry makes the same filter."""

    def fly(mekf: Mekf) -> list[Estimate]:
        return [mekf.step(make_sensors(k, (1e-3, 0.0, 2e-3), START if k % 5 == 0 else None)) for k in range(200)]

    mekf = Mekf(CONFIG, VEHICLE, TICK_S)
    first = fly(mekf)
    mekf.reset()
    assert fly(mekf) == first
    assert fly(estimation.REGISTRY.make(CONFIG, VEHICLE, TICK_S)) == first  # type: ignore[arg-type]
