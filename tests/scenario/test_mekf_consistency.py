"""Is the Kalman filter as good as it says? NEES and NIS over a Monte Carlo, against chi-square bounds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from fsw.estimation.mekf import Mekf
from fsw.estimation.settings import MekfConfig
from fsw.records import Sensors
from fsw.settings import ModelConfig
from fsw.vehicle import Vehicle

VEHICLE = Vehicle(ModelConfig(inertia_kgm2=((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))))
CONFIG = MekfConfig(kind="mekf")
TICK_S = 0.05
STAR_TICKS = 5


def symmetric(v: tuple[float, ...]) -> np.ndarray:
    return np.array([[v[0], v[1], v[2]], [v[1], v[3], v[4]], [v[2], v[4], v[5]]])


def fly(seed: int, duration_s: float, late_ticks: int) -> tuple[float, np.ndarray]:
    """NEES at the end (6 degrees of freedom) and every NIS after 10 s (3 degrees each) of one random flight."""
    rng = np.random.default_rng(seed)
    mekf = Mekf(CONFIG, VEHICLE, TICK_S)
    sigma = np.array(CONFIG.star_noise_arcsec) * math.pi / 648000.0
    attitude = Rotation.random(random_state=seed)
    past = [attitude]
    bias = rng.normal(0.0, CONFIG.initial_bias_sigma_rad_s, 3)
    phase = rng.uniform(0.0, 6.28, 3)
    nis = []
    for k in range(1, round(duration_s / TICK_S) + 1):
        rate = 0.03 * np.sin(np.array([0.11, 0.07, 0.05]) * k * TICK_S + phase)
        attitude = attitude * Rotation.from_rotvec(rate * TICK_S)
        past.append(attitude)
        bias = bias + CONFIG.gyro_rrw_rad_s_sqrt_s * math.sqrt(TICK_S) * rng.normal(size=3)
        gyro = rate + bias + CONFIG.gyro_arw_rad_sqrt_s / math.sqrt(TICK_S) * rng.normal(size=3)
        fresh = k % STAR_TICKS == 0 and k > late_ticks
        meas = past[max(0, k - late_ticks)] * Rotation.from_rotvec(sigma * rng.normal(size=3))
        x, y, z, w = meas.as_quat().tolist()
        sensors = Sensors(
            k, k * TICK_S, tuple(gyro.tolist()), (True, True, True), (w, x, y, z), fresh, True, late_ticks * TICK_S
        )
        estimate = mekf.step(sensors)
        if fresh and k * TICK_S > 10.0:
            nis.append(mekf.internals.innovation_nis)
    internals = mekf.internals
    cross = np.array(internals.cross_cov_rad2_s).reshape(3, 3)
    cov = np.block([
        [symmetric(internals.attitude_cov_i_rad2), cross],
        [cross.T, symmetric(internals.bias_cov_b_rad2_s2)],
    ])  # fmt: skip
    w, x, y, z = estimate.q_ib
    theta = (attitude * Rotation.from_quat([x, y, z, w]).inv()).as_rotvec()
    error = np.concatenate([theta, bias - np.array(estimate.bias_b_rad_s)])
    return float(error @ np.linalg.solve(cov, error)), np.array(nis)


def check_consistency(runs: int, duration_s: float, late_ticks: int) -> None:
    flights = [fly(seed, duration_s, late_ticks) for seed in range(runs)]
    nees = np.array([nees for nees, _ in flights])
    nis = np.concatenate([nis for _, nis in flights])
    # 99.9 % two-sided bounds of the sums; flights are independent, and innovations of one flight are white.
    low, high = chi2.ppf([0.0005, 0.9995], 6 * runs) / runs
    assert low < nees.mean() < high, f"mean NEES {nees.mean():.2f} outside {low:.2f} .. {high:.2f} over {runs} runs"
    low, high = chi2.ppf([0.0005, 0.9995], 3 * nis.size) / nis.size
    assert low < nis.mean() < high, f"mean NIS {nis.mean():.3f} outside {low:.3f} .. {high:.3f}"


@pytest.mark.parametrize("late_ticks", [0, 3])
def test_estimation_errors_match_their_covariance(late_ticks: int) -> None:
    """Mean NEES over 16 random flights and mean NIS over all their frames lie in their 99.9 % chi-square bounds."""
    check_consistency(16, 30.0, late_ticks)


@pytest.mark.slow
@pytest.mark.parametrize("late_ticks", [0, 8])
def test_estimation_errors_match_their_covariance_over_many_flights(late_ticks: int) -> None:
    """The same over 100 flights of 90 s, whose bounds are much narrower."""
    check_consistency(100, 90.0, late_ticks)
