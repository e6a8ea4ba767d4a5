"""A target that turns as the body is told to turn: a rate in its own axes, brought up and changed within a limit."""

from __future__ import annotations

import math
from typing import Final

from bus.attitude import exp_map, multiply, normalise
from bus.linear import ZERO3, cross, scale, subtract
from bus.units import DEG, Vec3, Vec4
from fsw.families import Guide
from fsw.guidance.settings import RateConfig
from fsw.records import Target

LONGEST_STEP_S: Final = 0.1  # of the sum over a change of rate


class Rate(Guide):
    """omega(t) goes in a straight line from where it is to the rate asked for, at the limit, and stays there.

    While omega turns in its own axes the attitude has no closed form: it is summed up by the Magnus series to fourth order,
    q <- q exp(omega_m h + (omega_m x alpha) h^3 / 12), with omega_m at the middle of a step (Iserles et al., Acta Numerica
    9, 2000, sec 4). From then on it is q exp(omega t).
    """

    __slots__ = ("_alpha", "_at_s", "_first", "_full", "_q", "_ramp_s", "_start", "_start_s")

    def __init__(self, config: RateConfig, start: Target, t_s: float) -> None:
        """start, t_s: where the target stands and how it moves, and when the rate is asked for."""
        x, y, z = config.rate_deg_s
        self._start = start.q_it
        self._start_s = t_s
        self._first: Vec3 = start.omega_ti_t_rad_s
        self._full: Vec3 = (x * DEG, y * DEG, z * DEG)
        a, b, c = change = subtract(self._full, self._first)
        length = math.sqrt(a * a + b * b + c * c)
        limit = config.max_acceleration_deg_s2 * DEG
        self._ramp_s = length / limit
        self._alpha: Vec3 = scale(change, limit / length) if length > 0.0 else ZERO3
        self._at_s = 0.0  # up to where it is summed up, since the start
        self._q: Vec4 = self._start  # the target there

    @property
    def top_rate_rad_s(self) -> float:
        """The rate that is asked for [rad/s]."""
        x, y, z = self._full
        return math.sqrt(x * x + y * y + z * z)

    def point(self, t_s: float) -> Target:
        """Return the target at the time t_s [s]."""
        elapsed = t_s - self._start_s
        if elapsed < self._at_s:
            self._at_s, self._q = 0.0, self._start
        self._sum_up(min(elapsed, self._ramp_s))
        if elapsed < self._ramp_s:
            return Target(self._q, self._find_rate(elapsed), self._alpha)
        x, y, z = self._full
        since = elapsed - self._ramp_s
        return Target(multiply(self._q, exp_map((x * since, y * since, z * since))), self._full)

    def _find_rate(self, elapsed: float) -> Vec3:
        (x, y, z), (a, b, c) = self._first, self._alpha
        return (x + a * elapsed, y + b * elapsed, z + c * elapsed)

    def _sum_up(self, until: float) -> None:
        """Carry the attitude on to a time within the change of rate."""
        while self._at_s < until:
            left = until - self._at_s
            step = left if left < LONGEST_STEP_S else LONGEST_STEP_S
            middle = self._find_rate(self._at_s + 0.5 * step)
            (x, y, z), (a, b, c) = middle, cross(middle, self._alpha)
            k = step * step * step / 12.0
            turn = exp_map((x * step + a * k, y * step + b * k, z * step + c * k))
            self._q = normalise(multiply(self._q, turn))
            self._at_s = until if left < LONGEST_STEP_S else self._at_s + step
