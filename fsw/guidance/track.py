"""A target that turns steadily, as an instrument that follows the ground or scans the sky wants it."""

from __future__ import annotations

import math

from bus.attitude import exp_map, multiply
from bus.linear import ZERO3
from bus.units import DEG, Vec3
from fsw.families import Guide
from fsw.guidance.attitudes import read_attitude
from fsw.guidance.settings import TrackConfig
from fsw.records import Target


class Track(Guide):
    """q_it(t) = q_start exp(e theta(t)), theta' up to the rate within rise_s and constant from then on."""

    __slots__ = ("_axis", "_rate", "_rise_s", "_start", "_start_s")

    def __init__(self, config: TrackConfig, start: Target, t_s: float) -> None:
        """start, t_s: where the target stood before, and when the track begins."""
        self._start = start.q_it if config.target_q is None else read_attitude("target_q", config.target_q)
        self._start_s = t_s
        x, y, z = config.rate_deg_s
        length = math.sqrt(x * x + y * y + z * z)
        self._axis: Vec3 = (x / length, y / length, z / length) if length > 0.0 else ZERO3
        self._rate = length * DEG
        self._rise_s = config.rise_s

    def point(self, t_s: float) -> Target:
        """Return the target at the time t_s [s]."""
        elapsed, rise, full = t_s - self._start_s, self._rise_s, self._rate
        if elapsed < rise:
            acceleration = full / rise
            angle, rate = 0.5 * acceleration * elapsed * elapsed, acceleration * elapsed
        else:
            angle, rate, acceleration = full * (elapsed - 0.5 * rise), full, 0.0
        x, y, z = self._axis
        return Target(
            multiply(self._start, exp_map((x * angle, y * angle, z * angle))),
            (x * rate, y * rate, z * rate),
            (x * acceleration, y * acceleration, z * acceleration),
        )
