"""Drive: from the torques that were allocated to the commands of the wheels, as their frames can carry them.

What is allocated is the torque that the body is to feel of each wheel. A wheel with drag, or with less gain than it should
have, gives something else; the drive can add what is missing (spec of the command law, section 2.4):

    tau_m = (tau_rotor + drag(w) + f tanh(w / 0.5 rad/s)) / max(0.1, C_d C_t)

Torques here are those on the body, tau_rotor = -tau_rw: drag brakes the rotor and pushes the body along the spin.
"""

from __future__ import annotations

import math
from typing import Final

from bus.errors import ConfigError
from bus.icd.ranges import find_signal, quantise_torque
from bus.linear import ZERO3, ZERO4
from bus.units import Vec4
from fsw.records import ALL_WHEELS, ONES4, FourReadings, WheelCommands, WheelHealth
from fsw.settings import DriveConfig
from fsw.vehicle import Vehicle
from fsw.wheel_motor import FEED_FORWARD_RAD_S

OFF: Final = 0  # mode of a command frame
TORQUE: Final = 1
ALL_OFF, ALL_TORQUE = (OFF, OFF, OFF, OFF), (TORQUE, TORQUE, TORQUE, TORQUE)
_SIGNAL = find_signal("RW1_CMD", "TORQUE")
_SCALE: Final = _SIGNAL.scale
_LEAST: Final = round(_SIGNAL.minimum / _SCALE)
_LARGEST: Final = round(_SIGNAL.maximum / _SCALE)
ESTIMATES: Final = "wheel_kalman"  # the kind of wheel health that estimates gains and friction
LEAST_GAIN: Final = 0.1  # a gain below this is made up for as if it were this
REST = WheelCommands(ALL_OFF, ZERO4, 0)


def command_wheels(tau_rw_nm: Vec4, health: WheelHealth) -> WheelCommands:
    """Return the commands for these torques on the body [N m]; a wheel that is not available is switched off.

    The torques that come back are those that the wheels will read: whole steps of the frame's resolution, cut to its range.
    Whoever reckons with what was commanded reckons with these.
    """
    if health.available != ALL_WHEELS:
        a, b, c, d = tau_rw_nm
        p, q, r, s = health.available
        tau_rw_nm = (a if p else 0.0, b if q else 0.0, c if r else 0.0, d if s else 0.0)
        modes = (TORQUE if p else OFF, TORQUE if q else OFF, TORQUE if r else OFF, TORQUE if s else OFF)
    else:
        modes = ALL_TORQUE
    a, b, c, d = tau_rw_nm
    w1, w2, w3, w4 = round(a / _SCALE), round(b / _SCALE), round(c / _SCALE), round(d / _SCALE)
    if not (
        _LEAST <= w1 <= _LARGEST and _LEAST <= w2 <= _LARGEST and _LEAST <= w3 <= _LARGEST and _LEAST <= w4 <= _LARGEST
    ):
        (a, p), (b, q), (c, r), (d, s) = (quantise_torque(torque_nm) for torque_nm in tau_rw_nm)
        return WheelCommands(modes, (a, b, c, d), p + q + r + s)
    return WheelCommands(modes, (w1 * _SCALE, w2 * _SCALE, w3 * _SCALE, w4 * _SCALE), 0)


class Drive:
    """Commands the wheels, and makes up for their drag and lost gain as far as the settings say."""

    def __init__(self, config: DriveConfig, vehicle: Vehicle, monitor: str = ESTIMATES) -> None:
        """monitor : the kind of wheel health that flies along.

        Raises ConfigError where drag is to be made up for and a motor is not known, or gains and nobody estimates them.
        """
        if config.gain == "estimated" and monitor != ESTIMATES:
            raise ConfigError(
                f"drive.gain: estimated needs gains, and wheel_health: {monitor} estimates none; "
                f"take wheel_health: {{kind: {ESTIMATES}}} or drive.gain: none"
            )
        self._nominal = config.friction == "nominal"
        self._estimated = config.gain == "estimated"
        self.compensates = self._nominal or self._estimated
        self._motors = vehicle.wheel_motors
        unknown = [i for i in (0, 1, 2, 3) if vehicle.fitted[i] and vehicle.wheel_motors[i] is None]
        if self._nominal and unknown:
            raise ConfigError(
                f"drive.friction: nominal needs the drag of every wheel, and model.wheels[{unknown[0]}].motor is not given; "
                "give it (motor: {preset: ithaco_a}), or model.wheel_motor, or take drive.friction: none"
            )
        a, b, c, d = vehicle.wheels.max_torque_nm
        limits = [a, b, c, d]
        for i, motor in enumerate(vehicle.wheel_motors):
            if motor is not None:
                limits[i] = motor.max_torque_nm
        self._limits_nm = (limits[0], limits[1], limits[2], limits[3])

    def see(self, health: WheelHealth) -> WheelHealth:
        """Return the health that law and allocator are to reckon with: what is made up for here is not theirs to mend."""
        if not self._estimated or health.effectiveness == ONES4:
            return health
        p, q, r, s = health.available
        share = (1.0 if p else 0.0, 1.0 if q else 0.0, 1.0 if r else 0.0, 1.0 if s else 0.0)
        return health.replace(share, health.available, ZERO3)

    def command(self, tau_rw_nm: Vec4, health: WheelHealth, wheels: FourReadings) -> WheelCommands:
        """Return the commands that give these torques on the body [N m], at the wheels' speeds and health.

        What is meant by them is less than what was asked for where the motor cannot give that and the drag as well.
        """
        if not self.compensates:
            return command_wheels(tau_rw_nm, health)
        drag = [0.0, 0.0, 0.0, 0.0]  # that pushes the body
        gain = [1.0, 1.0, 1.0, 1.0]
        asked = [0.0, 0.0, 0.0, 0.0]
        for i in (0, 1, 2, 3):
            reading, motor = wheels[i], self._motors[i]
            speed = reading.speed_rad_s
            if self._nominal and motor is not None and reading.valid:  # a speed not known is not made up for
                drag[i] = motor.find_drag(speed)
            if self._estimated:
                if reading.valid:
                    drag[i] += health.friction_nm[i] * math.tanh(speed / FEED_FORWARD_RAD_S)
                product = health.driver_gain[i] * health.torque_gain[i]
                gain[i] = product if product > LEAST_GAIN else LEAST_GAIN
            limit, wanted = self._limits_nm[i], (tau_rw_nm[i] - drag[i]) / gain[i]
            asked[i] = -limit if wanted < -limit else limit if wanted > limit else wanted
        sent = command_wheels((asked[0], asked[1], asked[2], asked[3]), health)
        a, b, c, d = sent.tau_rw_nm
        p, q, r, s = health.available
        meant = (
            a * gain[0] + drag[0] if p else 0.0,
            b * gain[1] + drag[1] if q else 0.0,
            c * gain[2] + drag[2] if r else 0.0,
            d * gain[3] + drag[3] if s else 0.0,
        )
        return WheelCommands(sent.modes, sent.tau_rw_nm, sent.saturated, meant)
