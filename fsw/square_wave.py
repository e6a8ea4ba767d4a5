"""A square wave, sample by sample: what wheels are probed and stirred with."""

from __future__ import annotations

import math
from typing import Final

from bus.errors import ConfigError

ROUND_OFF: Final = 1e-9  # of a period: sums of time steps


class SquareWave:
    """+1 in the first half of each period, -1 in the second.

    With room for rounding: a half that is one sample longer than the other would be a mean that adds up.
    """

    __slots__ = ("_period_s", "_t_s")

    def __init__(self, period_s: float) -> None:
        """period_s: above 0 where `step` is called."""
        self._period_s = period_s
        self.reset()

    def reset(self) -> None:
        """At the start of a period."""
        self._t_s = 0.0

    def step(self, dt_s: float) -> float:
        """Return the sign at this time, and go on by dt_s."""
        period_s = self._period_s
        sign = 1.0 if self._t_s < (0.5 - ROUND_OFF) * period_s else -1.0
        if dt_s > 0.0:
            self._t_s = math.fmod(self._t_s + dt_s, period_s)
            if period_s - self._t_s < ROUND_OFF * period_s:
                self._t_s = 0.0
        return sign


def check_wave(key: str, wave_period_s: float, period_s: float) -> None:
    """Raise ConfigError where a wave is too short for the control period; key: its setting."""
    if wave_period_s < 2.0 * (1.0 - ROUND_OFF) * period_s:
        raise ConfigError(
            f"{key} = {wave_period_s:g} s is less than two control periods of {period_s:g} s: "
            f"the wave would be a constant torque; at least {2.0 * period_s:g} s"
        )
