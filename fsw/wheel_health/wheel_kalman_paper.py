"""Wheel alarms as the paper has them: residuals of a Kalman filter of current and speed. They name no cause."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from bus.units import Vec3, Vec4
from fsw.families import WheelHealthMonitor
from fsw.records import FourReadings, WheelHealth, WheelReading
from fsw.vehicle import Vehicle
from fsw.wheel_health.paper_filter import PaperFilter
from fsw.wheel_health.settings import WheelKalmanPaperConfig
from fsw.wheel_kinds import NONE, SILENT, UNKNOWN
from fsw.wheel_motor import WheelMotor

RELEASE: Final = 0.5  # an alarm ends below this part of the threshold
AT_ONCE_RAD_S: Final = 1e4  # bandwidth of a motor that is not known: it gives its command at once
LONGEST_PERIODS: Final = 10.0


class WheelKalmanPaperInternals(NamedTuple):
    """What the alarms go by: low-passed residuals, in sigmas of a sound wheel's."""

    current_sigmas: Vec4
    speed_sigmas: Vec4


class PaperWatch:
    """One wheel: filter, low-passed residuals, alarm."""

    __slots__ = (
        "_config", "_drive", "_filter", "_has_motor", "_longest_s", "_max_command", "_over_s", "_quiet_s", "_started",
        "current", "kind", "speed",
    )  # fmt: skip

    def __init__(
        self, config: WheelKalmanPaperConfig, motor: WheelMotor | None, inertia_kgm2: float, period_s: float
    ) -> None:
        self._config = config
        self._longest_s = LONGEST_PERIODS * period_s
        self._has_motor = motor is not None
        if motor is None:  # i is the torque itself
            f, push, dry = (-AT_ONCE_RAD_S, 0.0, 1.0 / inertia_kgm2, 0.0), AT_ONCE_RAD_S, 0.0
            self._drive, self._max_command = 1.0, math.inf
        else:
            constant, dry = motor.torque_constant_nm_a, motor.coulomb_nm / inertia_kgm2
            turning, viscous = constant / inertia_kgm2, motor.viscous_nm_s / inertia_kgm2
            self._drive, self._max_command = 1.0 / (motor.driver_gain_a_v * constant), motor.max_command_v
            if config.model == "voltage":
                inductance = config.inductance_h
                f = (-config.resistance_ohm / inductance, -constant / inductance, turning, -viscous)
                push = 1.0 / inductance
            else:  # a current driver rejects the back-EMF: R/L -> w_d, Psi/L -> 0, 1/L -> w_d G_d
                f = (-motor.bandwidth_rad_s, 0.0, turning, -viscous)
                push = motor.bandwidth_rad_s * motor.driver_gain_a_v
        self._filter = PaperFilter(f, push, dry, config.current_noise_a, config.speed_noise_rad_s)
        self.reset()

    def reset(self) -> None:
        """A sound wheel, whose speed and current the next telemetry tells."""
        self._started = False
        self.kind = NONE
        self.current = self.speed = 0.0
        self._over_s = self._quiet_s = 0.0

    def step(self, dt_s: float, torque_cmd_nm: float, reading: WheelReading) -> None:
        """Advance over dt_s, in which this torque on the body was commanded [N m]."""
        heard = reading.valid and reading.new  # a value that is held from an earlier tick is no measurement
        command = -torque_cmd_nm * self._drive
        command = min(max(command, -self._max_command), self._max_command)
        current = -reading.current_a if self._has_motor else command
        if not self._started or not 0.0 < dt_s <= self._longest_s:
            if heard:
                self._filter.restart(current, reading.speed_rad_s)
                self._started = True
            return
        self._filter.step(dt_s, command, current, reading.speed_rad_s, heard)
        if not heard:
            if self.kind == NONE and not reading.valid:
                self.kind = SILENT
            return
        if self.kind == SILENT:  # what has come about in the meantime is no residual
            self._filter.restart(current, reading.speed_rad_s)
            self.kind = NONE
            return
        self._judge(dt_s)

    def _judge(self, dt_s: float) -> None:
        config, (y, z), (s, t) = self._config, self._filter.residual, self._filter.deviation
        gain = dt_s / (config.filter_s + dt_s)
        sound = math.sqrt(gain / (2.0 - gain))  # sigma of low-passed white noise of sigma 1
        self.current += gain * (y / (s * sound) - self.current)
        self.speed += gain * (z / (t * sound) - self.speed)
        size = max(abs(self.current), abs(self.speed))
        self._over_s = self._over_s + dt_s if size > config.threshold_sigma else 0.0
        self._quiet_s = self._quiet_s + dt_s if size < RELEASE * config.threshold_sigma else 0.0
        if self._over_s > config.alarm_s - 0.5 * dt_s:
            self.kind = UNKNOWN
        elif self._quiet_s > config.release_s:
            self.kind = NONE


class WheelKalmanPaper(WheelHealthMonitor):
    """The filter of (13)-(16), one a wheel. A lasting fault leaves a bias in the residual; how large depends on Q and R."""

    def __init__(self, config: WheelKalmanPaperConfig, vehicle: Vehicle, period_s: float) -> None:
        """period_s: nominal time between calls of `step` [s]."""
        self._fitted = vehicle.fitted
        a, b, c, d = (
            PaperWatch(config, motor, inertia, period_s)
            for motor, inertia in zip(vehicle.wheel_motors, vehicle.wheel_inertia_kgm2, strict=True)
        )
        self._watches = (a, b, c, d)
        self.reset()

    def reset(self) -> None:
        """Trust every wheel again."""
        for watch in self._watches:
            watch.reset()
        self._sent: Vec4 | None = None

    @property
    def internals(self) -> WheelKalmanPaperInternals:
        """Residuals of each wheel."""
        a, b, c, d = self._watches
        return WheelKalmanPaperInternals(
            (a.current, b.current, c.current, d.current), (a.speed, b.speed, c.speed, d.speed)
        )

    def note_sent(self, tau_rw_sent_nm: Vec4) -> None:
        """The torques that the frames carried, for the next call of `step` [N m]."""
        self._sent = tau_rw_sent_nm

    def step(
        self, dt_s: float, wheels: FourReadings, tau_rw_cmd_nm: Vec4, tau_fault_hat_b_nm: Vec3 | None
    ) -> WheelHealth:
        """Return alarms. The fault torque is not needed."""
        sent = tau_rw_cmd_nm if self._sent is None else self._sent
        self._sent = None
        for i in (0, 1, 2, 3):
            if self._fitted[i]:
                self._watches[i].step(dt_s, sent[i], wheels[i])
        a, b, c, d = self._watches
        kind = (a.kind, b.kind, c.kind, d.kind)
        alarm = (kind[0] == UNKNOWN, kind[1] == UNKNOWN, kind[2] == UNKNOWN, kind[3] == UNKNOWN)
        return WheelHealth(alarm=alarm, kind=kind)
