"""The pieces of the flight algorithms against closed forms, numpy and scipy."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bus.errors import ConfigError, StepSizeError
from bus.units import Vec3, Vec4
from fsw.allocators.pseudo_inverse import PseudoInverse
from fsw.allocators.settings import PseudoInverseConfig
from fsw.controllers.braking_profile import BrakingProfile
from fsw.controllers.settings import BrakingProfileConfig, SmcConfig
from fsw.controllers.smc import SlidingMode
from fsw.estimation.direct import Direct
from fsw.estimation.settings import DirectConfig
from fsw.guidance.guidance import HYSTERESIS_Q0, Guidance
from fsw.observers.ilo import GAP_PERIODS, Ilo, scale_gains
from fsw.observers.settings import IloConfig
from fsw.records import HEALTHY, PointingError, Sensors, WheelHealth
from fsw.rotation import turn
from fsw.settings import ModelConfig
from fsw.vehicle import Vehicle, invert_inertia

J = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))
MODEL = ModelConfig(inertia_kgm2=J)
VEHICLE = Vehicle(MODEL)
ZERO: Vec3 = (0.0, 0.0, 0.0)
D0 = np.hstack([np.eye(3), np.full((3, 1), 1.0 / np.sqrt(3.0))])
RNG = np.random.default_rng(7)


def random_vector(size: int, scale: float = 1.0) -> tuple[float, ...]:
    return tuple((scale * RNG.standard_normal(size)).tolist())


# -- allocation ----------------------------------------------------------------------------------------------------


def allocate(saturation: str, demand: Vec3) -> Vec4:
    config = PseudoInverseConfig(kind="pseudo_inverse", saturation=saturation)  # type: ignore[arg-type]
    return PseudoInverse(config, VEHICLE, 0.1).allocate(demand, HEALTHY).tau_rw_nm


def test_direction_preserving_allocation_keeps_the_direction() -> None:
    """Scaled, not bent: the body torque is parallel to the demand and one wheel is at its limit; clipping bends it."""
    demand = (0.3, -0.2, 0.1)
    keeping, clipping = allocate("direction", demand), allocate("clip", demand)
    assert max(map(abs, keeping)) == pytest.approx(0.1, rel=1e-12)
    assert np.linalg.norm(np.cross(D0 @ keeping, demand)) < 1e-15
    assert np.linalg.norm(np.cross(D0 @ clipping, demand)) > 1e-3


# -- iterative learning observer -----------------------------------------------------------------------------------


def test_inertia_inverse_is_numpys_and_refuses_nonsense() -> None:
    """Cofactor inverse against numpy; an inertia that is not positive definite is refused with its minors."""
    assert np.allclose(invert_inertia(J), np.linalg.inv(J), rtol=1e-14)
    with pytest.raises(ConfigError, match="not positive definite"):
        invert_inertia(((1.0, 2.0, 0.0), (2.0, 1.0, 0.0), (0.0, 0.0, 1.0)))


def test_observer_is_eqs_12_and_13_written_with_matrices() -> None:
    """Ten steps against the equations in numpy, wheel momentum included."""
    config = IloConfig(kind="ilo")
    observer = Ilo(config, VEHICLE, config.period_s)
    w_hat, wt, v = None, np.zeros(3), np.zeros(3)
    for _ in range(10):
        w, tau, h = (np.array(random_vector(3, s)) for s in (0.02, 0.1, 0.5))
        if w_hat is None:
            w_hat = w.copy()
        else:
            slope = -np.cross(w_hat, np.array(J) @ w_hat + h) + config.lambda_nm_s * wt + tau + v
            w_hat = w_hat + 0.1 * np.linalg.solve(J, slope)
            before, wt = wt, w - w_hat
            v = config.k1 * v + config.k2 * wt + config.k3 * before
        got = observer.step(0.1, tuple(w.tolist()), tuple(tau.tolist()), tuple(h.tolist()))
        assert got == pytest.approx(v, abs=1e-12)


@pytest.mark.parametrize("wheel_momentum", [False, True])
def test_observer_counts_wheel_momentum_only_when_told(wheel_momentum: bool) -> None:
    """With the paper's model the wheel momentum handed in changes nothing."""
    model = replace(MODEL, wheel_momentum=wheel_momentum)
    results = []
    for h in (ZERO, (2.0, -1.0, 0.5)):
        observer = Ilo(IloConfig(kind="ilo"), Vehicle(model), 0.1)
        for _ in range(3):
            v = observer.step(0.1, (0.01, 0.02, -0.01), ZERO, h)
        results.append(v)
    assert (results[0] == results[1]) is not wheel_momentum


