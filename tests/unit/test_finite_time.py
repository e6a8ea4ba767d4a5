"""The finite-time law of Li & Liu 2011, (14) and its forms B and C: recorded torques and flights, Lyapunov functions,
the homogeneity that its finite time and its limit cycle follow from, tracking, and settling times known from elsewhere."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import hyp2f1

from bus.attitude import canonical, dcm_from_quaternion, exp_map, multiply, quaternion_from_mrp, rotate_back
from bus.errors import ConfigError
from bus.linear import add, cross, scale, subtract, times
from bus.units import Vec3
from fsw.controllers.finite_time import FiniteTime
from fsw.controllers.latency import Latency
from fsw.controllers.settings import FiniteTimeConfig
from fsw.guidance.guidance import feed_forward
from fsw.records import HEALTHY, PointingError
from fsw.settings import ModelConfig
from fsw.vehicle import Vehicle
from tools.design.finite_time_loop import (
    INERTIA,
    SMALL,
    START_Q,
    START_RATE,
    Body,
    Floats,
    Flown,
    draw_start,
    draw_trials,
    find_trial_settling,
    fly_continuous,
    fly_sampled,
    last_above,
    make_law,
)

DATA = Path(__file__).resolve().parents[1] / "data" / "control"
RECORD = np.load(DATA / "ft_functions.npz")
ZERO: Vec3 = (0.0, 0.0, 0.0)
J = np.array(INERTIA)
K1, K2 = 6.0, 10.0


def law(**settings: Any) -> Any:
    """Form A with the paper's gains unless it is said otherwise."""
    return make_law({"kind": "finite_time", "k1": K1, "k2": K2} | settings)


def point(sigma: Any, omega: Any) -> PointingError:
    return PointingError(quaternion_from_mrp(tuple(sigma)), tuple(omega))


def step(controller: Any, error: PointingError, fault: Vec3 = ZERO) -> Floats:
    return np.array(controller.step(0.1, error, fault, HEALTHY))


# -- the law ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "settings"), [("A", {}), ("B", {"form": "B"}), ("C", {"form": "C"}), ("A_a1", {"alpha1": 1.0})]
)
def test_forms_give_the_recorded_torques(key: str, settings: dict[str, Any]) -> None:
    """100 random states, torques of an independent implementation, to 1e-12."""
    controller = law(**settings)
    for s, w, tau in zip(RECORD["sigma"].tolist(), RECORD["omega"].tolist(), RECORD[f"tau_{key}"], strict=True):
        assert step(controller, point(s, w)) == pytest.approx(tau, abs=1e-12)


def test_implicit_form_solves_its_equation() -> None:
    """Accelerations recorded from an independent solution to 1e-9; and put back, the equation holds."""
    controller = law(sampling="implicit", k1=1.0, k2=4.0)
    assert isinstance(controller, FiniteTime)
    record = RECORD["acc_impl14_Ts01_k1_1_k2_4_a05_J45"]
    for s, w, recorded in zip(RECORD["sigma"].tolist(), RECORD["omega"].tolist(), record, strict=True):
        found = [controller.find_acceleration(a, b, 45.0) for a, b in zip(s, w, strict=True)]
        assert found == pytest.approx(recorded, abs=1e-9)
        end = np.array(w) + 0.1 * np.array(found)
        x, y = np.array(s) + 0.025 * end, end
        right = -(np.sign(x) * np.abs(x) ** 0.5 + 4.0 * np.sign(y) * np.abs(y) ** (2.0 / 3.0)) / 45.0
        assert found == pytest.approx(right, abs=1e-9)


