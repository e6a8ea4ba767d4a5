"""Closed loops of the finite-time laws without bus and frames: the body of Li & Liu 2011, integrated by Runge-Kutta.

Two ways to fly a law: in continuous time, called in every stage of the integration, as the paper's proofs have it; and
sampled, called once a period with its torque held, limited, and late by whole periods, as flight software does it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus.attitude import canonical, mrp_from_quaternion, normalise
from bus.linear import ZERO3, add, cross, invert_symmetric, scale, subtract, times
from bus.settings import build
from bus.units import DEG, Mat3, Vec3, Vec4
from fsw.controllers import REGISTRY
from fsw.families import Controller
from fsw.records import HEALTHY, PointingError
from fsw.settings import ModelConfig
from fsw.vehicle import Vehicle

Floats = NDArray[np.float64]
Torque = Callable[[float], Vec3]

INERTIA: Mat3 = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))  # of Zhang, Ye & Sun 2018; the paper's is lost
SMALL: Mat3 = ((20.0, 1.2, 0.9), (1.2, 17.0, 1.4), (0.9, 1.4, 15.0))  # a second one, common in this literature
START_Q: Vec4 = normalise((0.85, 0.25, -0.3, 0.35))  # 63.6 deg off
START_RATE: Vec3 = (0.51 * DEG, 0.3 * DEG, 0.009 * DEG)
NO_LIMIT_NM = 1e4


@dataclass(slots=True)
class Flown:
    """What a flight logged, a row a time."""

    t_s: Floats
    sigma: Floats  # (n, 3), of the short rotation
    omega_rad_s: Floats  # (n, 3)
    tau_nm: Floats  # (n, 3), after the limit; sampled: the torque that acts from this time on

    def find_settling(self, level: float) -> float:
        """Return the last time at which the largest |sigma_i| exceeds a level [s]; inf where that is the last row."""
        return last_above(self.t_s, np.abs(self.sigma).max(axis=1), level)

    def find_settling_deg(self, level_deg: float) -> float:
        """Return the last time at which the error angle exceeds a level [s]; inf where that is the last row."""
        return last_above(self.t_s, self.find_error_deg(), level_deg)

    def find_error_deg(self) -> Floats:
        """Return the error angle of each row [deg]."""
        norms: Floats = np.linalg.norm(self.sigma, axis=1)
        return 4.0 * np.arctan(norms) / DEG

    def find_variation(self, from_s: float, until_s: float) -> float:
        """Return the mean over the axes of sum |tau(k+1) - tau(k)| per time [N m/s]."""
        rows = self.tau_nm[(self.t_s >= from_s) & (self.t_s < until_s)]
        return float(np.abs(np.diff(rows, axis=0)).sum(axis=0).mean() / (until_s - from_s))


def last_above(t_s: Floats, values: Floats, level: float) -> float:
    """Return the last time at which a value exceeds a level; inf where it does to the end, 0 where it never does."""
    above = np.flatnonzero(values > level)
    if len(above) == 0:
        return 0.0
    return math.inf if above[-1] == len(values) - 1 else float(t_s[above[-1]])


def make_law(settings: dict[str, Any], period_s: float = 0.1, inertia_kgm2: Mat3 = INERTIA) -> Controller:
    """A controller from settings as a scenario has them, of a body whose gyroscopic torque is w x J w."""
    config: Any = build(REGISTRY.kinds[settings["kind"]][0], settings, "study")
    return REGISTRY.make(config, Vehicle(ModelConfig(inertia_kgm2=inertia_kgm2, wheel_momentum=False)), period_s)


def no_torque(t_s: float) -> Vec3:
    """No disturbance."""
    return ZERO3


def limit(tau_nm: Vec3, most_nm: float) -> Vec3:
    """Cut each axis to its limit [N m]."""
    x, y, z = tau_nm
    return (min(max(x, -most_nm), most_nm), min(max(y, -most_nm), most_nm), min(max(z, -most_nm), most_nm))


@dataclass(slots=True)
class Body:
    """A rigid body under a torque that depends on time and state: q' = q (0, w)/2, J w' = -w x J w + tau."""

    q: Vec4 = START_Q
    omega: Vec3 = START_RATE
    inertia: Mat3 = INERTIA
    t_s: float = 0.0
    inverse: Mat3 = field(init=False)

    def __post_init__(self) -> None:
        self.inverse = invert_symmetric(self.inertia)

    def advance(self, torque: Callable[[float, Vec4, Vec3], Vec3], dt_s: float) -> None:
        """One classical Runge-Kutta step; the torque is asked for in each stage. q0 >= 0 afterwards."""
        q, w, t, half = self.q, self.omega, self.t_s, 0.5 * dt_s
        a, b = self._rates(torque(t, q, w), q, w)
        q2, w2 = _shift4(q, a, half), _shift3(w, b, half)
        c, d = self._rates(torque(t + half, q2, w2), q2, w2)
        q3, w3 = _shift4(q, c, half), _shift3(w, d, half)
        e, f = self._rates(torque(t + half, q3, w3), q3, w3)
        q4, w4 = _shift4(q, e, dt_s), _shift3(w, f, dt_s)
        g, h = self._rates(torque(t + dt_s, q4, w4), q4, w4)
        sixth = dt_s / 6.0
        x, y, z, u = (i + sixth * (j + 2.0 * (k + l) + m) for i, j, k, l, m in zip(q, a, c, e, g, strict=True))
        self.q = canonical(normalise((x, y, z, u)))
        x, y, z = (i + sixth * (j + 2.0 * (k + l) + m) for i, j, k, l, m in zip(w, b, d, f, h, strict=True))
        self.omega = (x, y, z)
        self.t_s = t + dt_s

    def _rates(self, tau: Vec3, q: Vec4, w: Vec3) -> tuple[Vec4, Vec3]:
        q0, q1, q2, q3 = q
        x, y, z = w
        return (
            (
                -0.5 * (q1 * x + q2 * y + q3 * z), 0.5 * (q0 * x + q2 * z - q3 * y), 0.5 * (q0 * y + q3 * x - q1 * z),
                0.5 * (q0 * z + q1 * y - q2 * x),
            ),
            times(self.inverse, subtract(tau, cross(w, times(self.inertia, w)))),
        )  # fmt: skip


def _shift4(q: Vec4, rate: Vec4, dt: float) -> Vec4:
    return (q[0] + dt * rate[0], q[1] + dt * rate[1], q[2] + dt * rate[2], q[3] + dt * rate[3])


def _shift3(v: Vec3, rate: Vec3, dt: float) -> Vec3:
    return (v[0] + dt * rate[0], v[1] + dt * rate[1], v[2] + dt * rate[2])


def fly_continuous(
    law: Controller,
    body: Body,
    until_s: float,
    step_s: float = 1e-3,
    limit_nm: float = NO_LIMIT_NM,
    disturbance: Torque = no_torque,
    every: int = 50,
) -> Flown:
    """Fly a law that is called in every stage of the integration; a row every so many steps."""

    def push(t: float, q: Vec4, w: Vec3) -> Vec3:
        return limit(law.step(step_s, PointingError(q, w), ZERO3, HEALTHY), limit_nm)

    def torque(t: float, q: Vec4, w: Vec3) -> Vec3:
        return add(push(t, q, w), disturbance(t))

    rows: list[tuple[float, ...]] = []
    for step in range(round(until_s / step_s) + 1):
        body.t_s = step * step_s
        if step % every == 0:
            rows.append((
                body.t_s, *mrp_from_quaternion(body.q), *body.omega, *push(body.t_s, body.q, body.omega)
            ))  # fmt: skip
        body.advance(torque, step_s)
    return _collect(rows)


def fly_sampled(
    law: Controller,
    body: Body,
    until_s: float,
    period_s: float = 0.1,
    limit_nm: float = 0.1,
    disturbance: Torque = no_torque,
    latency: int = 0,
    noise: Callable[[], tuple[Vec3, Vec3]] | None = None,
    stages: int = 4,
) -> Flown:
    """Fly a law that is called once a period; a row a period.

    latency : periods that its torque is late by
    noise   : errors of sigma [1] and rate [rad/s], asked for once a period
    stages  : integration steps of a period
    """
    rows: list[tuple[float, ...]] = []
    late = [ZERO3] * latency
    step_s = period_s / stages
    for period in range(round(until_s / period_s) + 1):
        start_s = period * period_s
        q, w = body.q, body.omega
        if noise is not None:
            (a, b, c), (d, e, f) = noise()
            q, w = normalise((q[0], q[1] + 2.0 * a, q[2] + 2.0 * b, q[3] + 2.0 * c)), (w[0] + d, w[1] + e, w[2] + f)
        asked = limit(law.step(period_s, PointingError(q, w), ZERO3, HEALTHY), limit_nm)
        law.note_sent(asked)
        late.append(asked)
        acts = late.pop(0)
        rows.append((start_s, *mrp_from_quaternion(body.q), *body.omega, *acts))

        def torque(t: float, q: Vec4, w: Vec3, acts: Vec3 = acts) -> Vec3:
            return add(acts, disturbance(t))

        for stage in range(stages):
            body.t_s = start_s + stage * step_s
            body.advance(torque, step_s)
    return _collect(rows)


def _collect(rows: list[tuple[float, ...]]) -> Flown:
    table = np.array(rows)
    return Flown(table[:, 0], table[:, 1:4], table[:, 4:7], table[:, 7:10])


def draw_start(
    rng: np.random.Generator, least_deg: float, most_deg: float, most_rate_rad_s: float
) -> tuple[Vec4, Vec3]:
    """A random attitude, its axis uniform and its angle within bounds, and a rate, each axis within a bound."""
    x, y, z = rng.normal(size=3)
    norm, half = math.hypot(x, y, z), 0.5 * rng.uniform(least_deg, most_deg) * DEG
    k = math.sin(half) / norm
    a, b, c = rng.uniform(-most_rate_rad_s, most_rate_rad_s, size=3)
    return (math.cos(half), k * x, k * y, k * z), (float(a), float(b), float(c))


def draw_trials(count: int, seed: int) -> list[Body]:
    """Random bodies: 30 .. 120 deg off, up to 0.5 deg/s about each axis, 0.8 .. 1.2 times the inertia that laws know."""
    rng = np.random.default_rng(seed)
    trials = []
    for _ in range(count):
        q, w = draw_start(rng, 30.0, 120.0, 0.5 * DEG)
        k = float(rng.uniform(0.8, 1.2))
        x, y, z = (scale(row, k) for row in INERTIA)
        trials.append(Body(q, w, (x, y, z)))
    return trials


def find_trial_settling(settings: dict[str, Any], trials: list[Body], level_deg: float, until_s: float) -> list[float]:
    """Return the last time at which each body's error exceeds a level [s]: 0.1 N m about each axis, sampled at 0.1 s.

    until_s : how long each is flown; inf comes back for one that has not settled by then
    """
    found = []
    for trial in trials:
        body = Body(trial.q, trial.omega, trial.inertia)
        found.append(fly_sampled(make_law(settings), body, until_s, stages=1).find_settling_deg(level_deg))
    return found
