"""The power-integrator law of Li & Liu 2011, (28): recorded torques and flights, the inequality of its proof, the paper's
case with and without disturbance, and what is left of it at 0.1 N m and 0.1 s."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from bus.attitude import quaternion_from_mrp
from bus.errors import ConfigError
from bus.linear import scale
from bus.units import Mat3, Vec3
from fsw.controllers.gain_condition import bound_gain, find_dominance, find_largest_beta, find_least_gain
from fsw.controllers.power_integrator import PowerIntegrator
from fsw.records import HEALTHY, PointingError, WheelHealth
from fsw.vehicle import invert_inertia
from tools.design.finite_time_loop import (
    INERTIA,
    SMALL,
    Body,
    Floats,
    draw_start,
    draw_trials,
    find_trial_settling,
    fly_continuous,
    fly_sampled,
    make_law,
)

DATA = Path(__file__).resolve().parents[1] / "data" / "control"
RECORD = np.load(DATA / "ft_functions.npz")
ZERO: Vec3 = (0.0, 0.0, 0.0)
J = np.array(INERTIA)
PAPER = {"m": 50.0, "beta": 1.0, "inertia_weight": False, "sampling": "explicit", "gain_check": "off"}


def law(**settings: Any) -> PowerIntegrator:
    """The defaults unless it is said otherwise."""
    inertia, period_s = settings.pop("inertia", INERTIA), settings.pop("period_s", 0.1)
    made = make_law({"kind": "power_integrator"} | settings, period_s, inertia)
    assert isinstance(made, PowerIntegrator)
    return made


def step(controller: PowerIntegrator, sigma: Any, omega: Any, health: WheelHealth = HEALTHY) -> Floats:
    error = PointingError(quaternion_from_mrp(tuple(sigma)), tuple(omega))
    return np.array(controller.step(0.1, error, ZERO, health))


def push(t_s: float) -> Vec3:
    """The paper's disturbance [N m]."""
    d = 8.0 * math.sin(2.0 * math.pi * t_s)
    return (d, 1.2 * d, d)


# -- the law ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "settings"),
    [
        ("tau_P28", PAPER | {"beta": 0.5, "gyroscopic": False}),
        ("tau_P28g", PAPER | {"beta": 0.5}),
        ("tau_P28J", {"m": 1.1, "beta": 0.5, "sampling": "explicit", "gain_check": "off"}),
    ],
)
def test_forms_give_the_recorded_torques(key: str, settings: dict[str, Any]) -> None:
    """100 random states, torques of an independent implementation, to 1e-12."""
    controller = law(**settings)
    for s, w, tau in zip(RECORD["sigma"].tolist(), RECORD["omega"].tolist(), RECORD[key], strict=True):
        assert step(controller, s, w) == pytest.approx(tau, abs=1e-12)


def test_implicit_form_solves_its_equation() -> None:
    """Accelerations recorded from an independent solution to 1e-9; the torques are w x J w + J a."""
    controller = law()
    for s, w, recorded in zip(
        RECORD["sigma"].tolist(), RECORD["omega"].tolist(), RECORD["acc_impl28_Ts01_ma11_b013"], strict=True
    ):
        found = np.array([controller.find_acceleration(a, b, 1.1) for a, b in zip(s, w, strict=True)])
        assert found == pytest.approx(recorded, abs=1e-9)
        assert step(controller, s, w) == pytest.approx(np.cross(w, J @ np.array(w)) + J @ found, abs=1e-12)
    unweighted = law(inertia_weight=False, m=50.0, gyroscopic=False)
    s, w = (0.1, -0.2, 0.05), (0.01, 0.02, -0.03)
    expected = [J[i, i] * unweighted.find_acceleration(s[i], w[i], 50.0 / J[i, i]) for i in range(3)]
    assert step(unweighted, s, w) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("beta", [0.13, 1.0])
