"""The body rate for a slower rate group: its mean over the ticks since that group last ran, instead of one sample of many.

An observer turns rate into torque by differences: the noise of one tick's sample comes through it amplified, while the mean
over its period has an n-th of the variance and folds nothing down from beyond its rate.
"""

from __future__ import annotations

from bus.linear import ZERO3
from bus.units import Vec3


class RateMean:
    """Sums up rates until somebody takes the mean."""

    __slots__ = ("_count", "_sum")

    def __init__(self) -> None:
        self._sum = ZERO3
        self._count = 0

    def add(self, rate_b_rad_s: Vec3) -> None:
        """Take in the rate of a tick [rad/s]."""
        x, y, z = self._sum
        a, b, c = rate_b_rad_s
        self._sum = (x + a, y + b, z + c)
        self._count += 1

    def shift(self, step_b_rad_s: Vec3) -> None:
        """Move what has been taken in by a known jump of the rate source [rad/s]."""
        x, y, z = self._sum
        n = self._count
        self._sum = (x + n * step_b_rad_s[0], y + n * step_b_rad_s[1], z + n * step_b_rad_s[2])

    def take(self) -> Vec3:
        """Return the mean since the last call [rad/s]. At least one rate must have been taken in since."""
        x, y, z = self._sum
        n = self._count
        self._sum = ZERO3
        self._count = 0
        return (x / n, y / n, z / n)
