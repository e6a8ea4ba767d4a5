"""The target of the moment, and the body's error with respect to it, the short way round.

q and -q are the same attitude. A law that drives q_tb to (1, 0, 0, 0) unwinds when it is handed the other sign, and
chatters when the sign is chosen afresh on every cycle near 180 degrees (Mayhew, Sanfelice & Teel, IEEE Trans. Automatic
Control 56(11), 2011).
"""

from __future__ import annotations

from typing import Final

from bus.attitude import rotate_back
from bus.commands import Command
from bus.linear import cross, subtract
from bus.units import Vec3, Vec4
from fsw.families import Guide
from fsw.guidance.attitudes import read_attitude
from fsw.guidance.timeline import RATE, make_guide
from fsw.records import PointingError, Target

HYSTERESIS_Q0: Final = 0.1  # the sign changes only when q0 < -0.1: 11.5 degrees past the half turn


class Guidance:
    """Follows a course of the target, a fixed attitude at first."""

    __slots__ = ("_guide", "_sign", "follows", "target")

    def __init__(self, target_q: Vec4) -> None:
        """target_q: attitude to begin with, q_it, scalar first; normalised here. Raises ConfigError when it is zero."""
        self.target = Target(read_attitude("target_q", target_q))
        self._guide: Guide | None = None
        self.follows = False  # a course; else the target stands still
        self.reset()

    def reset(self) -> None:
        """Forget which sign was chosen; the next error has q0 >= 0."""
        self._sign = 0.0

    def follow(self, command: Command, t_s: float) -> None:
        """Take up another course from the time t_s on [s]. Raises ConfigError, and keeps its course, when it is wrong."""
        start = self.target
        if self._guide is not None and command.verb == RATE:  # goes on from how the target moves
            start = self._guide.point(t_s)
        self._guide = make_guide(command, start, t_s)
        self.follows = True

    @property
    def course(self) -> Guide | None:
        """The course that is followed; another object for every command."""
        return self._guide

    def advance(self, t_s: float) -> Target:
        """Return the target at the time t_s [s], and keep it as the target of this tick."""
        if self._guide is not None:
            self.target = self._guide.point(t_s)
        return self.target

    def find_error(self, q_ib: Vec4, omega_bi_b_rad_s: Vec3) -> PointingError:
        """Return the error of the body's attitude and rate with respect to the target of this tick.

        The first q_tb = q_it^-1 q_ib has q0 >= 0. Later ones keep the sign chosen before until q0 would fall below
        -HYSTERESIS_Q0.
        """
        target = self.target
        t0, tx, ty, tz = target.q_it
        b0, bx, by, bz = q_ib
        q0 = t0 * b0 + tx * bx + ty * by + tz * bz
        qx = t0 * bx - tx * b0 - ty * bz + tz * by
        qy = t0 * by - ty * b0 - tz * bx + tx * bz
        qz = t0 * bz - tz * b0 - tx * by + ty * bx
        sign = self._sign
        if sign == 0.0:
            sign = -1.0 if q0 < 0.0 else 1.0
        elif sign * q0 < -HYSTERESIS_Q0:
            sign = -sign
        self._sign = sign
        q_tb = (-q0, -qx, -qy, -qz) if sign < 0.0 else (q0, qx, qy, qz)
        if target.at_rest:
            return PointingError(q_tb, omega_bi_b_rad_s)
        omega_ti_b = rotate_back(q_tb, target.omega_ti_t_rad_s)
        # The target's acceleration is given in its own axes, in which its derivative is that of the components.
        alpha_ti_b = rotate_back(q_tb, target.alpha_ti_t_rad_s2)
        return PointingError(q_tb, subtract(omega_bi_b_rad_s, omega_ti_b), omega_ti_b, alpha_ti_b)


def feed_forward(error: PointingError, omega_bi_b_rad_s: Vec3) -> Vec3:
    """Return the acceleration that keeps the rate error as it is, body axes [rad/s^2].

    d/dt (w - R w_t) = w' - R w_t' - (R w_t) x w, with R from target to body axes and R' v = R v x (w - R w_t).
    """
    x, y, z = cross(error.omega_ti_b_rad_s, omega_bi_b_rad_s)
    a, b, c = error.alpha_ti_b_rad_s2
    return (a + x, b + y, c + z)
