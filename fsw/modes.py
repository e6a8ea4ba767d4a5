"""Modes of the flight software and the rules between them.

    standby --attitude and rate good--> initial mode (detumble when the rate is high)
    standby --rate good, and high or no attitude for a while--> detumble (or safe, where that is the initial mode)
    detumble --rate low and attitude good--> point        point --rate high--> detumble
    point --attitude or rate stale--> safe                detumble --rate stale--> safe
    point --the wheels in use span fewer than three axes--> degraded --they span three again--> point
    any --safe requested--> safe --attitude and rate good for a while--> standby
    any --commanded--> standby, safe        point, degraded --commanded--> detumble

A command says which mode to be in from now on, as the initial mode does at boot: standby and safe are entered at once and
kept, point and detumble by the rules above, out of whatever mode there is.

Detumble and safe mode damp the rate, for which a good rate is enough; without one the wheels are commanded to rest.
Degraded is pointing with what is left: about the axes that the wheels still reach; the rate about the others drifts. It is
left as pointing is.
"""

from __future__ import annotations

import math
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

# what can be commanded: degraded comes of the wheels alone
MODE_VERBS: dict[str, Mode] = {f"mode.{mode.name.lower()}": mode for mode in (STANDBY, DETUMBLE, POINT, SAFE)}


class ModeManager:
    """Decides the mode of every cycle and remembers why it last changed, and what it waits for."""

    def __init__(self, config: ModesConfig, tick_s: float) -> None:
        """tick_s: time between two calls of `step` [s]."""
        self._at_boot = Mode[config.initial.upper()]
        self._detumble_above = (config.detumble_above_deg_s * DEG) ** 2  # rates squared [rad^2/s^2]
        self._point_below = (config.point_below_deg_s * DEG) ** 2
        self.recover_after_ticks = config.recover_after_ticks  # good ticks before safe is left
        self._patience_ticks = max(1, round(config.star_stale_after_s / tick_s))
        self.reset()

    def reset(self) -> None:
        """Back to standby, as after boot."""
        self._initial = self._at_boot  # to be in, as far as the rules allow
        self.mode = STANDBY
        self.reason = "boot"
        self.changes = 0
        self.waits_for = ""  # what keeps it in this mode, empty where nothing does
        self._good_ticks = 0
        self._rate_ticks = 0  # with a good rate and nothing else

    @property
    def intended(self) -> Mode:
        """The mode to be in once everything is as it should be."""
        return self._initial

    @property
    def detumble_above_rad_s(self) -> float:
        """The rate above which pointing is given up for damping [rad/s]."""
        return math.sqrt(self._detumble_above)

    @detumble_above_rad_s.setter
    def detumble_above_rad_s(self, rate_rad_s: float) -> None:
        self._detumble_above = rate_rad_s * rate_rad_s

    @property
    def point_below_rad_s(self) -> float:
        """The rate below which damping ends [rad/s]."""
        return math.sqrt(self._point_below)

    @point_below_rad_s.setter
    def point_below_rad_s(self, rate_rad_s: float) -> None:
        self._point_below = rate_rad_s * rate_rad_s

    def command(self, mode: Mode) -> None:
        """Be in this mode from now on, as far as the rules allow: one of MODE_VERBS."""
        self._initial = mode
        pointing = self.mode is POINT or self.mode is DEGRADED
        if (mode is not self.mode and (mode is STANDBY or mode is SAFE)) or (mode is DETUMBLE and pointing):
            self._enter(mode, "commanded")

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
        elif self._good_ticks >= self.recover_after_ticks:
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
