"""Rest-to-rest slew: from where the target stands to another attitude about one axis, within limits."""

from __future__ import annotations

import math

from bus.attitude import conjugate, exp_map, log_map, multiply, normalise
from bus.units import DEG, Vec3
from fsw.families import Guide
from fsw.guidance.attitudes import read_attitude
from fsw.guidance.settings import SlewConfig
from fsw.records import Target


class Slew(Guide):
    """theta'' is +a, 0, -a: a trapezoid in rate, or a triangle where the way is too short for the full rate.

    The torque that follows it is J e a at the most, beside the gyroscopic one (Wie, Space Vehicle Dynamics and Control,
    2nd ed. 2008, sec 7.3.2: eigenaxis rotation).
    """

    __slots__ = ("_acceleration", "_angle", "_axis", "_end", "_peak", "_ramp_s", "_start", "_start_s", "_total_s")

    def __init__(self, config: SlewConfig, start: Target, t_s: float) -> None:
        """start, t_s: where the target stands, and when the slew begins; a target that moves is stopped there first."""
        self._start = start.q_it
        self._start_s = t_s
        end = read_attitude("target_q", config.target_q)
        self._end = Target(end)
        x, y, z = log_map(normalise(multiply(conjugate(start.q_it), end)))
        self._angle = angle = math.sqrt(x * x + y * y + z * z)
        self._axis: Vec3 = (x / angle, y / angle, z / angle) if angle > 0.0 else (1.0, 0.0, 0.0)
        self._acceleration = config.max_acceleration_deg_s2 * DEG
        self._peak = min(config.max_rate_deg_s * DEG, math.sqrt(angle * self._acceleration))
        self._ramp_s = self._peak / self._acceleration
        self._total_s = self._ramp_s + angle / self._peak if angle > 0.0 else 0.0

    @property
    def duration_s(self) -> float:
        """How long it takes [s]."""
        return self._total_s

    def point(self, t_s: float) -> Target:
        """Return the target at the time t_s [s]; after the end it rests there."""
        elapsed = t_s - self._start_s
        if elapsed >= self._total_s:
            return self._end
        a, peak, ramp = self._acceleration, self._peak, self._ramp_s
        if elapsed < ramp:
            angle, rate, acceleration = 0.5 * a * elapsed * elapsed, a * elapsed, a
        elif elapsed <= self._total_s - ramp:
            angle, rate, acceleration = peak * (elapsed - 0.5 * ramp), peak, 0.0
        else:
            left = self._total_s - elapsed
            angle, rate, acceleration = self._angle - 0.5 * a * left * left, a * left, -a
        x, y, z = self._axis
        return Target(
            multiply(self._start, exp_map((x * angle, y * angle, z * angle))),
            (x * rate, y * rate, z * rate),
            (x * acceleration, y * acceleration, z * acceleration),
        )
