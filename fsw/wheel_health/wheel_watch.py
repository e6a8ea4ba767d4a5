"""One wheel under watch: its filters, the alarm, what is wrong with it, and whether it is in use."""

from __future__ import annotations

import math
from typing import Final

from fsw.records import WheelReading
from fsw.wheel_health.deficit_filter import DeficitFilter
from fsw.wheel_health.driver_filter import DriverFilter
from fsw.wheel_health.rotor_filter import RotorFilter
from fsw.wheel_health.settings import WheelKalmanConfig
from fsw.wheel_kinds import (
    BIAS,
    DEAD,
    DRIVER_GAIN,
    FRICTION,
    NONE,
    RUNAWAY,
    SEIZED,
    SILENT,
    TORQUE_GAIN,
    UNKNOWN,
)
from fsw.wheel_motor import WheelMotor

NO_COMMAND: Final = 2  # status of a wheel that does not do what it is told, and says so
SPEED_LIMIT: Final = 3
DRIVER_SIGMAS: Final = 5.0  # a driver gain nearer to 1 than so many of its own is no alarm
DEAD_GAIN: Final = 0.1
BEYOND_GAIN: Final = 1.25  # a current beyond it, or against the command, is not the command's
AGAINST_GAIN: Final = -0.1
SURE_S: Final = 0.5  # a gain that is on its way passes through all others
FAR_NIS: Final = 12.0  # mean innovation squared, in its variance, of a current that no gain explains ...
FAR_S: Final = 3.0  # ... for this long: a filter that a step threw off has found back by then
OFF_STILL: Final = 0.5  # part of the driver's threshold below which its alarm ends
STILL_RAD_S: Final = 0.5  # below it a rotor stands: ten sigma of its telemetry
STILL_S: Final = 1.0
LOST_PART: Final = 0.85  # of the motor's torque that is as good as all of it
HELD_PART: Final = 0.6  # of the motor's torque that holds nothing but a rotor that stands
BLOW: Final = 2.0  # a deficit of so many times the motor's torque is the bearing that stops the rotor
MOVING_RAD_S: Final = 1.0
NEAR_GAIN: Final = 0.05  # of a wheel that is sound again
NEAR_FRICTION_NM: Final = 3e-4
LONGEST_PERIODS: Final = 10.0  # steps longer than this are not filtered over