@pytest.mark.parametrize("period_s", [0.0, 0.0989, 0.1011, 0.01, math.nan])
def test_observer_refuses_another_period(period_s: float) -> None:
    """Gains belong to a period: a control period more than 1 % off, or not a number, is refused, naming the gains' own."""
    with pytest.raises(StepSizeError, match=r"period_s = 0\.1 s"):
        Ilo(IloConfig(kind="ilo"), VEHICLE, period_s)
    for near_s in (0.09901, 0.10099):
        Ilo(IloConfig(kind="ilo"), VEHICLE, near_s)


def fly_observer(observer: Ilo, steps_s: list[float]) -> list[Vec3]:
    """Fault torques of the same signals sampled at the given steps."""
    t_s, found = 0.0, []
    for dt_s in steps_s:
        t_s += dt_s
        rate = (1e-3 * math.sin(t_s), 2e-3 * math.cos(0.7 * t_s), -5e-4 * t_s)
        found.append(observer.step(dt_s, rate, (0.02, -0.01, 0.005), (0.3, -0.2, 0.1)))
    return found


@pytest.mark.parametrize("periods", [2, 3, 5])
def test_observer_after_lost_ticks_is_one_of_the_longer_period(periods: int) -> None:
    """A step over several periods gives what an observer made for that period gives, gains scaled; unscaled ones do not."""
    long_s = 0.1 * periods
    native = Ilo(scale_gains(IloConfig(kind="ilo"), long_s), VEHICLE, long_s)
    stretched = Ilo(IloConfig(kind="ilo"), VEHICLE, 0.1)
    unscaled = Ilo(replace(IloConfig(kind="ilo"), period_s=long_s), VEHICLE, long_s)
    steps_s = [long_s] * 8
    expected = np.array(fly_observer(native, steps_s))
    assert np.array(fly_observer(stretched, steps_s)) == pytest.approx(expected, rel=1e-9)
    assert np.abs(np.array(fly_observer(unscaled, steps_s)) - expected).max() > 0.01 * np.abs(expected).max()
    assert stretched.internals.restarts == 0


@pytest.mark.parametrize("dt_s", [0.1 * (GAP_PERIODS + 1.0), 0.0, -0.1, math.inf, math.nan])
def test_observer_starts_afresh_after_a_long_gap(dt_s: float) -> None:
    """Over more than GAP_PERIODS periods, or over no time at all, it takes the measured rate and reports no torque."""
    observer = Ilo(IloConfig(kind="ilo"), VEHICLE, 0.1)
    assert fly_observer(observer, [0.1] * 10)[-1] != ZERO
    assert observer.step(dt_s, (0.01, 0.02, 0.03), (0.02, -0.01, 0.005), ZERO) == ZERO
    assert observer.internals.omega_hat_b_rad_s == (0.01, 0.02, 0.03)


def test_observer_starts_afresh_when_its_rate_is_lost() -> None:
    """A rate error beyond 1 rad/s restarts it from the measurement, with zero torque, and is counted."""
    observer = Ilo(IloConfig(kind="ilo"), VEHICLE, 0.1)
    observer.step(0.1, ZERO, ZERO, ZERO)
    assert observer.step(0.1, (5.0, 0.0, 0.0), ZERO, ZERO) == ZERO
    assert observer.internals.restarts == 1
    assert observer.internals.omega_hat_b_rad_s == (5.0, 0.0, 0.0)