def test_implicit_solution_is_a_root(beta: float) -> None:
    """Also where the fifth root is steepest, on the manifold: the equation's two sides change order within the last bits."""
    controller = law(beta=beta, gain_check="off")
    for sigma, omega in ((0.3, 0.0), (-1e-6, 1e-4), (1e-9, -beta * 1e-9**0.6), (0.0, 1e-12), (-0.5, 0.5)):
        end = omega + 0.1 * controller.find_acceleration(sigma, omega, 1.1)

        def residual(w: float, sigma: float = sigma, omega: float = omega) -> float:
            xi = np.sign(w) * abs(w) ** (5.0 / 3.0) + beta ** (5.0 / 3.0) * (sigma + 0.025 * w)
            return float(w - omega + 0.11 * np.sign(xi) * abs(xi) ** 0.2)

        width = 4e-16 * max(abs(omega), abs(end)) + 1e-24
        assert residual(end - width) <= 0.0 <= residual(end + width)


def test_reset_forgets_what_is_on_its_way_and_fault_torque_comes_off() -> None:
    """A torque sent changes the next step with latency, and not after a reset; the observer's torque is taken off whole."""
    controller, s, w = law(latency=1, adapt_beta=True), (0.1, -0.2, 0.05), (0.01, 0.02, -0.03)
    fresh = step(controller, s, w)
    controller.note_sent((0.5, 0.5, -0.5))
    step(controller, s, w, WheelHealth((0.5, 0.5, 0.5, 0.5)))
    controller.note_sent((0.5, 0.5, -0.5))
    assert np.abs(step(controller, s, w) - fresh).max() > 1e-2
    controller.reset()
    assert step(controller, s, w) == pytest.approx(fresh, abs=0.0)
    error = PointingError(quaternion_from_mrp(s), w)
    fault = (0.01, -0.02, 0.03)
    plain, less = law().step(0.1, error, ZERO, HEALTHY), law().step(0.1, error, fault, HEALTHY)
    assert np.array(plain) - np.array(less) == pytest.approx(fault, abs=1e-15)


# -- the proof -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("beta", "least"),
    [(0.05, 0.033), (0.1, 0.105), (0.2, 0.333), (0.3, 0.655), (0.5, 1.54), (1.0, 5.04), (2.0, 18.4), (3.0, 43.6)],
)
def test_least_gain_is_the_bound_at_its_best_weight(beta: float, least: float) -> None:
    """The figures of an independent minimisation to their three digits; no weight on a fine grid gives less."""
    found, weight = find_least_gain(beta)
    assert found == pytest.approx(least, rel=0.012)
    assert found == bound_gain(beta, weight)
    assert min(bound_gain(beta, weight * k) for k in np.geomspace(1e-3, 1e3, 601)) >= found * (1.0 - 1e-12)
    assert find_largest_beta(found) == pytest.approx(beta, rel=1e-9)


@pytest.mark.parametrize("beta", [0.13, 0.5, 2.0])
def test_v_falls_as_the_proof_says(beta: float) -> None:
    """V' <= -c N and N >= (V/K)^(4/5), at the least gain there is, on random states, half of them near the manifold: V and
    V' by quadrature of their definitions, with the torque that the law gives."""
    gain, weight = find_least_gain(beta)
    controller = law(m=gain * (1.0 + 1e-9), beta=beta, sampling="explicit")
    rng, b53, inverse = np.random.default_rng(5), beta ** (5.0 / 3.0), np.linalg.inv(J)
    c, most = weight * beta / 3.0, max(2.0 * weight, 2.0**0.4)
    for number in range(60):
        s = rng.normal(size=3)
        s *= rng.uniform(0.0, 1.0) ** 3 / np.linalg.norm(s)
        star = -beta * np.sign(s) * np.abs(s) ** 0.6
        w = star * (1.0 + 0.1 * rng.normal(size=3)) if number % 2 else rng.normal(0.0, 2.0 * beta, 3)
        xi = np.sign(w) * np.abs(w) ** (5.0 / 3.0) + b53 * s
        w_rate = inverse @ (step(controller, s, w) - np.cross(w, J @ w))
        k = np.array(((0.0, -s[2], s[1]), (s[2], 0.0, -s[0]), (-s[1], s[0], 0.0)))
        s_rate = 0.25 * ((1.0 - s @ s) * np.eye(3) + 2.0 * k + 2.0 * np.outer(s, s)) @ w
        v, v_rate = 2.0 * weight * math.log1p(s @ s), weight * (s @ w)
        for i in range(3):
            v += integrate(star[i], w[i], b53 * s[i], 1.4)
            v_rate += 1.4 * b53 * integrate(star[i], w[i], b53 * s[i], 0.4) * s_rate[i]
            v_rate += np.sign(xi[i]) * abs(xi[i]) ** 1.4 * w_rate[i]
        n = (np.abs(s) ** 1.6 + np.abs(xi) ** 1.6).sum()
        assert v_rate <= -c * n + 1e-9 * n
        assert n >= (v / most) ** 0.8 * (1.0 - 1e-6)


