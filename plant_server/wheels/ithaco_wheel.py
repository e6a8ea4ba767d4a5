"""One wheel of the ITHACO Type-A class in a bank: commands, power, faults, flags, imbalance."""

from __future__ import annotations

import math
from typing import Final

from bus.linear import ZERO3, cross
from bus.units import Vec3
from bus.wheels import CURRENT, EMF_LIMITED, OVERSPEED, OVERTEMP, SPEED, TORQUE, UNDERVOLTAGE
from plant_server.config import WheelConfig
from plant_server.faults.timeline import FaultTimeline
from plant_server.wheels.ithaco_rotor import IthacoRotor
from plant_server.wheels.motor import fill_motor
from plant_server.wheels.wheel import Wheel

OVERTEMP_C: Final = 70.0  # chosen
UNDERVOLTAGE_V: Final = 16.0  # the least of the bus that the source allows
OFF_S: Final = 1.0  # how long a power cycle takes; chosen
# The wheel's own speed loop, tau = J (2 w e + w^2 integral of e) with w = LOOP_RAD_S; chosen, well below the driver's 9.
LOOP_RAD_S: Final = 1.0
NEVER: Final = 1 << 62


class IthacoWheel(Wheel):
    """Electronics and rotor. It takes torque, current or speed commands; without one, or without power, it coasts."""

    __slots__ = (
        "_axis_b", "_body_rad_s", "_dt_s", "_h_nms", "_has_run", "_integral_rad", "_is_powered", "_motor", "_off_until",
        "_sideways_b", "_step", "_upwards_b", "_volt_per_nm", "latch", "rotor",
    )  # fmt: skip

    def __init__(self, unit: str, config: WheelConfig, timeline: FaultTimeline, step_s: float, axis_b: Vec3) -> None:
        self._motor = motor = fill_motor(config)
        super().__init__(unit, motor.inertia, motor.overspeed, timeline, step_s)
        self.rotor = IthacoRotor(motor)
        self.latch = 0  # bits of bus/wheels.py
        self._dt_s = step_s
        self._volt_per_nm = 1.0 / (motor.driver_gain * motor.torque_constant)
        self._axis_b = axis_b
        self._sideways_b, self._upwards_b = _span_plane(axis_b)
        self._h_nms = 0.0
        self._body_rad_s = 0.0  # rate of the body about the axis, at the start of the last step
        self._has_run = False
        self._integral_rad = 0.0  # of the speed loop
        self._is_powered = True
        self._off_until = -1  # step
        self._step = 0

    def start(self, h_nms: float, speed_rad_s: float) -> None:
        """Take the absolute spin momentum and the speed relative to the body at t = 0."""
        self._h_nms = h_nms
        self._body_rad_s = h_nms / self.inertia - speed_rad_s

    def drive(self, step: int, command: float, mode: int, speed_rad_s: float) -> float:
        """Return the mean torque on the body over the integration step `step` [N m].

        The body's rate over the step goes on as it did over the last one: the rotor's own equations need no more of the
        body, and what they take from the body is what they give it.
        """
        dt_s, state, rotor = self._dt_s, self.state, self.rotor
        self._step = step
        body = self._h_nms / self.inertia - speed_rad_s
        body_rad_s2 = (body - self._body_rad_s) / dt_s if self._has_run else 0.0
        self._body_rad_s, self._has_run = body, True
        command_v = self._find_command(step, command, mode, speed_rad_s)
        if self._pending:
            self._note_changes(step, command_v, speed_rad_s)
        torque = -rotor.advance(command_v, self._h_nms, body, body_rad_s2, step * dt_s, dt_s, state)
        self._h_nms -= torque * dt_s
        self.current_a = -rotor.current_a
        self._note_limits(speed_rad_s)
        return torque

    def _find_command(self, step: int, command: float, mode: int, speed_rad_s: float) -> float:
        """Return the command to the driver [V], positive with the torque on the rotor."""
        motor, most = self._motor, self._motor.max_command
        if not self._is_powered or step < self._off_until:
            self._integral_rad = 0.0
            return 0.0
        if mode == TORQUE:
            volts = -command * self._volt_per_nm
        elif mode == CURRENT:
            volts = -command / motor.driver_gain
        elif mode == SPEED:
            error = command - speed_rad_s
            per_rad_s = motor.inertia * LOOP_RAD_S * self._volt_per_nm
            volts = per_rad_s * (2.0 * error + LOOP_RAD_S * self._integral_rad)
            if abs(volts) < most or volts * error < 0.0:
                self._integral_rad += error * self._dt_s
        else:
            volts = 0.0
        if mode != SPEED:
            self._integral_rad = 0.0
        return most if volts > most else -most if volts < -most else volts

    def _note_limits(self, speed_rad_s: float) -> None:
        rotor, state = self.rotor, self.state
        rotor.note_limits(speed_rad_s, state)
        self.limited = rotor.overspeed
        bus_v = state.bus_v if state.has_bus else self._motor.settings.bus_v
        bits = OVERSPEED if rotor.overspeed else 0
        if rotor.emf_limited:
            bits |= EMF_LIMITED
        if rotor.temperature_c > OVERTEMP_C:
            bits |= OVERTEMP
        if bus_v < UNDERVOLTAGE_V:
            bits |= UNDERVOLTAGE
        self.latch |= bits

    def _note_changes(self, step: int, command_v: float, speed_rad_s: float) -> None:
        """Note which of the pending faults make the current or the torque of this step another."""
        rotor, t_s = self.rotor, step * self._dt_s
        now = rotor.find_rates(command_v, rotor.current_a, speed_rad_s, t_s, self.state, 0.0, 0.0)
        for fault, without in self._pending:
            if rotor.find_rates(command_v, rotor.current_a, speed_rad_s, t_s, without, 0.0, 0.0) != now:
                self._note(fault, step)

    # -- electronics ---------------------------------------------------------------------------------------------------

    @property
    def bus_v(self) -> float:
        """Voltage that it is given."""
        return self.state.bus_v if self.state.has_bus else self._motor.settings.bus_v

    def set_power(self, on: bool) -> None:
        """Switch it off or on; off, its motor has no current."""
        self._is_powered = on
        self._off_until = -1

    def power_cycle(self) -> None:
        """Switch it off for OFF_S."""
        self._is_powered = True
        self._off_until = self._step + 1 + round(OFF_S / self._dt_s)
        self.latch = 0

    # -- imbalance -----------------------------------------------------------------------------------------------------

    def find_jitter(self, speed_rad_s: float) -> Vec3:
        """Return the torque of the rotor's imbalance on the body over the last step, a mean over its turn [N m].

        Dynamic imbalance turns the body by U_d w^2 [-sin theta, cos theta] in the plane normal to the axis; static imbalance
        pulls with U_s w^2 [cos theta, sin theta] at the wheel's position.
        """
        settings = self._motor.settings
        if not settings.jitter:
            return ZERO3
        turn = speed_rad_s * self._dt_s
        end = self.rotor.theta_rad
        cosine, sine = _mean_circle(end - turn, turn)
        square = speed_rad_s * speed_rad_s
        push, pull = settings.dynamic_imbalance_kg_m2 * square, settings.static_imbalance_kg_m * square
        (ax, ay, az), (bx, by, bz) = self._sideways_b, self._upwards_b
        fx, fy = pull * cosine, pull * sine
        force = (fx * ax + fy * bx, fx * ay + fy * by, fx * az + fy * bz)
        lx, ly, lz = cross(settings.position_b_m, force)
        return (
            lx + push * (cosine * bx - sine * ax),
            ly + push * (cosine * by - sine * ay),
            lz + push * (cosine * bz - sine * az),
        )


def _mean_circle(angle_rad: float, turn_rad: float) -> tuple[float, float]:
    """Return the means of cosine and sine from an angle over a turn."""
    if abs(turn_rad) < 1e-4:
        middle = angle_rad + 0.5 * turn_rad
        return math.cos(middle), math.sin(middle)
    end = angle_rad + turn_rad
    return (math.sin(end) - math.sin(angle_rad)) / turn_rad, (math.cos(angle_rad) - math.cos(end)) / turn_rad


def _span_plane(axis_b: Vec3) -> tuple[Vec3, Vec3]:
    """Return two unit vectors that make a right-handed triad with the axis."""
    other: Vec3 = (1.0, 0.0, 0.0) if abs(axis_b[0]) < 0.9 else (0.0, 1.0, 0.0)
    sx, sy, sz = cross(axis_b, other)
    length = math.sqrt(sx * sx + sy * sy + sz * sz)
    sideways: Vec3 = (sx / length, sy / length, sz / length)
    return sideways, cross(axis_b, sideways)
