"""Which torques acted in an interval, where commands take a while to reach the wheels."""

from __future__ import annotations

import math
from typing import Final

from bus.linear import ZERO4
from bus.units import Vec4

_SPARE: Final = 3  # intervals kept beyond the latency: the interval itself, and two for ones of uneven length


class CommandDelay:
    """The commands of the last intervals, newest first."""

    __slots__ = ("_latency_s", "_spans_s", "_torques")

    def __init__(self, latency_s: float, period_s: float) -> None:
        """latency_s: from the start of an interval to its command being in force; period_s: nominal interval [s]."""
        self._latency_s = latency_s
        self._spans_s: list[float] = [0.0] * (math.ceil(latency_s / period_s) + _SPARE)
        self._torques: list[Vec4] = []
        self.reset()

    def reset(self) -> None:
        """Forget all commands: before the first one the wheels were told to rest."""
        count = len(self._spans_s)
        self._spans_s = [0.0] * count
        self._torques = [ZERO4] * count

    def take(self, dt_s: float, torque_nm: Vec4) -> Vec4:
        """Return the mean torque in force over the interval of dt_s that ends now [N m], whose command was torque_nm."""
        if self._latency_s == 0.0:
            return torque_nm
        self._spans_s.insert(0, dt_s)
        self._spans_s.pop()
        self._torques.insert(0, torque_nm)
        self._torques.pop()
        skip, need = self._latency_s, dt_s
        a = b = c = d = 0.0
        last = len(self._spans_s) - 1
        for i in range(last + 1):
            span = self._spans_s[i]
            if skip >= span and i < last:
                skip -= span
                continue
            left = span - skip
            skip = 0.0
            part = need if left > need or i == last else left
            p, q, r, s = self._torques[i]
            a, b, c, d = a + part * p, b + part * q, c + part * r, d + part * s
            need -= part
            if need <= 0.0:
                break
        return (a / dt_s, b / dt_s, c / dt_s, d / dt_s)