def integrate(low: float, high: float, offset: float, power: float) -> float:
    """The integral over s of |s^(5/3) + offset|^power, with the sign of the base where the power is above one."""

    def value(x: float) -> float:
        base = math.copysign(abs(x) ** (5.0 / 3.0), x) + offset
        return abs(base) ** power * (math.copysign(1.0, base) if power > 1.0 else 1.0)

    ends = [low, *([0.0] if min(low, high) < 0.0 < max(low, high) else []), high]
    return float(sum(quad(value, a, b, epsabs=1e-14, epsrel=1e-9)[0] for a, b in itertools.pairwise(ends)))


def test_a_gain_in_newton_metres_counts_by_the_inverse_inertia() -> None:
    """sum sig(xi)^(7/5) (J^-1 sig(xi)^(1/5)) >= dominance sum |xi|^(8/5), on random xi: the proof without J."""
    rng = np.random.default_rng(2)
    for inertia in (INERTIA, SMALL):
        inverse = np.array(invert_inertia(inertia))
        dominance = find_dominance(invert_inertia(inertia))
        b = rng.normal(size=(20000, 3))
        left = np.einsum("ni,ij,nj->n", np.sign(b) * np.abs(b) ** 7, inverse, b)
        right = dominance * (b**8).sum(axis=1)
        assert (left >= right * (1.0 - 1e-12)).all()
        assert 0.0 < dominance < inverse.diagonal().min()


def test_gain_below_the_proof_is_refused_warned_of_or_let_be() -> None:
    """The message has m, m_min(beta), the gain that would do and the largest beta that m covers; both of them then pass."""
    with pytest.raises(ConfigError) as caught:
        law(m=1.1, beta=1.0)
    word = str(caught.value)
    assert word.startswith("fsw.controller.m: 1.1 rad/s^2 is below m_min = 5.042 rad/s^2 of beta 1,")
    assert "m >= 5.042, or beta <= 0.409, or gain_check: warn" in word
    assert law(m=5.043, beta=1.0).caution == law(m=1.1, beta=0.4088).caution == ""
    assert law(m=1.1, beta=1.0, gain_check="warn").caution == word.removesuffix(", or gain_check: warn")
    assert law(m=1.1, beta=1.0, gain_check="off").caution == ""
    with pytest.raises(ConfigError, match=r"50 N m, which counts as 0.9124 rad/s\^2, is below"):
        law(**PAPER | {"gain_check": "refuse"})
    assert law(m=50.0, beta=0.36, inertia_weight=False).caution == ""
    assert law(m=50.0, beta=3.0).internals.least_gain_s2 == pytest.approx(43.6, abs=0.05)


def test_an_inertia_without_dominance_is_told_of() -> None:
    """Where J^-1 is not diagonally dominant no gain in N m is proven, and the message says what to do."""
    odd: Mat3 = ((10.0, -4.0, -4.0), (-4.0, 10.0, -4.0), (-4.0, -4.0, 10.0))
    assert find_dominance(invert_inertia(odd)) < 0.0
    with pytest.raises(ConfigError, match="not diagonally dominant; take inertia_weight: true"):
        law(m=1e6, inertia_weight=False, inertia=odd)


# -- flights in continuous time: the paper's case -------------------------------------------------------------------------


def test_flight_is_the_recorded_one() -> None:
    """m = 50 N m, beta = 1, 10 N m about each axis, 12 s: within 1e-4 of an independent integration at 1e-4 s."""
    record = np.load(DATA / "ft28_m50.npz")
    flown = fly_continuous(law(**PAPER), Body(), 12.0, 2e-3, 10.0, every=25)
    assert np.abs(flown.sigma - record["sigma"]).max() < 1e-4
    assert np.abs(flown.omega_rad_s - record["omega"]).max() < 2e-4


