"""Guidance to a fixed attitude: the error quaternion, the short way round.

q and -q are the same attitude. A law that drives q_err to (1, 0, 0, 0) unwinds when it is handed the other sign, and
chatters when the sign is chosen afresh on every cycle near 180 degrees (Mayhew, Sanfelice & Teel, IEEE Trans. Automatic
Control 56(11), 2011).
"""

from __future__ import annotations

import math

from bus.errors import ConfigError
from bus.units import Vec4

HYSTERESIS_Q0 = 0.1  # the sign changes only when q0 < -0.1: 11.5 degrees past the half turn


class Guidance:
    """Attitude error with respect to a fixed target, its sign chosen with hysteresis."""

    __slots__ = ("_sign", "_target")

    def __init__(self, target_q: Vec4) -> None:
        """target_q: attitude to reach, q_it, scalar first; normalised here. Raises ConfigError when it is zero."""
        norm = math.sqrt(target_q[0] ** 2 + target_q[1] ** 2 + target_q[2] ** 2 + target_q[3] ** 2)
        if not norm > 1e-6:
            raise ConfigError(
                f"target_q = {target_q} has length {norm:g} and is no attitude; give four numbers, scalar first, "
                "for example [1, 0, 0, 0]"
            )
        self._target: Vec4 = (target_q[0] / norm, target_q[1] / norm, target_q[2] / norm, target_q[3] / norm)
        self.reset()

    @property
    def target_q(self) -> Vec4:
        """Attitude to reach, q_it, scalar first, unit length."""
        return self._target

    def reset(self) -> None:
        """Forget which sign was chosen; the next error has q0 >= 0."""
        self._sign = 0.0

    def find_error(self, q_ib: Vec4) -> Vec4:
        """Return q_tb = q_it^-1 q_ib, body with respect to target, scalar first.

        The first one has q0 >= 0. Later ones keep the sign chosen before until q0 would fall below -HYSTERESIS_Q0.
        """
        t0, tx, ty, tz = self._target
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
        if sign < 0.0:
            return (-q0, -qx, -qy, -qz)
        return (q0, qx, qy, qz)