def estimate_step(config: IloConfig, until_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Response of v_x to a torque of 0.02 N m about x that starts at 0, on a body with J = 37 kg m^2."""
    model = ModelConfig(inertia_kgm2=((37.0, 0.0, 0.0), (0.0, 37.0, 0.0), (0.0, 0.0, 37.0)), wheel_momentum=False)
    observer = Ilo(config, Vehicle(model), config.period_s)
    t = np.arange(round(until_s / config.period_s)) * config.period_s
    return t, np.array([observer.step(config.period_s, (0.02 / 37.0 * s, 0.0, 0.0), ZERO, ZERO)[0] for s in t])


@pytest.mark.parametrize("period_s", [0.005, 0.01, 0.02, 0.05, 0.2])
def test_scaled_gains_keep_the_time_constant(period_s: float) -> None:
    """The delay of the estimate, the integral of (1 - v/u_f), is J/L = 37/140 s plus a period, at every period.

    For a step of torque the rate error settles at u_f/L, and the integral of u_f - v is J times that; half a period of
    hold on either side comes on top of it.
    """
    config = scale_gains(IloConfig(kind="ilo"), period_s)
    _, v = estimate_step(config, 8.0)
    assert v[-1] == pytest.approx(0.02, rel=2e-3)  # lambda takes 0.1/140 of it
    delay_s = float(np.sum(1.0 - v / v[-1])) * period_s
    assert delay_s == pytest.approx(37.0 / 140.0, abs=1.1 * period_s + 1e-3)
    assert (config.k2 + config.k3) / (1.0 - config.k1) == pytest.approx(140.0)
    assert math.log(config.k1) / period_s == pytest.approx(math.log(0.15) / 0.1)


def test_unscaled_gains_do_not() -> None:
    """At 100 Hz one noisy sample throws the estimate with the unscaled gains more than 4 times as far as with the scaled
    ones, which also rise as the stated ones do at 10 Hz."""
    unscaled = replace(IloConfig(kind="ilo"), period_s=0.01)
    scaled = scale_gains(IloConfig(kind="ilo"), 0.01)
    jumps = []
    for config in (unscaled, scaled):
        observer = Ilo(config, VEHICLE, 0.01)
        observer.step(0.01, ZERO, ZERO, ZERO)
        jumps.append(max(abs(observer.step(0.01, (s, 0.0, 0.0), ZERO, ZERO)[0]) for s in (1e-6, 0.0)))
    assert jumps[0] > 4.0 * jumps[1] > 0.0
    reference = np.interp(0.3, *estimate_step(IloConfig(kind="ilo"), 2.0))
    assert abs(np.interp(0.3, *estimate_step(scaled, 2.0)) - reference) < 0.15 * 0.02


def test_scaling_handles_its_ends() -> None:
    """Same period: same gains. A pure integrator scales with the period. A period of zero is refused."""
    config = IloConfig(kind="ilo")
    assert scale_gains(config, 0.1) == config
    integrator = scale_gains(replace(config, k1=1.0), 0.02)
    assert (integrator.k1, integrator.k2, integrator.k3) == pytest.approx((1.0, 19.6, 4.2))
    with pytest.raises(ConfigError, match="> 0 s"):
        scale_gains(config, 0.0)


def test_noise_budget() -> None:
    """White rate noise of sigma a sample gives about 110 sigma N m on each axis of v at T = 0.1 s."""
    rng = np.random.default_rng(110)
    observer = Ilo(IloConfig(kind="ilo"), VEHICLE, 0.1)
    noise = (1e-5 * rng.standard_normal((20000, 3))).tolist()
    v = np.array([observer.step(0.1, tuple(w), ZERO, ZERO) for w in noise])
    assert v[100:].std(axis=0) == pytest.approx(1.1e-3 * np.ones(3), rel=0.1)


# -- sliding mode --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("law", "factor"), [("published", 1.0), ("lyapunov", 4.0)])
def test_sliding_mode_step_by_hand(law: str, factor: float) -> None:
    """One step against (33)-(35) in numpy, both denominators."""
    controller = SlidingMode(SmcConfig(kind="smc", beta_law=law), VEHICLE, 0.1)  # type: ignore[arg-type]
    q0, q, w, v = 0.8, np.array([0.36, -0.48, 0.0]), np.array([0.01, -0.02, 0.005]), np.array([0.01, 0.0, -0.02])
    s = w + 0.16 * q
    error = PointingError((q0, *q.tolist()), tuple(w.tolist()))  # type: ignore[arg-type]
    tau = controller.step(0.1, error, tuple(v.tolist()), HEALTHY)
    assert tau == pytest.approx(-5.6 * (s + v / 5.6))
    rate = -(0.4 * q @ s - 5.6 * 0.4 * w @ q) / (2.0 + 4.0 - factor * q0)
    assert controller.internals.beta == pytest.approx(0.4 + 0.1 * rate)


# -- braking profile -----------------------------------------------------------------------------------------------


def test_profile_stops_at_the_target_within_its_deceleration() -> None:
    """Along the profile, theta' = -f(theta): f f' is the planned deceleration, at most eta times the authority.

    f' is checked against the difference quotient of f, which rises with the angle and is zero at the target.
    """
    config = BrakingProfileConfig(kind="braking_profile")
    law = BrakingProfile(config, VEHICLE, 0.1)
    axis = (0.48, 0.6, 0.64)
    authority = VEHICLE.wheels.find_authority(tuple((np.array(J) @ axis).tolist()), VEHICLE.wheels.max_torque_nm)
    a = (1.0 - config.reserve) * authority[0] + config.reserve * authority[1]
    angles = np.linspace(0.0, math.pi, 20001)
    rates, slopes = np.array([law._plan(float(theta), axis, HEALTHY) for theta in angles]).T
    assert rates[0] == 0.0
    assert np.all(np.diff(rates) > 0.0)
    assert np.all(rates * slopes <= a * config.eta * (1.0 + 1e-9))
    assert slopes[1:-1] == pytest.approx(np.gradient(rates, angles)[1:-1], rel=5e-3)


def test_profile_shrinks_when_wheels_are_lost() -> None:
    """Wheels thought to give half as much lower the planned rate at the same angle by 1/sqrt(2); adapt off: not at all."""
    error = PointingError((math.cos(0.5), math.sin(0.5) * 0.6, math.sin(0.5) * 0.8, 0.0), ZERO)
    weak = WheelHealth((0.5, 0.5, 0.5, 0.5))
    for adapt, part in ((True, math.sqrt(0.5)), (False, 1.0)):
        config = BrakingProfileConfig(kind="braking_profile", adapt=adapt, k_theta=20.0, spent=0.0)
        law = BrakingProfile(config, VEHICLE, 0.1)
        rates = []
        for health in (HEALTHY, weak, HEALTHY):
            law.step(0.1, error, ZERO, health)
            rates.append(law.internals.profile_rad_s)
        # k_theta is so large that the linear part is negligible: the rate goes as the root of the deceleration.
        assert rates[1] == pytest.approx(part * rates[0], rel=1e-3)
        assert rates[2] == rates[0]


# -- guidance ------------------------------------------------------------------------------------------------------


def from_scipy(rotation: Rotation) -> Vec4:
    x, y, z, w = rotation.as_quat().tolist()
    return (w, x, y, z)


def test_error_quaternion_is_scipys() -> None:
    """q_tb = q_it^-1 q_ib up to sign, with q0 >= 0 on the first call; the target need not be normalised."""
    for seed in range(20):
        target, body = Rotation.random(2, random_state=seed)
        scaled = tuple(3.0 * x for x in from_scipy(target))
        error = Guidance(scaled).find_error(from_scipy(body), ZERO).q_tb  # type: ignore[arg-type]
        expected = np.array(from_scipy(target.inv() * body))
        assert error == pytest.approx(expected * math.copysign(1.0, expected[0]), abs=1e-12)


def test_error_sign_has_hysteresis() -> None:
    """Wobbling across the half turn does not flip the error; going well past it does, and then it stays flipped."""
    guidance = Guidance((1.0, 0.0, 0.0, 0.0))

    def q_of(q0: float) -> Vec4:
        return (q0, math.sqrt(1.0 - q0 * q0), 0.0, 0.0)

    assert guidance.find_error(q_of(0.02), ZERO).q_tb[1] > 0.0
    for k in range(50):
        assert guidance.find_error(q_of(0.05 * (-1) ** k), ZERO).q_tb[1] > 0.0
    assert guidance.find_error(q_of(-HYSTERESIS_Q0 - 0.01), ZERO).q_tb[1] < 0.0
    assert guidance.find_error(q_of(0.05), ZERO).q_tb[1] < 0.0
    guidance.reset()
    assert guidance.find_error(q_of(0.05), ZERO).q_tb[1] > 0.0


def test_zero_target_is_refused() -> None:
    with pytest.raises(ConfigError, match="no attitude"):
        Guidance((0.0, 0.0, 0.0, 0.0))


# -- direct estimator ----------------------------------------------------------------------------------------------


def make_sensors(tick: int, q: Vec4, omega: Vec3, **changes: Any) -> Sensors:
    settings = {"star_new": True, "star_valid": True} | changes
    return Sensors(tick=tick, t_s=0.1 * tick, omega_meas_b_rad_s=omega, q_ib_meas=q, **settings)


@pytest.mark.parametrize("rate", [0.0, 1e-7, 1e-3, 0.02, 1.0, 5.0])
def test_turn_is_scipys(rate: float) -> None:
    """q exp(omega dt / 2) against scipy's rotation vectors, on both sides of the change to series at small angles."""
    omega = (0.48 * rate, -0.6 * rate, 0.64 * rate)
    start = Rotation.random(random_state=3)
    expected = np.array(from_scipy(start * Rotation.from_rotvec(np.array(omega) * 0.1)))
    got = np.array(turn(from_scipy(start), *(0.1 * w for w in omega)))
    assert got * math.copysign(1.0, got @ expected) == pytest.approx(expected, abs=1e-15)


def test_fresh_attitude_passes_digit_for_digit() -> None:
    """Ideal sensors, age zero: the estimate is the measurement, bit for bit, and valid."""
    q = (0.8510644963469901, 0.25031308716087947, -0.30037570459305535, 0.35043832202523123)
    estimate = Direct(DirectConfig(kind="direct"), VEHICLE, 0.1).step(make_sensors(0, q, (0.01, 0.02, 0.03)))
    assert estimate.q_ib == q
    assert estimate.valid


def test_attitude_is_carried_between_and_over_age() -> None:
    """Under constant rate, star tracker at 1 Hz and 0.05 s old: the estimate is the true attitude on every tick."""
    omega = (0.02, -0.03, 0.01)
    estimator = Direct(DirectConfig(kind="direct"), VEHICLE, 0.1)
    for tick in range(40):
        true = Rotation.from_rotvec(np.array(omega) * 0.1 * tick)
        old = Rotation.from_rotvec(np.array(omega) * (0.1 * tick - 0.05))
        new = tick % 10 == 0
        estimate = estimator.step(make_sensors(tick, from_scipy(old), omega, star_new=new, star_age_s=0.05))
        assert abs(np.dot(estimate.q_ib, from_scipy(true))) == pytest.approx(1.0, abs=1e-12)


def test_direct_estimate_is_invalid_without_its_sensors() -> None:
    """Before the first attitude, with a stale star tracker, or with a bad gyro axis: not fit for pointing."""
    q = (1.0, 0.0, 0.0, 0.0)
    estimator = Direct(DirectConfig(kind="direct"), VEHICLE, 0.1)
    assert not estimator.step(make_sensors(0, q, ZERO, star_new=False)).valid
    assert estimator.step(make_sensors(1, q, ZERO)).valid
    assert not estimator.step(make_sensors(2, q, ZERO, star_new=False, star_valid=False)).valid
    assert not estimator.step(make_sensors(3, q, ZERO, gyro_valid=(True, False, True))).valid
    estimator.reset()
    assert not estimator.step(make_sensors(4, q, ZERO, star_new=False)).valid