@pytest.mark.parametrize(
    ("beta", "weight", "inertia", "three_s", "five_s"),
    [
        (1.0, False, INERTIA, 5.28, 5.81),
        (0.5, False, INERTIA, 9.29, 10.35),
        (1.0, True, INERTIA, 5.28, 5.81),
        pytest.param(1.0, False, SMALL, 4.7, 5.25, marks=pytest.mark.slow),
        pytest.param(0.5, False, SMALL, 8.95, 10.05, marks=pytest.mark.slow),
    ],
)
def test_settling_times_of_the_papers_case(
    beta: float, weight: bool, inertia: Mat3, three_s: float, five_s: float
) -> None:
    """1e-3 and 1e-5 within 0.1 s of an independent integration, with the factor J as without."""
    settings = PAPER | {"beta": beta, "inertia_weight": weight, "inertia": inertia}
    flown = fly_continuous(law(**settings), Body(inertia=inertia), 11.0 if beta < 1.0 else 6.5, 4e-3, 10.0, every=5)
    assert flown.find_settling(1e-3) == pytest.approx(three_s, abs=0.1)
    assert flown.find_settling(1e-5) == pytest.approx(five_s, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("beta", "omega_rad_s"), [(1.0, 5.5e-3), (0.5, 6.0e-3)])
def test_disturbance_leaves_a_neighbourhood_and_a_smooth_torque(beta: float, omega_rad_s: float) -> None:
    """8 sin 2 pi t (1, 1.2, 1) N m: |sigma| within (d/m)^5/beta^(5/3), |omega| below 7e-3 rad/s; the torque changes sign
    with the disturbance, not with the steps of the integration."""
    flown = fly_continuous(law(**PAPER | {"beta": beta}), Body(), 22.0, 1e-3, 10.0, push, every=1)
    last = flown.t_s > 15.0
    assert np.abs(flown.sigma[last]).max() <= 2.65e-4 / beta ** (5.0 / 3.0) * 1.1
    most = np.abs(flown.omega_rad_s[last]).max()
    assert most == pytest.approx(omega_rad_s, rel=0.05)
    assert most < 7e-3
    changes = (np.diff(np.sign(flown.tau_nm[last]), axis=0) != 0.0).sum(axis=0)
    assert (changes < 0.02 * last.sum()).all()
    assert flown.find_variation(15.0, 22.0) < 150.0


# -- sampled, 0.1 N m, 0.1 s --------------------------------------------------------------------------------------------


def test_sampled_flight_is_the_recorded_one() -> None:
    """Implicit form, 0.1 N m about each axis, held over 0.1 s: an independent implementation's flight to 1e-9."""
    record = np.load(DATA / "ft28impl_zoh01.npz")
    flown = fly_sampled(law(), Body(), 60.0)
    count = len(flown.t_s)
    assert np.abs(flown.sigma - record["sigma"][:count]).max() < 1e-9
    assert np.abs(flown.omega_rad_s - record["omega"][:count]).max() < 1e-9
    assert np.abs(flown.tau_nm - record["tau"][:count]).max() < 1e-9


def test_small_wheels_settle_and_do_not_chatter() -> None:
    """Implicit form: 0.01 deg by 52 s, then nothing is left. Explicit: as soon there, and 0.1 N m/s of torque for ever."""
    flown = fly_sampled(law(), Body(), 75.0)
    assert 45.0 < flown.find_settling_deg(0.01) <= 52.0
    assert flown.find_error_deg()[-10:].max() < 1e-9
    assert flown.find_variation(65.0, 75.0) < 1e-9
    flown = fly_sampled(law(sampling="explicit"), Body(), 75.0)
    assert flown.find_settling_deg(0.01) <= 52.0
    assert flown.find_settling_deg(0.001) == math.inf
    assert flown.find_variation(65.0, 75.0) >= 0.1


def test_the_papers_slope_needs_the_papers_wheels() -> None:
    """beta = 1 with 0.1 N m: the wheels cannot brake along the manifold, and the body swings for ever."""
    flown = fly_sampled(law(**PAPER | {"sampling": "implicit"}), Body(), 120.0, stages=1)
    assert flown.find_error_deg()[-600:].max() > 10.0


@pytest.mark.parametrize("samples", [1, 2])
def test_latency_is_looked_past(samples: int) -> None:
    """A torque that is late by one or two periods: without prediction millidegrees are left, with it nothing."""
    blind = fly_sampled(law(), Body(), 70.0, latency=samples, stages=2)
    assert blind.find_error_deg()[-100:].max() > 1e-3
    seeing = fly_sampled(law(latency=samples), Body(), 60.0, latency=samples, stages=2)
    assert seeing.find_error_deg()[-10:].max() < 1e-9
    assert seeing.find_settling_deg(0.01) <= 52.0


