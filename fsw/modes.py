"""Modes of the flight software and the rules between them.

    standby --attitude and rate good--> initial mode (detumble when the rate is high)
    standby --rate good, and high or no attitude for a while--> detumble (or safe, where that is the initial mode)
    detumble --rate low and attitude good--> point        point --rate high--> detumble
    point --attitude or rate stale--> safe                detumble --rate stale--> safe
    point --the wheels in use span fewer than three axes--> degraded --they span three again--> point
    any --safe requested--> safe --attitude and rate good for a while--> standby

Detumble and safe mode damp the rate, for which a good rate is enough; without one the wheels are commanded to rest.
Degraded is pointing with what is left: about the axes that the wheels still reach; the rate about the others drifts. It is
left as pointing is.
"""

from __future__ import annotations

from enum import IntEnum

from bus.units import DEG, Vec3
from fsw.settings import ModesConfig


class Mode(IntEnum):
    """As the MODE signal of CYCLE_DONE carries it."""

    STANDBY = 0
    DETUMBLE = 1
    POINT = 2
    SAFE = 3
    DEGRADED = 4


# for every cycle: `Mode.SAFE` is looked up through a property in Python 3.11
STANDBY, DETUMBLE, POINT, SAFE, DEGRADED = Mode


class ModeManager:
    """Decides the mode of every cycle and remembers why it last changed, and what it waits for."""

    def __init__(self, config: ModesConfig, tick_s: float) -> None:
        """tick_s: time between two calls of `step` [s]."""
        self._initial = Mode[config.initial.upper()]
        self._detumble_above = (config.detumble_above_deg_s * DEG) ** 2  # rates squared [rad^2/s^2]
        self._point_below = (config.point_below_deg_s * DEG) ** 2
        self._recover_after = config.recover_after_ticks
        self._patience_ticks = max(1, round(config.star_stale_after_s / tick_s))
        self.reset()

    def reset(self) -> None:
        """Back to standby, as after boot."""
        self.mode = STANDBY
        self.reason = "boot"
        self.changes = 0
        self.waits_for = ""  # what keeps it in this mode, empty where nothing does
        self._good_ticks = 0
        self._rate_ticks = 0  # with a good rate and nothing else

    def step(
        self,
        attitude_good: bool,
        rate_good: bool,
        omega_bi_b_rad_s: Vec3,
        safe_requested: bool,
        out_of_reach: str = "",
    ) -> Mode:
        """Mode of this cycle.

        attitude_good, rate_good : the estimate is fit for pointing / for damping
        safe_requested           : detection or the executive asks for safe mode
        out_of_reach             : why the wheels do not reach all three axes, in words; empty where they do
        """
        good = attitude_good and rate_good and not safe_requested
        self._good_ticks = self._good_ticks + 1 if good else 0
        mode = self.mode
        if good and (mode is POINT or mode is DEGRADED):
            x, y, z = omega_bi_b_rad_s
            if x * x + y * y + z * z > self._detumble_above:
                self._enter(DETUMBLE, "rate high")
            elif mode is DEGRADED:
                if out_of_reach == "":
                    self._enter(POINT, "the wheels span three axes again")
            elif out_of_reach != "":
                self._enter(DEGRADED, out_of_reach)
        elif mode is STANDBY:
            self._leave_standby(good, rate_good, omega_bi_b_rad_s, safe_requested)
        elif mode is SAFE:
            self._leave_safe(attitude_good, rate_good, safe_requested)
        elif safe_requested or not rate_good or (mode is not DETUMBLE and not attitude_good):
            self._enter(SAFE, _why(attitude_good, rate_good, safe_requested))
        else:
            self._leave_detumble(attitude_good, _square(omega_bi_b_rad_s))
        return self.mode

    def _leave_standby(self, good: bool, rate_good: bool, omega_bi_b_rad_s: Vec3, safe_requested: bool) -> None:
        if safe_requested:
            self._enter(SAFE, "safe mode requested")
        elif self._initial is STANDBY:
            self.waits_for = ""
        elif good:
            high = self._initial is POINT and _square(omega_bi_b_rad_s) > self._detumble_above
            self._enter(DETUMBLE if high else self._initial, "sensors good")
        elif rate_good:
            self.waits_for = "an attitude from the star tracker"
            self._rate_ticks += 1
            if self._rate_ticks >= self._patience_ticks or _square(omega_bi_b_rad_s) > self._detumble_above:
                self._enter(SAFE if self._initial is SAFE else DETUMBLE, "rate good, no attitude yet")
        else:
            self._rate_ticks = 0
            self.waits_for = "a rate from the gyro"

    def _leave_detumble(self, attitude_good: bool, square: float) -> None:
        if square >= self._point_below:
            self.waits_for = "the rate to fall"
        elif self._initial is DETUMBLE:
            self.waits_for = ""
        elif attitude_good:
            self._enter(POINT, "rate low")
        else:
            self.waits_for = "an attitude from the star tracker"

    def _leave_safe(self, attitude_good: bool, rate_good: bool, safe_requested: bool) -> None:
        if self._initial is SAFE:
            self.waits_for = ""
        elif self._good_ticks >= self._recover_after:
            self._enter(STANDBY, "sensors good again")
        elif self._good_ticks:
            self.waits_for = "the sensors to stay good"
        elif safe_requested:
            self.waits_for = "the request for safe mode to end"
        else:
            self.waits_for = "a rate from the gyro" if not rate_good else "an attitude from the star tracker"

    def _enter(self, mode: Mode, reason: str) -> None:
        self.mode = mode
        self.reason = reason
        self.waits_for = ""
        self.changes += 1
        self._rate_ticks = 0


def _square(v: Vec3) -> float:
    x, y, z = v
    return x * x + y * y + z * z


def _why(attitude_good: bool, rate_good: bool, safe_requested: bool) -> str:
    if not rate_good:
        return "rate stale"
    return "safe mode requested" if safe_requested else "attitude stale"
