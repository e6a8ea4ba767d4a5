"""The parts of the practical detector one by one, against closed forms and laws of mechanics."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from bus.attitude import IDENTITY, exp_map
from fsw.gyro_fdi.classification import Classifier, FaultKind, average_blocks
from fsw.gyro_fdi.momentum_filter import MomentumFilter
from fsw.gyro_fdi.parity import Frame, Healthy, Parity, interpolate
from fsw.gyro_fdi.plausibility import Plausibility, bound_acceleration
from fsw.gyro_fdi.recovery import AxisRecovery, AxisState
from fsw.settings import ModelConfig
from fsw.vehicle import Vehicle

J = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))
TICK_S = 0.05
ZERO = (0.0, 0.0, 0.0)
HEALTHY = Healthy(2.91e-5, 1.5e-5, 1e-3, (5e-5, 5e-5, 2.5e-4))
NO_AXIS = (False, False, False)


def test_momentum_filter_follows_the_free_body() -> None:
    """Wheels held, no star tracker: 20 s of Euler's equations, against scipy to 1e-5 rad/s."""
    h = (0.8, -0.5, 0.3)
    start = (0.02, -0.03, 0.01)
    j = np.array(J)

    def slope(_t: float, w: np.ndarray) -> np.ndarray:
        return np.linalg.solve(j, -np.cross(w, j @ w + np.array(h)))

    exact = solve_ivp(slope, (0.0, 20.0), start, "DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    momentum = MomentumFilter(J, 0.6, True)
    momentum.start(IDENTITY, start, h)
    for _ in range(400):
        momentum.propagate(h, TICK_S)
    assert np.abs(np.array(momentum.omega_bi_b_rad_s) - exact).max() < 1e-5


def test_wheel_torque_of_any_kind_shows_at_once_in_the_rate() -> None:
    """At rest, momentum moved into a wheel is rate gained by the body in the same tick: w = -J^-1 dh, no model of why."""
    momentum = MomentumFilter(J, 0.6, True)
    momentum.start(IDENTITY, ZERO, ZERO)
    dh = (0.01, -0.02, 0.03)
    momentum.propagate(dh, TICK_S)
    assert momentum.omega_bi_b_rad_s == pytest.approx(tuple(np.linalg.solve(np.array(J), -np.array(dh))), rel=1e-12)


def test_star_frames_find_rate_and_external_torque() -> None:
    """A constant external torque that nobody announced: rate error below 1e-6 rad/s once the filter has learnt it."""
    momentum, torque = MomentumFilter(J, 0.6, True), np.array([0.004, 0.0, 0.0])
    momentum.start(IDENTITY, ZERO, ZERO)
    h = np.zeros(3)
    for k in range(1, 1601):
        # Wheels that absorb the torque: the body stands still while momentum grows.
        h = h + torque * TICK_S
        momentum.propagate(tuple(h.tolist()), TICK_S)
        if k % 5 == 0:
            momentum.correct(IDENTITY)
    assert np.abs(np.array(momentum.omega_bi_b_rad_s)).max() < 1e-6


@pytest.mark.parametrize("star_period_s", [0.1, 0.25, 0.5, 1.0])
def test_rate_error_dies_out_at_every_star_rate(star_period_s: float) -> None:
    """The star correction is stable with frames 0.1 to 1 s apart, on a turning body with wheel momentum."""
    w, h = np.array([0.05, -0.04, 0.06]), np.zeros(3)
    momentum = MomentumFilter(J, 0.6, True)
    # Momentum of the wheels is such that the body turns uniformly about a fixed axis: J w + h = 0.
    h = -np.array(J) @ w
    momentum.start(IDENTITY, tuple((w + 0.005).tolist()), tuple(h.tolist()))
    every = round(star_period_s / TICK_S)
    for k in range(1, 2401):
        momentum.propagate(tuple(h.tolist()), TICK_S)
        if k % every == 0:
            x, y, z, s = Rotation.from_rotvec(w * k * TICK_S).as_quat().tolist()
            momentum.correct((s, x, y, z))
    assert np.abs(np.array(momentum.omega_bi_b_rad_s) - w).max() < 1e-6


def test_one_wild_frame_is_refused_and_four_are_believed() -> None:
    """A single glitch of 3 degrees is counted and ignored; an offset that stays is followed after three of them."""
    momentum = MomentumFilter(J, 0.6, True)
    momentum.start(IDENTITY, ZERO, ZERO)
    wild = exp_map((0.0, 0.05, 0.0))
    taken = []
    for k in range(1, 31):
        momentum.propagate(ZERO, TICK_S)
        if k % 5 == 0:
            taken.append(momentum.correct(wild if k >= 10 else IDENTITY))
    assert taken == [True, False, False, False, True, True]
    assert momentum.glitches == 3


def run_parity(
    error: tuple[float, float, float], seconds: float, noise_seed: int | None = 1
) -> list[tuple[float, int]]:
    """(time, axis) of every hit of a gyro with a constant error on a body turning at 0.02 rad/s."""
    rng = np.random.default_rng(noise_seed)
    rate = np.array([0.01, -0.015, 0.008])
    parity = Parity(HEALTHY, (0.25, 1.0, 4.0, 16.0), TICK_S, 6.0, 9.0)
    hits: list[tuple[float, int]] = []
    for k in range(1, round(seconds / TICK_S) + 1):
        noise = HEALTHY.arw_rad_sqrt_s / math.sqrt(TICK_S) * rng.normal(size=3)
        parity.integrate(tuple((rate + np.array(error) + noise).tolist()), tuple(rate.tolist()), TICK_S)
        if k % 5 == 0:
            wobble = Rotation.from_rotvec(HEALTHY.star_sigma_rad * rng.normal(size=3))
            star = Rotation.from_rotvec(rate * k * TICK_S) * wobble
            x, y, z, s = star.as_quat().tolist()
            found = parity.test(Frame((s, x, y, z), parity.mark(k)), NO_AXIS, NO_AXIS)
            hits += [(k * TICK_S, hit.axis) for hit in found]
    return hits


def test_parity_is_quiet_on_a_healthy_gyro() -> None:
    """Noise, bias and scale factor within bounds raise nothing in ten minutes."""
    assert run_parity((1e-5, -1e-5, 1e-5), 600.0) == []


@pytest.mark.parametrize(("axis", "size", "limit_s"), [(0, 0.01, 0.8), (1, -0.001, 3.5), (2, 0.0005, 20.0)])
def test_parity_names_the_axis(axis: int, size: float, limit_s: float) -> None:
    """The first hit is in time and on the axis at fault, with the sign either way."""
    error = [0.0, 0.0, 0.0]
    error[axis] = size
    hits = run_parity((error[0], error[1], error[2]), 30.0)
    assert hits[0][1] == axis
    assert hits[0][0] <= limit_s


def test_marks_between_ticks_are_on_the_way() -> None:
    """Interpolation at constant rate is the closed form, so a late frame is compared with its own instant."""
    parity = Parity(HEALTHY, (1.0,), 0.01, 6.0, 9.0)
    rate = (0.1, -0.2, 0.3)
    parity.integrate(rate, rate, 0.05)
    before = parity.mark(5)
    parity.integrate(rate, rate, 0.05)
    middle = interpolate(before, parity.mark(10), 8)
    assert middle.q_g == pytest.approx(exp_map((0.008, -0.016, 0.024)), abs=1e-12)
    assert middle.coast_rad == pytest.approx((0.008, -0.016, 0.024))


def test_acceleration_bound_is_the_worst_of_all_torque_signs() -> None:
    """The bound equals the largest component of J^-1 D0 tau over all sixteen corners of the torque limits."""
    d0 = np.array([[1, 0, 0, 3**-0.5], [0, 1, 0, 3**-0.5], [0, 0, 1, 3**-0.5]])
    corners = np.array([[1 if n >> i & 1 else -1 for i in range(4)] for n in range(16)]) * 0.1
    worst = np.abs(np.linalg.solve(np.array(J), d0 @ corners.T)).max()
    assert bound_acceleration(Vehicle(ModelConfig(inertia_kgm2=J))) == pytest.approx(worst, rel=1e-12)


def test_plausibility_sees_jumps_and_not_the_wheels() -> None:
    """Full wheel acceleration with noise is never suspect; a jump of 0.002 rad/s is, at once, on its axis, for 3 s."""
    rng = np.random.default_rng(3)
    plausibility = Plausibility(TICK_S, 0.006, 2.91e-5, 1e-6, 3.0)
    flags = []
    for k in range(1200):
        jump = 0.002 if k >= 800 else 0.0
        noise = 1.3e-4 * rng.normal(size=3)
        flags.append(plausibility.step((0.0044 * k * TICK_S + noise[0], noise[1] + jump, noise[2])))
    suspect = np.array(flags)
    assert not suspect[:800].any()
    assert suspect[800, 1]
    assert not suspect[:, [0, 2]].any()
    assert np.flatnonzero(suspect[:, 1])[-1] < 800 + round(4.5 / TICK_S)


def classify(signal: np.ndarray, noise: float = 1.5e-4) -> Classifier:
    rng = np.random.default_rng(11)
    classifier = Classifier(TICK_S, 20.0)
    for value in signal + noise * rng.normal(size=len(signal)):
        classifier.add(float(value))
    return classifier


@pytest.mark.parametrize("size", [0.0005, -0.01, 0.1])
def test_constant_faults_are_called_constant(size: float) -> None:
    """Size to 2e-5 rad/s, the standard error of 20 s of noise, whatever the sign."""
    verdict = classify(np.full(600, size)).verdict
    assert verdict.kind == FaultKind.CONSTANT
    assert verdict.magnitude_rad_s == pytest.approx(size, abs=3e-5)


@pytest.mark.parametrize(("amplitude", "frequency"), [(0.05, 0.5), (0.05, 2.0), (0.05, 5.0), (0.01, 0.5), (0.002, 2.0)])
def test_sinusoids_are_called_periodic(amplitude: float, frequency: float) -> None:
    """Frequency within 0.5 %, amplitude within 2 % (0.2 % and 0.5 % for the strong ones), offset and phase unknown."""
    t = np.arange(600) * TICK_S
    verdict = classify(0.003 * amplitude + amplitude * np.sin(frequency * t + 0.7)).verdict
    strong = amplitude >= 0.05
    assert verdict.kind == FaultKind.PERIODIC
    assert verdict.frequency_rad_s == pytest.approx(frequency, rel=0.002 if strong else 0.005)
    assert verdict.magnitude_rad_s == pytest.approx(amplitude, rel=0.005 if strong else 0.02)


def test_a_slow_sinusoid_is_open_at_first_and_found_later() -> None:
    """0.05 rad/s: a sixth of a period in 20 s is no frequency; after two minutes it is one, within 0.5 %."""
    t = np.arange(3600) * TICK_S
    signal = 0.05 * np.sin(0.05 * t)
    assert classify(signal[:600]).verdict.kind == FaultKind.OTHER
    verdict = classify(signal).verdict
    assert verdict.kind == FaultKind.PERIODIC
    assert verdict.frequency_rad_s == pytest.approx(0.05, rel=0.005)


def test_ramps_and_noise_are_neither() -> None:
    """A ramp and a tenfold noise are called other, not constant and not periodic."""
    t = np.arange(600) * TICK_S
    assert classify(1e-3 * t).verdict.kind == FaultKind.OTHER
    assert classify(np.zeros(600), 2e-3).verdict.kind == FaultKind.OTHER


def test_blocks_keep_the_mean() -> None:
    """Averaging for long windows is the plain mean of neighbours."""
    assert average_blocks([1.0, 3.0, 5.0, 7.0, 100.0], 2) == [2.0, 6.0]


def test_axis_goes_through_its_states() -> None:
    """Suspect and back by itself; alarm stays until the fault estimate has been small for the time asked for."""
    axis = AxisRecovery(TICK_S, 2.91e-5, 2e-4, 2.0, 30.0)

    def live(seconds: float, fault: float, **flags: bool) -> None:
        for _ in range(round(seconds / TICK_S)):
            axis.observe(fault)
            axis.decide(
                0.0, flags.get("suspect", False), flags.get("alarm", False), flags.get("dead", False),
                flags.get("classified", False), 0.0,
            )  # fmt: skip

    live(1.0, 0.0, suspect=True)
    assert axis.state == AxisState.SUSPECT
    live(0.05, 0.0)
    assert axis.state == AxisState.NOMINAL
    live(0.05, 0.01, alarm=True)
    live(20.0, 0.01, classified=True)
    assert axis.state == AxisState.CLASSIFIED
    live(29.0, 0.0)
    assert axis.in_alarm
    live(8.0, 0.0)
    assert axis.state == AxisState.NOMINAL
    live(0.05, 0.0, dead=True)
    live(100.0, 0.0, dead=True)
    assert axis.in_alarm