class WheelWatch:
    """Filters, alarm and kind of one wheel. Of the rotor; commands come as torque on the body about the wheel's axis."""

    __slots__ = (
        "_beyond_s",
        "_blown",
        "_config",
        "_coulomb_nm",
        "_dead_s",
        "_drive_v_nm",
        "_driver",
        "_driver_off_s",
        "_far_s",
        "_gap",
        "_in_use_s",
        "_isolates",
        "_last_nm",
        "_late_s",
        "_log_odds",
        "_longest_s",
        "_lost_s",
        "_max_torque_nm",
        "_max_v",
        "_motor_nm",
        "_out_s",
        "_over_s",
        "_quiet_s",
        "_silent_s",
        "_started",
        "_stiff_nm",
        "_still_s",
        "_tries",
        "confidence",
        "deficit",
        "driver_gain",
        "in_use",
        "kind",
        "rotor",
        "sure",
    )  # fmt: skip

    def __init__(
        self,
        config: WheelKalmanConfig,
        motor: WheelMotor | None,
        inertia_kgm2: float,
        max_torque_nm: float,
        period_s: float,
    ) -> None:
        """motor: None of one that gives its command at once and without friction; its current is not looked at."""
        self._config = config
        self._isolates = config.reaction == "isolate"
        self._late_s = config.command_latency_s
        self._longest_s = LONGEST_PERIODS * period_s
        coulomb_nm = viscous_nm_s = 0.0
        torque_noise_nm = config.current_noise_a * 0.03  # of a motor that is not known
        self._driver: DriverFilter | None = None
        self._drive_v_nm = self._max_v = 0.0
        if motor is not None:
            coulomb_nm, viscous_nm_s = motor.coulomb_nm, motor.viscous_nm_s
            torque_noise_nm = config.current_noise_a * motor.torque_constant_nm_a
            self._driver = DriverFilter(motor, config.current_noise_a)
            self._drive_v_nm = 1.0 / (motor.driver_gain_a_v * motor.torque_constant_nm_a)
            self._max_v = motor.max_command_v
            max_torque_nm = motor.max_torque_nm
        self._max_torque_nm = max_torque_nm
        self._coulomb_nm = coulomb_nm
        self._stiff_nm = 2.0 * coulomb_nm + 0.1 * max_torque_nm  # torque that moves any rotor that is not seized
        noise = config.speed_noise_rad_s
        self.deficit = DeficitFilter(
            inertia_kgm2, coulomb_nm, viscous_nm_s, torque_noise_nm, noise, config.deficit_walk_nm_sqrt_s
        )
        self.rotor = RotorFilter(inertia_kgm2, coulomb_nm, viscous_nm_s, noise)
        self._log_odds = math.log(config.odds)
        self.reset()

    def reset(self) -> None:
        """Trust the wheel again, and forget that it was ever switched off."""
        self.in_use = True
        self._tries = 0
        self._silent_s = 0.0
        self._restart()

    def _restart(self) -> None:
        """A sound wheel, whose speed and current the next telemetry tells."""
        self._started = False
        self._gap = False
        self.kind = NONE
        self.confidence = 0.0
        self.sure = False  # whether gain and friction can be told apart
        self._beyond_s = self._dead_s = self._lost_s = self._over_s = self._quiet_s = self._driver_off_s = (
            self._far_s
        ) = self._still_s = 0.0
        self._last_nm = self._out_s = self._in_use_s = self._motor_nm = 0.0
        self._blown = False
        self.driver_gain = 1.0
        if self._driver is not None:
            self._driver.restart(0.0)
        self.deficit.restart(0.0)
        self.rotor.restart(0.0)

    # -- what is known of it -----------------------------------------------------------------------------------------

    @property
    def gain_sigma(self) -> float:
        """Standard deviation of C_t."""
        return math.sqrt(max(0.0, self.rotor.gain_variance))

    def find_share(self) -> float:
        """Share of its command that the wheel gives, 0 .. 1; 1 of a wheel without an alarm."""
        if not self.in_use:
            return 0.0
        if self.kind == NONE or self.kind == SILENT:
            return 1.0
        share = self.driver_gain * self.rotor.gain
        return 0.0 if share < 0.0 else 1.0 if share > 1.0 else share

    # -- a step ------------------------------------------------------------------------------------------------------

    def step(self, dt_s: float, torque_cmd_nm: float, reading: WheelReading) -> None:
        """Advance over dt_s, in which this torque on the body was commanded [N m], to what the wheel says now."""
        valid = reading.valid
        self._silent_s = 0.0 if valid else self._silent_s + dt_s
        if not self.in_use:
            self._wait(dt_s, valid)
            if not self.in_use:
                return
        if not self._started:
            if valid:
                self._start(reading)
                self._last_nm = -torque_cmd_nm
            else:
                self._note_silence()
            return
        # A wheel that says that it does not follow its command teaches nothing of what it would do if it did, and a value
        # that is held from an earlier tick nothing of this one.
        heard = valid and reading.new and reading.status != NO_COMMAND and reading.status != SPEED_LIMIT
        if not 0.0 < dt_s <= self._longest_s:
            self._gap = True
        else:
            self._filter(dt_s, torque_cmd_nm, reading, heard)
        if heard:
            if self._is_sound():  # on nearly every step there is nothing to judge
                self._over_s = self._driver_off_s = 0.0
                return
            self._judge(dt_s, reading.speed_rad_s)
        elif not valid:
            self._note_silence()

    def _is_sound(self) -> bool:
        """Whether nothing is wrong, was wrong, or may be about to be."""
        least, off = self._config.deficit_threshold_nm, self._config.driver_threshold
        return (
            self.kind == NONE
            and -least <= self.deficit.deficit_nm <= least
            and -off <= self.driver_gain - 1.0 <= off
            and self._tries == 0
        )

    def _start(self, reading: WheelReading) -> None:
        # The current is told with the sign of the torque on the body; the filters are of the rotor.
        self._started = True
        self.kind = NONE
        if self._driver is not None:
            self._driver.restart(-reading.current_a)
        self.deficit.restart(reading.speed_rad_s)
        self.rotor.restart(reading.speed_rad_s)

    def _filter(self, dt_s: float, torque_cmd_nm: float, reading: WheelReading, heard: bool) -> None:
        """All three filters; after a time without telemetry, speed and current begin anew at what is measured."""
        speed, driver = reading.speed_rad_s, self._driver
        if heard and self._gap:
            self._gap = False
            self.deficit.anchor(speed)
            self.rotor.anchor(speed)
            if driver is not None:
                driver.anchor(-reading.current_a)
            return
        self._gap = not heard
        torque, late_s = -torque_cmd_nm, self._late_s
        if late_s > 0.0:  # for a part of the time the command before was still in force
            last, self._last_nm = self._last_nm, torque
            if late_s >= dt_s:
                torque = self._drive(dt_s, last, reading, heard)
            else:
                before = self._drive(late_s, last, reading, False)
                after = self._drive(dt_s - late_s, torque, reading, heard)
                torque = (late_s * before + (dt_s - late_s) * after) / dt_s
        else:
            torque = self._drive(dt_s, torque, reading, heard)
        self._motor_nm = torque
        self.deficit.step(dt_s, torque, speed, heard)
        self.rotor.step(dt_s, torque, speed, heard)

    def _drive(self, dt_s: float, torque_nm: float, reading: WheelReading, heard: bool) -> float:
        """Mean torque of a sound motor at the current that the driver makes of a command, both of the rotor [N m]."""
        driver = self._driver
        if driver is None:
            return torque_nm
        command_v, most = torque_nm * self._drive_v_nm, self._max_v
        command_v = -most if command_v < -most else most if command_v > most else command_v
        driver.step(dt_s, command_v, -reading.current_a, heard)
        self.driver_gain = driver.gain
        return driver.torque_nm

    def _judge(self, dt_s: float, speed_rad_s: float) -> None:
        """Alarm and kind, after a measurement."""
        config, kind = self._config, self.kind
        deficit = abs(self.deficit.deficit_nm)
        over = deficit > config.deficit_threshold_nm
        self._over_s = self._over_s + dt_s if over else 0.0
        off = self._is_driver_off(kind)
        self._driver_off_s = self._driver_off_s + dt_s if off else 0.0
        if kind in (NONE, SILENT):
            late_s = 0.5 * dt_s  # so that five samples of a tenth of a second are half a second
            lacking = self._over_s > config.deficit_alarm_s - late_s
            if lacking:
                self.rotor.doubt()
            odd = self._driver_off_s > config.driver_alarm_s - late_s
            if odd and self._driver is not None:
                self._driver.doubt()
            if not lacking and not odd:
                self.kind, self.confidence, self.sure = NONE, 0.0, False
                self._in_use_s += dt_s
                if self._tries and self._in_use_s > config.retry_s:
                    self._tries = 0  # it has done well for long enough
                return
            self._quiet_s = self._far_s = self._still_s = self._beyond_s = self._dead_s = self._lost_s = 0.0
            self._blown = False
            kind = UNKNOWN
        quiet = not off and deficit < 0.5 * config.deficit_threshold_nm
        self._quiet_s = self._quiet_s + dt_s if quiet else 0.0
        self._look_for_standstill(dt_s, speed_rad_s)
        if self._quiet_s > config.release_s and self._is_near(kind, speed_rad_s):
            self._clear(kind, speed_rad_s)
            return
        self.kind = self._classify(dt_s, kind, off)
        if self._isolates and (self.kind == SEIZED or self.kind == RUNAWAY or self.kind == DEAD):
            self.in_use, self._out_s = False, 0.0

    def _clear(self, kind: int, speed_rad_s: float) -> None:
        """The alarm is over. What was never told apart is forgotten."""
        if kind == UNKNOWN:
            self.rotor.restart(speed_rad_s)
        self.kind, self.confidence, self.sure = NONE, 0.0, False
        self._over_s = 0.0

    def _is_driver_off(self, kind: int) -> bool:
        driver = self._driver
        if driver is None:
            return False
        off = abs(driver.gain - 1.0)
        if kind in (DRIVER_GAIN, RUNAWAY, DEAD):
            return off > OFF_STILL * self._config.driver_threshold
        return off > self._config.driver_threshold and off * off > DRIVER_SIGMAS * DRIVER_SIGMAS * driver.variance

    def _look_for_standstill(self, dt_s: float, speed_rad_s: float) -> None:
        """How long the motor's torque has been missing, and how long the rotor has stood for that, or after a blow."""
        torque, deficit = abs(self._motor_nm), abs(self.deficit.deficit_nm)
        if deficit > BLOW * self._max_torque_nm:
            self._blown = True
        held = torque > self._stiff_nm and deficit > HELD_PART * torque
        lost = torque > self._config.deficit_threshold_nm and deficit > LOST_PART * torque
        self._lost_s = self._lost_s + dt_s if lost else 0.0
        still = abs(speed_rad_s) < STILL_RAD_S and (self._blown or held)
        self._still_s = self._still_s + dt_s if still else 0.0

    def _is_near(self, kind: int, speed_rad_s: float) -> bool:
        """Whether a fault of this kind has gone, given that no torque is missing."""
        if kind == SEIZED:
            return abs(speed_rad_s) > MOVING_RAD_S
        if kind in (TORQUE_GAIN, FRICTION, BIAS):
            return abs(self.rotor.gain - 1.0) < NEAR_GAIN and abs(self.rotor.friction_nm) < NEAR_FRICTION_NM
        return True

    def _classify(self, dt_s: float, kind: int, driver_off: bool) -> int:
        """What is wrong, given that something is."""
        driver = self._driver
        if driver is not None and driver_off:
            self._far_s = self._far_s + dt_s if driver.mean_nis > FAR_NIS else 0.0
            self.confidence = 1.0
            gain = driver.gain
            beyond = gain > BEYOND_GAIN or gain < AGAINST_GAIN
            self._beyond_s = self._beyond_s + dt_s if beyond else 0.0
            self._dead_s = self._dead_s + dt_s if -DEAD_GAIN < gain < DEAD_GAIN else 0.0
            if kind == RUNAWAY or self._beyond_s > SURE_S or self._far_s > FAR_S:
                return RUNAWAY
            return DEAD if self._dead_s > SURE_S else DRIVER_GAIN
        if kind == SEIZED or self._still_s > STILL_S - 0.5 * dt_s:
            self.confidence = 1.0
            return SEIZED
        return self._tell_gain_from_friction(kind)

    def _tell_gain_from_friction(self, kind: int) -> int:
        """By the odds of one against the other, once the data since the alarm can tell."""
        rotor, sigma = self.rotor, self._config.gain_sigma
        odds = rotor.weigh_gain()
        size = abs(odds)
        self.confidence = 1.0 / (1.0 + math.exp(-size)) if size < 700.0 else 1.0
        self.sure = rotor.gain_variance < sigma * sigma
        if not self.sure or size < self._log_odds:
            return kind if kind in (TORQUE_GAIN, FRICTION, BIAS) else UNKNOWN
        if odds > 0.0:
            # In a quiet hold the split of gain and friction drifts, and no bearing has less friction than none: a gain that
            # needs that is no sign of a dead wheel, unless all its torque is missing.
            possible = rotor.friction_nm > -self._coulomb_nm - self._config.deficit_threshold_nm
            dead = rotor.gain < DEAD_GAIN and (possible or self._lost_s > SURE_S) and self._still_s == 0.0
            return DEAD if dead else TORQUE_GAIN
        # Friction can fall to nothing, and half of it may be the temperature's; what drives the rotor beyond that is none.
        spread = 2.0 * math.sqrt(max(0.0, rotor.friction_variance))
        return BIAS if rotor.friction_nm < -self._config.deficit_threshold_nm - spread else FRICTION

    # -- out of use --------------------------------------------------------------------------------------------------

    def _note_silence(self) -> None:
        if self._silent_s > 0.0:
            self.kind, self.confidence, self.sure = SILENT, 1.0, False
            if self._isolates and self._silent_s > self._config.silent_s:
                self.in_use, self._out_s = False, 0.0

    def _wait(self, dt_s: float, valid: bool) -> None:
        """A silent wheel is used again once it is heard; another is tried again after a while, a few times in a row."""
        self._out_s += dt_s
        if self.kind == SILENT:
            if valid:
                self._restart()
                self.in_use = True
        elif self._out_s > self._config.retry_s and self._tries < self._config.retries:
            tries = self._tries + 1
            self._restart()
            self._tries = tries
            self.in_use = True
