"""The paper's wheel filter: its matrices, why Euler's will not do, and what its residual shows."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm

from fsw.records import WheelReading
from fsw.settings import ModelConfig, WheelMotorConfig
from fsw.vehicle import Vehicle
from fsw.wheel_health.paper_filter import PaperFilter, discretise
from fsw.wheel_health.settings import WheelKalmanPaperConfig
from fsw.wheel_health.wheel_kalman_paper import WheelKalmanPaper

R, L, PSI, J, VISCOUS, COULOMB = 2.0, 0.02, 0.029, 0.0077, 3.9e-5, 0.002
F = (-R / L, -PSI / L, PSI / J, -VISCOUS / J)
GD, KT, WD = 0.19, 0.029, 9.0


def test_phi_and_gamma_are_the_reference_ones() -> None:
    """At 10 ms, to the digits that the reference gives."""
    phi, total = discretise(F, 0.01)
    assert phi == pytest.approx((0.36773515, -0.00916466, 0.0238043, 0.99974847), abs=5e-9)
    assert (total[0] / L, total[2] / L) == pytest.approx((0.31603198, 0.00692718), abs=5e-9)


@pytest.mark.parametrize("dt_s", [1e-4, 0.01, 0.1, 1.0, 30.0])
@pytest.mark.parametrize("f", [F, (-9.0, 0.0, PSI / J, -VISCOUS / J), (0.0, 1.0, 0.0, 0.0), (-1e4, 0.0, 130.0, 0.0)])
def test_discretisation_is_scipys(f: tuple[float, float, float, float], dt_s: float) -> None:
    """Phi and the integral against the exponential of the augmented matrix, singular F and stiff ones included."""
    m = np.zeros((4, 4))
    m[:2, :2], m[:2, 2:] = np.reshape(f, (2, 2)), np.eye(2)
    expected = expm(m * dt_s)
    phi, total = discretise(f, dt_s)
    assert np.reshape(phi, (2, 2)) == pytest.approx(expected[:2, :2], rel=1e-9, abs=1e-12)
    assert np.reshape(total, (2, 2)) == pytest.approx(expected[:2, 2:], rel=1e-9, abs=1e-12)


def test_eulers_matrix_diverges() -> None:
    """I + F dt at 0.1 s has the eigenvalue -8.99: a constant command ends beyond 1e17 A, by the exact one at U/R."""
    euler = np.eye(2) + np.reshape(F, (2, 2)) * 0.1
    assert min(np.linalg.eigvals(euler).real) == pytest.approx(-8.99, abs=0.01)
    phi, total = discretise(F, 0.1)
    x, y = np.zeros(2), np.zeros(2)
    for _ in range(20):
        x = euler @ x + 0.1 * np.array([1.0 / L, 0.0])
        y = np.reshape(phi, (2, 2)) @ y + np.reshape(total, (2, 2)) @ np.array([1.0 / L, 0.0])
    assert abs(x[0]) > 1e17
    assert 0.0 < y[0] < 1.0 / R


def test_filter_is_the_textbook_one() -> None:
    """Thirty steps against (15) in numpy, with the measurement noise and walks of the filter."""
    rng = np.random.default_rng(2)
    filter_ = PaperFilter(F, 1.0 / L, COULOMB / J, 1e-3, 0.05)
    filter_.restart(0.1, 50.0)
    phi, total = (np.reshape(m, (2, 2)) for m in discretise(F, 0.01))
    x, p, r = np.array([0.1, 50.0]), np.diag([1e-6, 0.0025]), np.diag([1e-6, 0.0025])
    for _ in range(30):
        u, y = rng.uniform(1.0, 3.0), np.array([0.3, 50.0]) + rng.standard_normal(2) * [1e-3, 0.05]
        x = phi @ x + total @ np.array([u / L, -COULOMB / J * math.tanh(x[1] / 0.1)])
        p = phi @ p @ phi.T + np.diag([4e-8, 4.5e-7])
        gain = p @ np.linalg.inv(p + r)
        x, p = x + gain @ (y - x), (np.eye(2) - gain) @ p
        filter_.step(0.01, float(u), float(y[0]), float(y[1]), True)
        assert (filter_.current_a, filter_.speed_rad_s) == pytest.approx(tuple(x), rel=1e-9)


@pytest.mark.parametrize(
    ("gain", "driver", "alarm"),
    [(1.0, 1.0, False), (0.6, 1.0, True), (1.0, 0.6, True)],
    ids=["sound", "torque", "driver"],
)
def test_residual_alarm(gain: float, driver: float, alarm: bool) -> None:
    """A torque or driver gain of 0.6 leaves a bias in the residual, a sound wheel does not; no cause is ever named."""
    model = ModelConfig(
        inertia_kgm2=((12.0, 0.0, 0.0), (0.0, 13.0, 0.0), (0.0, 0.0, 15.0)),
        wheel_inertia_kgm2=J,
        wheel_motor=WheelMotorConfig(),
    )
    monitor = WheelKalmanPaper(WheelKalmanPaperConfig(kind="wheel_kalman_paper"), Vehicle(model), 0.1)
    rng = np.random.default_rng(3)
    torque = 0.015
    w, current, seen = 100.0, torque / KT, []
    for k in range(1200):
        faulty = k >= 600
        noise = rng.standard_normal(2)
        reading = WheelReading(w + 0.05 * float(noise[0]), -current - 1e-3 * float(noise[1]))
        health = monitor.step(0.1, (reading, *[WheelReading()] * 3), (-torque, 0.0, 0.0, 0.0), None)  # type: ignore[arg-type]
        seen.append((health.alarm[0], health.kind[0]))
        for _ in range(10):
            aim = torque / KT * (driver if faulty else 1.0)
            mean = aim + (current - aim) * math.exp(-WD * 0.005)
            current = aim + (current - aim) * math.exp(-WD * 0.01)
            w += 0.01 / J * ((gain if faulty else 1.0) * KT * mean - COULOMB - VISCOUS * w)
    assert not any(a for a, _ in seen[:600])
    assert any(a for a, _ in seen[600:]) == alarm
    assert {kind for _, kind in seen} <= {0, 1}