def test_implicit_torque_is_that_of_the_axes() -> None:
    """J_ii times the acceleration of each axis, no coupling: what (14) says for each axis."""
    controller = law(sampling="implicit")
    s, w = (0.1, -0.2, 0.05), (0.01, 0.02, -0.03)
    expected = [J[i, i] * controller.find_acceleration(s[i], w[i], J[i, i]) for i in range(3)]
    assert step(controller, point(s, w)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("form", ["B", "C"])
def test_implicit_is_refused_where_axes_are_coupled(form: str) -> None:
    """The message names the key, the form and both ways on."""
    with pytest.raises(ConfigError, match=rf"fsw.controller.sampling.*form {form} .*form: A or sampling: explicit"):
        law(form=form, sampling="implicit")


def test_fault_torque_is_made_up_for() -> None:
    """The observer's torque comes off, to the last bit."""
    error = point((0.1, -0.2, 0.05), (0.01, 0.02, -0.03))
    assert step(law(), error, (0.01, -0.02, 0.03)) == pytest.approx(
        step(law(), error) - np.array((0.01, -0.02, 0.03)), abs=1e-15
    )


def test_gyroscopic_torque_is_left_out_where_the_wheels_carry_the_momentum() -> None:
    """With model.wheel_momentum the total momentum is what counts, and w x J w alone would be wrong by h."""
    settings = {"kind": "finite_time", "gyroscopic": True}
    error = point(ZERO, (0.2, -0.1, 0.3))
    extra = step(make_law(settings), error) - step(make_law({"kind": "finite_time"}), error)
    w = np.array(error.omega_bt_b_rad_s)
    assert extra == pytest.approx(np.cross(w, J @ w), abs=1e-12)
    config = FiniteTimeConfig(kind="finite_time", gyroscopic=True)
    real = FiniteTime(config, Vehicle(ModelConfig(inertia_kgm2=INERTIA, wheel_momentum=True)), 0.1)
    assert step(real, error) == pytest.approx(step(make_law({"kind": "finite_time"}), error), abs=1e-15)


# -- flights in continuous time ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["A", "C"])
def test_flight_is_the_recorded_one(form: str) -> None:
    """30 s from 63.6 deg in steps of 0.01 s against an independent integration at 1e-4 s: 1e-6 in parameters and rate."""
    record = np.load(DATA / f"ft14{form}_J000.npz")
    flown = fly_continuous(law(form=form), Body(), 30.0, 1e-2, every=5)
    assert np.abs(flown.sigma - record["sigma"]).max() < 1e-6
    assert np.abs(flown.omega_rad_s - record["omega"]).max() < 1e-6


def test_pd_flight_agrees_with_scipy() -> None:
    """alpha1 = 1 is tau = -k1 sigma - k2 omega (the paper's note 2): the flight is scipy's of these equations, to 1e-6."""

    def rates(t: float, x: Floats) -> Floats:
        s, w = x[:3], x[3:]
        k = np.array(((0.0, -s[2], s[1]), (s[2], 0.0, -s[0]), (-s[1], s[0], 0.0)))
        g = 0.25 * ((1.0 - s @ s) * np.eye(3) + 2.0 * k + 2.0 * np.outer(s, s))
        return np.concatenate((g @ w, np.linalg.solve(J, -np.cross(w, J @ w) - K1 * s - K2 * w)))

    flown = fly_continuous(law(alpha1=1.0), Body(), 30.0, 1e-2, every=5)
    start = np.concatenate((flown.sigma[0], START_RATE))
    known = solve_ivp(rates, (0.0, 30.0), start, "DOP853", flown.t_s[::20], rtol=1e-12, atol=1e-14)
    assert flown.sigma[::20] == pytest.approx(known.y[:3].T, abs=1e-6)
    assert flown.omega_rad_s[::20] == pytest.approx(known.y[3:].T, abs=1e-6)


def test_settling_times_and_decades_of_powers_below_one() -> None:
    """1e-5 at 20.95, 20.8 and 22.25 s for A, B and C; the next three decades take less time than the two before."""
    for form, expected in (("A", 20.95), ("B", 20.8), ("C", 22.25)):
        flown = fly_continuous(law(form=form), Body(), 25.0, 1e-2, every=5)
        three, five, eight = (flown.find_settling(level) for level in (1e-3, 1e-5, 1e-8))
        assert five == pytest.approx(expected, abs=0.1)
        assert eight - five < five - three
    flown = fly_continuous(law(), Body(inertia=SMALL), 22.0, 1e-2, every=5)
    assert flown.find_settling(1e-3) == pytest.approx(14.45, abs=0.1)
    assert flown.find_settling(1e-5) == pytest.approx(17.9, abs=0.1)


@pytest.mark.parametrize("form", ["A", pytest.param("C", marks=pytest.mark.slow)])
def test_pd_takes_its_time_for_every_decade(form: str) -> None:
    """alpha1 = 1: 1e-5 at 99.35 s (form A), and the next three decades take 1.4 times as long as the two before."""
    flown = fly_continuous(law(form=form, alpha1=1.0), Body(), 170.0, 5e-2, every=1)
    three, five, eight = (flown.find_settling(level) for level in (1e-3, 1e-5, 1e-8))
    assert five == pytest.approx(99.35, abs=0.1)
    assert eight - five > 1.4 * (five - three)


def find_v(flown: Flown, alpha1: float) -> Floats:
    """The Lyapunov function of forms A and B."""
    power: Floats = (np.abs(flown.sigma) ** (1.0 + alpha1)).sum(axis=1)
    return 4.0 * K1 / (1.0 + alpha1) * power + find_energy(flown)


def find_energy(flown: Flown) -> Floats:
    energy: Floats = 0.5 * np.einsum("ni,ij,nj->n", flown.omega_rad_s, J, flown.omega_rad_s)
    return energy


@pytest.mark.parametrize(
    ("alpha1", "end_s", "slope"),
    [
        (0.5, 23.0, 0.843),
        pytest.param(0.7, 46.8, 0.930, marks=pytest.mark.slow),
        pytest.param(0.3, 15.8, None, marks=pytest.mark.slow),
        (1.0, None, 1.007),
    ],
)
def test_time_to_zero_is_finite(alpha1: float, end_s: float | None, slope: float | None) -> None:
    """V' ~ -V^(1 + k/2), k = (alpha1 - 1)/(alpha1 + 1): V^(-k/2) falls along a line to zero, at a time that is there only
    below one. Slopes and times of an independent integration; the line is fitted from V = 1e-2 to 1e-12."""
    step_s = 5e-2 if end_s is None else 5e-3
    flown = fly_continuous(law(alpha1=alpha1), Body(), 120.0 if end_s is None else end_s, step_s, every=1)
    v, k = find_v(flown, alpha1), (alpha1 - 1.0) / (1.0 + alpha1)
    loss = K2 * (np.abs(flown.omega_rad_s) ** (1.0 + 2.0 * alpha1 / (1.0 + alpha1))).sum(axis=1)
    used = (v > 1e-12) & (v < 1e-2)
    if slope is not None:
        assert np.polyfit(np.log(v[used]), np.log(loss[used]), 1)[0] == pytest.approx(slope, abs=0.02)
    if end_s is not None:
        falls, at_zero = np.polyfit(flown.t_s[used], v[used] ** (-k / 2.0), 1)
        assert -at_zero / falls == pytest.approx(end_s, abs=0.3)


def find_v_c(flown: Flown, alpha1: float) -> Floats:
    """The Lyapunov function of form C; its integral of s^a/(1 + s^2) is a hypergeometric function."""
    x = np.linalg.norm(flown.sigma, axis=1)
    a = alpha1 + 1.0
    integral: Floats = x**a / a * hyp2f1(1.0, a / 2.0, a / 2.0 + 1.0, -x * x)
    return 4.0 * K1 * integral + find_energy(flown)


def assert_v_never_rises(starts: int, seed: int, until_s: float) -> None:
    """Forms B and C, random attitudes up to the half turn and rates up to 1 rad/s an axis, through changes of the set."""
    rng = np.random.default_rng(seed)
    changes = 0
    for number in range(starts):
        q, w = draw_start(rng, 90.0, 180.0, 0.3 if number % 2 else 1.0)
        for form, v_of in (("B", find_v), ("C", find_v_c)):
            flown = fly_continuous(law(form=form), Body(q, w), until_s, 1e-2, every=1)
            v = v_of(flown, 0.5)
            assert np.diff(v).max() <= 1e-9 * v[0]
            changes += int((np.einsum("ni,ni->n", flown.sigma[1:], flown.sigma[:-1]) < -0.5).sum())
    assert changes >= max(1, starts // 5)


def test_lyapunov_functions_of_b_and_c_never_rise() -> None:
    """Three random starts each, some through the half turn: V is continuous there and falls everywhere."""
    assert_v_never_rises(3, 7, 7.0)


@pytest.mark.slow
def test_lyapunov_functions_of_b_and_c_never_rise_from_anywhere() -> None:
    """50 random starts."""
    assert_v_never_rises(50, 11, 12.0)


@pytest.mark.parametrize("alpha1", [0.5, 1.0])
def test_constant_torque_leaves_the_error_of_the_power(alpha1: float) -> None:
    """At rest k1 sig(sigma)^alpha1 balances a torque: sigma_i = (d_i/k1)^(1/alpha1), 3000 times less than with PD."""
    d = 2e-3
    flown = fly_continuous(law(alpha1=alpha1), Body(), 120.0, 5e-2, disturbance=lambda t: (d, -d, d), every=50)
    expected = (d / K1) ** (1.0 / alpha1)
    assert flown.sigma[-1] == pytest.approx((expected, -expected, expected), rel=0.02)


# -- tracking: theorem 2 -----------------------------------------------------------------------------------------------


def test_law_and_feed_forward_add_up_to_theorem_2() -> None:
    """Of random states: law with `gyroscopic` and the flight's feed-forward give w x J w - J (w_e x R w_d - R w_d')
    - k1 .. - k2 .., each term once."""
    rng = np.random.default_rng(3)
    plain, tracking = law(), law(gyroscopic=True)
    for _ in range(50):
        s, e, d, alpha = (tuple(rng.normal(0.0, 0.3, 3).tolist()) for _ in range(4))
        still = point(s, e)
        error = PointingError(still.q_tb, still.omega_bt_b_rad_s, d, alpha)
        w = add(e, d)
        total = add(tuple(step(tracking, error)), follow(error, w))  # type: ignore[arg-type]
        gyroscopic = np.cross(w, J @ np.array(w))
        expected = gyroscopic - J @ (np.cross(e, d) - np.array(alpha)) + step(plain, still)
        assert total == pytest.approx(expected, abs=1e-12)


def follow(error: PointingError, w: Vec3) -> Vec3:
    """The feed-forward of fsw/flight.py for a body without wheel momentum."""
    d = error.omega_ti_b_rad_s
    return add(times(INERTIA, feed_forward(error, w)), cross(d, times(INERTIA, d)))


def fly_after_target(
    controller: Any, amplitude_rad_s: float, until_s: float, feeds: bool = True
) -> tuple[Floats, Floats]:
    """Times and largest |sigma_e,i| behind a target that turns with a sine about a fixed axis, with the feed-forward."""
    axis, rate = (0.6, -0.48, 0.64), 0.2
    body, rows = Body(), []

    def find_error(t: float, q: Any, w: Any) -> PointingError:
        angle = amplitude_rad_s / rate * (1.0 - math.cos(rate * t))
        q_tb = canonical(multiply(exp_map(scale(axis, -angle)), q))
        about = rotate_back(q, axis)  # the axis stands still in inertial and in the target's axes alike
        d = scale(about, amplitude_rad_s * math.sin(rate * t))
        return PointingError(q_tb, subtract(w, d), d, scale(about, amplitude_rad_s * rate * math.cos(rate * t)))

    def torque(t: float, q: Any, w: Any) -> Vec3:
        error = find_error(t, q, w)
        tau = controller.step(0.1, error, ZERO, HEALTHY)
        return add(tau, follow(error, w)) if feeds else tau

    for k in range(round(until_s / 0.025) + 1):
        body.t_s = 0.025 * k
        if k % 2 == 0:
            q0, x, y, z = find_error(body.t_s, body.q, body.omega).q_tb
            rows.append((body.t_s, max(abs(x), abs(y), abs(z)) / (1.0 + q0)))
        body.advance(torque, 0.025)
    t_s, sizes = np.array(rows).T
    return t_s, sizes


def to_matrix(q: Any) -> Floats:
    return np.array(dcm_from_quaternion(q))


@pytest.mark.parametrize("amplitude_rad_s", [0.02, 0.3])
def test_turning_target_is_reached_in_finite_time(amplitude_rad_s: float) -> None:
    """The error's motion is that of J w_e' = -k1 .. - k2 .. whatever the target does: the same flight behind a slow and a
    fast one, by scipy from those equations. PD would still be above 1e-2 then."""
    t_s, sizes = fly_after_target(law(gyroscopic=True), amplitude_rad_s, 25.0)
    known = error_alone()
    assert sizes == pytest.approx(known, abs=2e-6)
    for level in (1e-3, 1e-5):
        assert last_above(t_s, sizes, level) == pytest.approx(last_above(t_s, known, level), abs=0.1)
    assert last_above(t_s, sizes, 1e-5) == pytest.approx(20.85, abs=0.1)
    assert last_above(t_s, sizes, 1e-7) < 22.6
    _, slow = fly_after_target(law(gyroscopic=True, alpha1=1.0), amplitude_rad_s, 25.0)
    assert slow[-1] > 1e-2


def error_alone() -> Floats:
    """Largest |sigma_e,i| of the error's own equations, at the times of fly_after_target."""

    def rates(t: float, x: Floats) -> Floats:
        s, w = x[:3], x[3:]
        k = np.array(((0.0, -s[2], s[1]), (s[2], 0.0, -s[0]), (-s[1], s[0], 0.0)))
        g = 0.25 * ((1.0 - s @ s) * np.eye(3) + 2.0 * k + 2.0 * np.outer(s, s))
        push = K1 * np.sign(s) * np.abs(s) ** 0.5 + K2 * np.sign(w) * np.abs(w) ** (2.0 / 3.0)
        return np.concatenate((g @ w, -np.linalg.solve(J, push)))

    start = np.concatenate((np.array(START_Q[1:]) / (1.0 + START_Q[0]), START_RATE))
    times_s = np.arange(0.0, 25.0 + 1e-9, 0.05)
    known = solve_ivp(rates, (0.0, 25.0), start, "RK45", times_s, rtol=1e-7, atol=1e-9)
    sizes: Floats = np.abs(known.y[:3]).max(axis=0)
    return sizes


@pytest.mark.slow
def test_what_a_target_needs_of_the_law() -> None:
    """Without `gyroscopic` the error goes another way, and to zero as well: what is missing vanishes with the rate error.
    Without feed-forward it does not: about ((J w_d' + w_d x J w_d)/k1)^2 is left."""
    t_s, sizes = fly_after_target(law(), 0.3, 25.0)
    assert np.abs(sizes - error_alone()).max() > 1e-3
    assert sizes[t_s > 24.0].max() < 1e-7
    t_s, sizes = fly_after_target(law(gyroscopic=True), 0.3, 40.0, feeds=False)
    assert 1e-2 < sizes[t_s > 25.0].max() < (2.0 * (50.0 * 0.06 + 12.0 * 0.09) / K1) ** 2


# -- sampled -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("latency", "sigma", "omega"), [(0, 2.80e-4, 4.71e-3), (1, 4.01e-2, 0.1175), (2, 0.3175, 0.538)]
)
def test_limit_cycle_grows_with_the_powers_of_the_period(latency: int, sigma: float, omega: float) -> None:
    """Explicit, held over T: twice the period makes the limit cycle 16 times as large in sigma and 8 times in rate, as
    homogeneity has it (T^4, T^3), with the factors of an independent integration."""
    sizes = []
    for period_s in (0.25, 0.5):
        flown = fly_sampled(law(), Body(), 60.0 + 100.0 * period_s, period_s, 1e3, latency=latency)
        last = flown.t_s > flown.t_s[-1] - 60.0 * period_s
        sizes.append((np.abs(flown.sigma[last]).max(), np.abs(flown.omega_rad_s[last]).max()))
    (s1, w1), (s2, w2) = sizes
    assert s2 / s1 == pytest.approx(16.0, abs=0.5)
    assert w2 / w1 == pytest.approx(8.0, abs=0.2)
    assert s1 / 0.25**4 == pytest.approx(sigma, rel=0.02)
    assert w1 / 0.25**3 == pytest.approx(omega, rel=0.02)


def test_implicit_form_has_no_limit_cycle() -> None:
    """The same gains at 0.5 s, where the explicit form keeps 1.7e-5: nothing is left."""
    flown = fly_sampled(
        make_law({"kind": "finite_time", "k1": K1, "k2": K2, "sampling": "implicit"}, 0.5), Body(), 60.0, 0.5, 1e3
    )
    assert np.abs(flown.sigma[-10:]).max() < 1e-14


@pytest.mark.parametrize("sampling", ["explicit", "implicit"])
def test_settles_with_small_wheels(sampling: str) -> None:
    """0.1 N m an axis, 0.1 s, k1 = 1, k2 = 4: within 0.01 deg by 65 s, and PD (6, 10) not before 120 s."""
    flown = fly_sampled(make_law({"kind": "finite_time", "sampling": sampling}), Body(), 90.0)
    assert 55.0 < flown.find_settling_deg(0.01) <= 65.0
    flown = fly_sampled(law(alpha1=1.0), Body(), 150.0)
    assert 120.0 <= flown.find_settling_deg(0.01) < 135.0


@pytest.mark.slow
def test_random_starts_settle_sooner_than_with_pd() -> None:
    """40 random starts with a true inertia 0.8 .. 1.2 times the modelled one: median of the 0.01 deg times at most 80 s, and
    of PD (6, 10) at least 110 s; the worst of the law is better than the median of PD."""
    trials = draw_trials(40, 1)
    found = find_trial_settling({"kind": "finite_time"}, trials, 0.01, 110.0)
    pd = find_trial_settling({"kind": "finite_time", "alpha1": 1.0, "k1": K1, "k2": K2}, trials, 0.01, 220.0)
    assert np.median(found) <= 80.0
    assert np.median(pd) >= 110.0
    assert max(found) < np.median(pd)
    assert all(a < b for a, b in zip(found, pd, strict=True))


# -- latency -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("samples", [1, 2, 5])
def test_law_looks_past_the_torques_on_their_way(samples: int) -> None:
    """A law told of its latency gives the torque that one without would give once the torques sent have acted on the body,
    integrated finely, with a disturbance that the observer knows; after a reset it has forgotten them."""
    rng = np.random.default_rng(samples)
    controller = law(latency=samples, sampling="explicit")
    for _ in range(20):
        q, w = draw_start(rng, 5.0, 90.0, 0.05)
        sent = [tuple(rng.uniform(-0.5, 0.5, 3).tolist()) for _ in range(samples)]
        fault = tuple(rng.uniform(-0.1, 0.1, 3).tolist())
        body = Body(q, w)
        for tau in sent:
            controller.note_sent(tau)
            for _ in range(10):
                body.advance(lambda t, q, w, tau=tau, fault=fault: add(tau, fault), 0.01)  # type: ignore[misc]
        expected = step(law(), PointingError(body.q, body.omega), fault)
        assert step(controller, PointingError(q, w), fault) == pytest.approx(expected, abs=2e-4)
        assert np.abs(step(law(), PointingError(q, w), fault) - expected).max() > 1e-2
    controller.reset()
    coasting = law(latency=samples)
    error = point((0.1, 0.2, -0.1), (0.01, 0.0, 0.02))
    assert step(controller, error) == pytest.approx(step(coasting, error), abs=0.0)


def test_prediction_follows_a_turning_target() -> None:
    """The error to a target that turns and gains speed, three periods on, against the exact motion of both."""
    latency = Latency(3, Vehicle(ModelConfig(inertia_kgm2=INERTIA, wheel_momentum=False)), 0.1)
    tau = (0.5, -0.3, 0.2)
    for _ in range(3):
        latency.note_sent(tau)
    body, d0, alpha = Body(omega=(0.02, -0.05, 0.01)), 0.05, 0.03  # the target: about inertial z, from attitude zero

    def find_error() -> PointingError:
        t = body.t_s
        q_tb = multiply(exp_map((0.0, 0.0, -(d0 * t + 0.5 * alpha * t * t))), body.q)
        turn = to_matrix(body.q).T
        d = turn @ np.array((0.0, 0.0, d0 + alpha * t))
        e = np.array(body.omega) - d
        acceleration = turn @ np.array((0.0, 0.0, alpha))
        return PointingError(q_tb, tuple(e.tolist()), tuple(d.tolist()), tuple(acceleration.tolist()))

    found = latency.predict(find_error(), ZERO)
    for k in range(30):
        body.t_s = k * 0.01
        body.advance(lambda t, q, w: tau, 0.01)
    body.t_s = 0.3
    expected = find_error()
    assert found.q_tb == pytest.approx(expected.q_tb, abs=1e-5)
    assert found.omega_bt_b_rad_s == pytest.approx(expected.omega_bt_b_rad_s, abs=1e-4)
    assert found.omega_ti_b_rad_s == pytest.approx(expected.omega_ti_b_rad_s, abs=1e-4)