@pytest.mark.slow
@pytest.mark.parametrize(("truth", "left_deg"), [(1.25, 1e-9), (0.8, 5e-4)])
def test_prediction_survives_a_wrong_inertia(truth: float, left_deg: float) -> None:
    """Two periods late and an inertia 0.8 or 1.25 times the modelled one: of the heavier nothing is left, the lighter keeps
    a limit cycle of 1.4e-4 deg, a hundredth of what is left without prediction."""
    x, y, z = (scale(row, truth) for row in INERTIA)
    flown = fly_sampled(law(latency=2), Body(inertia=(x, y, z)), 120.0, latency=2)
    assert flown.find_error_deg()[-100:].max() < left_deg
    assert flown.find_settling_deg(0.01) <= 54.0


@pytest.mark.slow
def test_random_starts_settle() -> None:
    """40 random starts, the true inertia 0.8 .. 1.2 times the modelled one: median of the 0.01 deg times at most 60 s."""
    found = find_trial_settling({"kind": "power_integrator"}, draw_trials(40, 1), 0.01, 85.0)
    assert np.median(found) <= 60.0
    assert max(found) < 78.0


@pytest.mark.slow
def test_beyond_the_proof_it_settles_all_the_same() -> None:
    """beta = 1 with m = 1.1 is outside the gain condition, which is sufficient and not necessary: without limit 20 random
    starts converge."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        q, w = draw_start(rng, 0.0, 180.0, 0.5)
        flown = fly_continuous(law(m=1.1, beta=1.0, sampling="explicit", gain_check="off"), Body(q, w), 20.0, 5e-3)
        assert flown.find_settling(1e-3) < 15.0


# -- beta and the wheels that are left -----------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.5, 0.2])
def test_beta_follows_the_root_of_the_torque_left(share: float) -> None:
    """All wheels at a share of their torque: beta sqrt(share): the braking that the manifold asks for goes with beta^2."""
    controller = law(adapt_beta=True)
    step(controller, (0.1, 0.0, 0.0), ZERO, WheelHealth((share, share, share, share)))
    assert controller.internals.beta_rad_s == pytest.approx(0.13 * math.sqrt(share), rel=1e-9)
    step(controller, (0.1, 0.0, 0.0), ZERO)
    assert controller.internals.beta_rad_s == 0.13
    fixed = law()
    step(fixed, (0.1, 0.0, 0.0), ZERO, WheelHealth((share, share, share, share)))
    assert fixed.internals.beta_rad_s == 0.13


def test_beta_knows_dead_and_absent_wheels_and_never_vanishes() -> None:
    """A wheel out of use counts for nothing however it is told. Along x, y, z and askew, all four give 1 N m in the worst
    direction by their facets; three of them less or as much; two leave a direction without torque, and beta at its floor."""
    ways = [
        WheelHealth((1.0, 1.0, 1.0, 0.0)),
        WheelHealth(available=(True, True, True, False)),
        WheelHealth(dead=(False, False, False, True)),
    ]
    found = []
    for health in ways:
        controller = law(adapt_beta=True)
        step(controller, (0.1, 0.0, 0.0), ZERO, health)
        found.append(controller.internals.beta_rad_s)
    assert found[0] == found[1] == found[2]
    # Wheels askew to all at 1/sqrt(3): the weakest facet is normal to (y, z, and so on): 1 + 1/sqrt(3) against 1.
    worst = min(
        np.abs(np.array(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (3**-0.5,) * 3)) @ n).sum()
        for n in (np.array((1.0, 0.0, 0.0)), np.array((0.0, 1.0, -1.0)) / math.sqrt(2.0))
    )
    assert found[0] == pytest.approx(0.13 * math.sqrt(1.0 / worst), rel=1e-6)
    controller = law(adapt_beta=True)
    step(controller, (0.1, 0.0, 0.0), ZERO, WheelHealth((1.0, 1.0, 0.0, 0.0)))
    assert controller.internals.beta_rad_s == pytest.approx(0.13 * math.sqrt(0.05), rel=1e-9)
