"""Modes of the flight software and the rules between them.

    standby --sensors good--> initial mode (detumble when the rate is high)
    detumble --rate low--> point          point --rate high--> detumble
    any --sensors stale, or safe requested--> safe --sensors good for a while--> standby

Safe mode damps the rate while the gyro is good and commands zero torque otherwise.
"""

from __future__ import annotations

from enum import IntEnum

from bus.units import DEG, Vec3
from fsw.config import ModesConfig


class Mode(IntEnum):
    """As the MODE signal of CYCLE_DONE carries it."""

    STANDBY = 0
    DETUMBLE = 1
    POINT = 2
    SAFE = 3


STANDBY, DETUMBLE, POINT, SAFE = Mode  # for every cycle: `Mode.SAFE` is looked up through a property in Python 3.11


class ModeManager:
    """Decides the mode of every cycle and remembers why it last changed."""

    def __init__(self, config: ModesConfig) -> None:
        self._initial = Mode[config.initial.upper()]
        self._detumble_above = (config.detumble_above_deg_s * DEG) ** 2  # rates squared [rad^2/s^2]
        self._point_below = (config.point_below_deg_s * DEG) ** 2
        self._recover_after = config.recover_after_ticks
        self.reset()

    def reset(self) -> None:
        """Back to standby, as after boot."""
        self.mode = STANDBY
        self.reason = "boot"
        self.changes = 0
        self._good_ticks = 0

    def step(self, attitude_good: bool, rate_good: bool, omega_bi_b_rad_s: Vec3, safe_requested: bool) -> Mode:
        """Mode of this cycle.

        attitude_good, rate_good : the estimate is fit for pointing / for damping
        safe_requested           : detection or the executive asks for safe mode
        """
        good = attitude_good and rate_good and not safe_requested
        self._good_ticks = self._good_ticks + 1 if good else 0
        mode = self.mode
        if mode is SAFE:
            if self._initial is not SAFE and self._good_ticks >= self._recover_after:
                self._enter(STANDBY, "sensors good again")
        elif mode is STANDBY:
            if safe_requested:
                self._enter(SAFE, "safe mode requested")
            elif good and self._initial is not STANDBY:
                self._enter(self._start(omega_bi_b_rad_s), "sensors good")
        elif not good:
            self._enter(SAFE, _why(attitude_good, rate_good))
        else:
            x, y, z = omega_bi_b_rad_s
            square = x * x + y * y + z * z
            if mode is DETUMBLE:
                if square < self._point_below and self._initial is not DETUMBLE:
                    self._enter(POINT, "rate low")
            elif square > self._detumble_above:
                self._enter(DETUMBLE, "rate high")
        return self.mode

    def _start(self, omega_bi_b_rad_s: Vec3) -> Mode:
        x, y, z = omega_bi_b_rad_s
        if self._initial is POINT and x * x + y * y + z * z > self._detumble_above:
            return DETUMBLE
        return self._initial

    def _enter(self, mode: Mode, reason: str) -> None:
        self.mode = mode
        self.reason = reason
        self.changes += 1


def _why(attitude_good: bool, rate_good: bool) -> str:
    if not rate_good:
        return "rate stale"
    return "safe mode requested" if attitude_good else "attitude stale"
