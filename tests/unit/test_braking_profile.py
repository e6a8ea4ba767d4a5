"""The braking profile's bounds: how long a turn takes at most, how far a lost wheel carries it past, what it plans on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import linprog, minimize_scalar

from bus.linear import ZERO3
from bus.units import Vec4
from fsw.controllers.braking_profile import BrakingProfile
from fsw.controllers.settings import BrakingProfileConfig
from fsw.records import HEALTHY, PointingError, WheelHealth
from fsw.settings import ModelConfig
from fsw.vehicle import Vehicle

DT_S = 0.02
DEFAULT = BrakingProfileConfig(kind="braking_profile")
D0 = np.column_stack([np.eye(3), np.full(3, 1.0 / math.sqrt(3.0))])


class Turn:
    """A sphere that turns about one axis under the law; the wheels give what is asked for, as far as they can."""

    def __init__(
        self, config: BrakingProfileConfig, inertia_kgm2: float, axis: np.ndarray, health: WheelHealth
    ) -> None:
        j = inertia_kgm2
        model = ModelConfig(inertia_kgm2=((j, 0.0, 0.0), (0.0, j, 0.0), (0.0, 0.0, j)))
        self.law = BrakingProfile(config, Vehicle(model), DT_S)
        self.j, self.axis, self.health = j, axis, health
        self.theta = self.rate = self.t_s = 0.0  # rad about the axis, rad/s, s
        limits = np.array(model.wheel_max_torque_nm) * np.array(health.effectiveness)
        self.authority = solve_authority(j * axis, limits)

    def step(self, authority_rad_s2: float) -> None:
        """One period with at most this acceleration; constant acceleration is integrated exactly."""
        half = 0.5 * self.theta
        q = (math.cos(half), *(math.sin(half) * self.axis).tolist())
        error = PointingError(q, tuple((self.rate * self.axis).tolist()))  # type: ignore[arg-type]
        torque = np.array(self.law.step(DT_S, error, ZERO3, self.health))
        assert torque == pytest.approx((torque @ self.axis) * self.axis, abs=1e-9)  # it stays about the axis
        accel = float(np.clip(torque @ self.axis / self.j, -authority_rad_s2, authority_rad_s2))
        self.theta += self.rate * DT_S + 0.5 * accel * DT_S**2
        self.rate += accel * DT_S
        self.t_s += DT_S


def solve_authority(direction: np.ndarray, limits: np.ndarray) -> float:
    """The largest m with D0 u = m direction, |u| <= limits, by linear programming."""
    result = linprog(
        [-1.0, 0.0, 0.0, 0.0, 0.0], A_eq=np.column_stack([direction, -D0]), b_eq=np.zeros(3),
        bounds=[(0.0, None), *((-x, x) for x in limits)], method="highs",
    )  # fmt: skip
    return float(result.x[0])


class Profile:
    """f by numerical integration of the deceleration that is stated for it."""

    def __init__(self, config: BrakingProfileConfig, braking_rad_s2: float, lost: float) -> None:
        self.c, self.a = config, braking_rad_s2
        self.far = config.eta_far + (config.eta - config.eta_far) * min(1.0, config.spent * lost)
        self.linear_to = braking_rad_s2 * config.eta / config.k_theta**2

    def __call__(self, theta: float) -> float:
        if theta <= self.linear_to:
            return self.c.k_theta * theta
        x = theta - self.linear_to
        energy = quad(lambda y: self.far + (self.c.eta - self.far) * math.exp(-y / self.c.far_rad), 0.0, x)[0]
        return math.sqrt((self.c.k_theta * self.linear_to) ** 2 + 2.0 * self.a * energy)


def draw_turn(seed: int) -> tuple[Turn, Profile, np.random.Generator]:
    r = np.random.default_rng([4, seed])
    config = BrakingProfileConfig(
        kind="braking_profile", eta=r.uniform(0.6, 1.0), eta_far=r.uniform(0.1, 0.6), far_rad=r.uniform(0.1, 0.6),
        k_theta=r.uniform(0.5, 1.2), k_s=r.uniform(0.5, 1.2), spent=r.uniform(0.0, 0.6), reserve=0.0,
    )  # fmt: skip
    axis = r.normal(size=3)
    axis /= np.linalg.norm(axis)
    shares: Vec4 = tuple(r.uniform(0.3, 1.0, 4).tolist())
    turn = Turn(config, r.uniform(20.0, 60.0), axis, WheelHealth(effectiveness=shares))
    return turn, Profile(config, turn.authority, 4.0 - sum(shares)), r


@pytest.mark.parametrize("seed", range(4))
def test_turn_from_rest_ends_within_its_bound(seed: int) -> None:
    """With a constant authority: f(theta_0)/A + integral of d theta / f, for drawn settings, axes, wheels and angles."""
    turn, profile, r = draw_turn(seed)
    a, theta_0 = turn.authority, r.uniform(0.4, 2.8)
    lag = a / turn.law._config.k_s**2
    theta_b = max(math.radians(1.0), 2.0 * lag)
    bound = profile(theta_0) / a + quad(lambda x: 1.0 / profile(x), theta_b - lag, theta_0, limit=200)[0]
    turn.theta, last = theta_0, 0.0
    while turn.t_s < bound + 20.0:
        turn.step(a)
        if abs(turn.theta) > theta_b:
            last = turn.t_s
    assert last <= bound + 2 * DT_S
    assert last > 0.5 * bound  # the bound is not idle


@pytest.mark.parametrize("told", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_loss_on_the_profile_overshoots_within_its_bound(seed: int, told: bool) -> None:
    """The authority falls to a part of it at a drawn angle: past the target by at most max f(x)^2/(2 A') - x."""
    turn, profile, r = draw_turn(seed)
    turn.theta = theta = r.uniform(0.3, 2.0)
    turn.rate = -profile(theta)
    part = r.uniform(0.1, 0.7)
    left = part * turn.authority
    worst = minimize_scalar(lambda x: x - profile(x) ** 2 / (2.0 * left), bounds=(0.0, theta), method="bounded")
    bound = max(0.0, -float(worst.fun), profile(theta) ** 2 / (2.0 * left) - theta)
    if told:
        shares = tuple(part * x for x in turn.health.effectiveness)
        turn.health = WheelHealth(effectiveness=shares)  # type: ignore[arg-type]
    passed = 0.0
    while turn.rate < -1e-6 and turn.t_s < 300.0:
        turn.step(left)
        passed = max(passed, -turn.theta)
    assert turn.rate >= -1e-6  # it has turned back, or come to rest
    assert passed <= bound + 2e-3
    assert told or passed > 0.9 * bound - 2e-3


def test_profile_is_firmer_once_wheels_are_spent() -> None:
    """With one whole wheel lost, eta_far has come `spent` of the way to eta: against the integral, wheel by wheel."""
    axis = np.array([0.48, 0.6, 0.64])
    for share in (1.0, 0.5, 0.0):
        health = WheelHealth(effectiveness=(1.0, 1.0, 1.0, share))
        turn = Turn(DEFAULT, 45.0, axis, health)
        turn.theta = 1.2
        turn.step(1.0)
        planned = turn.law.internals
        profile = Profile(DEFAULT, planned.braking_rad_s2, 1.0 - share)
        assert planned.profile_rad_s == pytest.approx(profile(1.2), rel=1e-9)


def test_dead_and_switched_off_wheels_are_not_planned_on() -> None:
    """A wheel that is dead or not available counts as one that gives nothing, by linear programming."""
    axis = np.array([0.0, 0.6, 0.8])
    plans = []
    for health in (
        WheelHealth(effectiveness=(1.0, 1.0, 0.0, 1.0)),
        WheelHealth(dead=(False, False, True, False)),
        WheelHealth(available=(True, True, False, True)),
    ):
        turn = Turn(BrakingProfileConfig(kind="braking_profile", reserve=0.0), 45.0, axis, health)
        turn.theta = 1.0
        turn.step(1.0)
        plans.append(turn.law.internals.braking_rad_s2)
    assert plans == pytest.approx([solve_authority(45.0 * axis, np.array([0.1, 0.1, 0.0, 0.1]))] * 3, rel=1e-6)


def test_a_stuck_torque_helps_one_way_and_hinders_the_other() -> None:
    """A wheel stuck at b along the turn: the braking planned on differs by 2 b / J between the two directions."""
    axis, b = np.array([1.0, 0.0, 0.0]), 0.02
    plans = []
    for sign in (1.0, -1.0):
        health = WheelHealth(effectiveness=(0.0, 1.0, 1.0, 1.0), bias_nm=(b, 0.0, 0.0, 0.0))
        turn = Turn(BrakingProfileConfig(kind="braking_profile", reserve=0.0), 40.0, sign * axis, health)
        turn.theta = 1.0
        turn.step(1.0)
        plans.append(turn.law.internals.braking_rad_s2)
    assert plans[0] - plans[1] == pytest.approx(2.0 * b / 40.0)
    assert HEALTHY.bias_nm == (0.0, 0.0, 0.0, 0.0)
