"""Angular acceleration from successive rates, smoothed."""

from __future__ import annotations

from bus.linear import ZERO3
from bus.units import Vec3


class RateSlope:
    """a <- a + share ((w - w_before)/dt - a), from a = 0 at the first rate (spec of paper 003, section 6.1).

    `share` is that of one step, whatever its length: at another control rate the filter is another one.
    """

    __slots__ = ("_before", "_share", "_started", "alpha_b_rad_s2")

    def __init__(self, share: float) -> None:
        self._share = share
        self.reset()

    def reset(self) -> None:
        """Forget all rates."""
        self._started = False
        self._before: Vec3 = ZERO3
        self.alpha_b_rad_s2: Vec3 = ZERO3

    def step(self, dt_s: float, omega_b_rad_s: Vec3) -> Vec3:
        """Return the acceleration [rad/s^2] with a rate that is dt_s younger than the last.

        It stays as it was where dt_s is not above 0.
        """
        if self._started and dt_s > 0.0:
            ax, ay, az = self.alpha_b_rad_s2
            bx, by, bz = self._before
            wx, wy, wz = omega_b_rad_s
            share = self._share
            self.alpha_b_rad_s2 = (
                ax + share * ((wx - bx) / dt_s - ax),
                ay + share * ((wy - by) / dt_s - ay),
                az + share * ((wz - bz) / dt_s - az),
            )
        self._started = True
        self._before = omega_b_rad_s
        return self.alpha_b_rad_s2
