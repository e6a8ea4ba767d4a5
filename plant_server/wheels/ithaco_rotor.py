"""Current, spin and temperature of an ITHACO Type-A class wheel: one Runge-Kutta step of its equations.

Structure: Bialke 1998. Torques here are those on the rotor; the body has the opposite of their sum. All SI, degC.
"""

from __future__ import annotations

import math
from typing import Final

from plant_server.faults.effects import WheelDisturbance
from plant_server.wheels.motor import REFERENCE_C, Motor

DRY_RAD_S: Final = 0.1  # dry friction passes through zero speed over this,
SEIZED_RAD_S: Final = 1.0  # a seized bearing over this: its slope must stay within what a step of 10 ms can follow
STRIBECK_RAD_S: Final = 0.42  # speed by which the friction of rest has fallen to that of motion
QUADRANT: Final = 0.05  # width of the passage from braking to motoring, in rad A/s
FILTER_V: Final = 1.0  # lost in the input filter
SWITCHING: Final = 0.04  # share of the bus's voltage lost with the current
LEAST_VISCOUS: Final = 5e-6  # a warm lubricant keeps this [N m s/rad]
EMF_CLEAR_V: Final = -0.5  # a wheel limited by its back-EMF is so until there is this much to spare
OVERSPEED_CLEAR: Final = 0.98  # share of the limit below which an overspeed is over
SMALL_RAD: Final = 1e-4  # angle of a step below which the mean of a sine is the sine of its middle


class IthacoRotor:
    """The state of one rotor but for its momentum, which the bank keeps, and how a step changes it."""

    __slots__ = (
        "_motor", "_scaled_noise", "bus_current_a", "current_a", "emf_limited", "overspeed",
        "temperature_c", "theta_rad",
    )  # fmt: skip

    def __init__(self, motor: Motor) -> None:
        self._motor = motor
        settings = motor.settings
        self.current_a = 0.0  # I
        self.theta_rad = 0.0  # angle of the rotor, for ripple, cogging and imbalance
        self.temperature_c = settings.temperature_c
        self.bus_current_a = settings.quiescent_w / (settings.bus_v - FILTER_V)
        self.emf_limited = False
        self.overspeed = False
        # amplitude of the lubricant's torque noise, J theta_a w_a^2 [N m]
        self._scaled_noise = motor.inertia * settings.noise_angle_rad * settings.noise_rate_rad_s**2

    def advance(
        self, command_v: float, h_nms: float, body_rad_s: float, body_rad_s2: float, t_s: float, dt_s: float,
        state: WheelDisturbance,
    ) -> float:  # fmt: skip
        """Move on by dt_s under a held command; return the mean torque on the rotor, which is its change of momentum [N m].

        h_nms                    : absolute spin momentum at the start
        body_rad_s, body_rad_s2  : rate of the body about the wheel's axis at the start, and its rate of change
        t_s                      : time at the start
        """
        motor = self._motor
        inverse = 1.0 / motor.inertia
        half = 0.5 * dt_s
        speed = h_nms * inverse - body_rad_s
        ripple, cogging = self._find_ripple(speed * dt_s)
        start = self.current_a
        i1, n1 = self.find_rates(command_v, start, speed, t_s, state, ripple, cogging)
        w2 = (h_nms + half * n1) * inverse - body_rad_s - half * body_rad_s2
        i2, n2 = self.find_rates(command_v, start + half * i1, w2, t_s + half, state, ripple, cogging)
        w3 = (h_nms + half * n2) * inverse - body_rad_s - half * body_rad_s2
        i3, n3 = self.find_rates(command_v, start + half * i2, w3, t_s + half, state, ripple, cogging)
        w4 = (h_nms + dt_s * n3) * inverse - body_rad_s - dt_s * body_rad_s2
        i4, n4 = self.find_rates(command_v, start + dt_s * i3, w4, t_s + dt_s, state, ripple, cogging)
        torque = (n1 + 2.0 * (n2 + n3) + n4) / 6.0
        self.current_a = start + dt_s / 6.0 * (i1 + 2.0 * (i2 + i3) + i4)
        self.theta_rad = math.fmod(self.theta_rad + dt_s / 6.0 * (speed + 2.0 * (w2 + w3) + w4), 2.0 * math.pi)
        if motor.settings.thermal:
            self._warm(start, speed, dt_s, state)
        return torque

    def find_rates(
        self, command_v: float, current_a: float, speed_rad_s: float, t_s: float, state: WheelDisturbance,
        ripple: float, cogging_nm: float,
    ) -> tuple[float, float]:  # fmt: skip
        """Return the rate of change of the current [A/s] and the torque on the rotor [N m].

        ripple     : means over the step of B sin(3 N theta)
        cogging_nm : and of C sin(N theta) [N m]
        """
        motor = self._motor
        if state.is_stuck:
            demand_a = state.stuck_current_a
        elif state.motor_on:
            limited_v = self._limit_command(command_v, current_a, speed_rad_s, state)
            demand_a = motor.driver_gain * state.driver_gain * limited_v
        else:
            demand_a = 0.0
        torque = state.torque_gain * motor.torque_constant * current_a * (1.0 + ripple) + cogging_nm
        torque = state.gain * torque - state.offset_nm - self.find_friction(speed_rad_s, state)
        if self._scaled_noise:
            torque += self._scaled_noise * math.sin(motor.settings.noise_rate_rad_s * t_s)
        return motor.bandwidth * (demand_a - current_a), torque

    def find_headroom(self, current_a: float, speed_rad_s: float, state: WheelDisturbance) -> float:
        """Return by how much the back-EMF is beyond the voltage that there is; negative where it is not [V]."""
        settings, emf = self._motor.settings, self._motor.back_emf
        bus_v = state.bus_v if state.has_bus else settings.bus_v
        size = abs(current_a)
        drawn_w = settings.quiescent_w + emf * speed_rad_s * current_a
        bus_a = (current_a * current_a * settings.bridge_ohm + SWITCHING * size * bus_v + drawn_w) / (bus_v - FILTER_V)
        self.bus_current_a = bus_a
        return emf * abs(speed_rad_s) - (bus_v - FILTER_V - settings.input_ohm * bus_a - settings.bridge_ohm * size)

    def _limit_command(self, command_v: float, current_a: float, speed_rad_s: float, state: WheelDisturbance) -> float:
        """Return the command less what limits speed (psi 3) and, while motoring, back-EMF (psi 1) [V]."""
        motor = self._motor
        sign = 1.0 if speed_rad_s > 0.0 else -1.0 if speed_rad_s < 0.0 else 0.0
        over = abs(speed_rad_s) - motor.overspeed
        if over > 0.0:
            command_v -= motor.overspeed_gain * over * sign
        beyond_v = self.find_headroom(current_a, speed_rad_s, state)
        if beyond_v > 0.0:
            motoring = 0.5 * (1.0 + math.tanh(speed_rad_s * current_a / QUADRANT))
            command_v -= motor.emf_gain * beyond_v * sign * motoring
        return command_v

    def find_friction(self, speed_rad_s: float, state: WheelDisturbance) -> float:
        """Return the friction, with the sign of the speed [N m]."""
        motor = self._motor
        dry = state.coulomb_gain * motor.coulomb + state.friction_nm
        at_rest = motor.static - motor.coulomb + state.static_nm
        if at_rest:
            share = speed_rad_s / STRIBECK_RAD_S
            dry += at_rest * math.exp(-share * share)
        friction = math.tanh(speed_rad_s / DRY_RAD_S) * dry
        if state.seize_nm:
            friction += math.tanh(speed_rad_s / SEIZED_RAD_S) * state.seize_nm
        viscous = motor.viscous - motor.viscous_slope * (self.temperature_c - REFERENCE_C)
        return friction + state.viscous_gain * (viscous if viscous > LEAST_VISCOUS else LEAST_VISCOUS) * speed_rad_s

    def note_limits(self, speed_rad_s: float, state: WheelDisturbance) -> None:
        """Bring the flags up to date, each with its hysteresis, and the current that the bus gives."""
        beyond_v, size = self.find_headroom(self.current_a, speed_rad_s, state), abs(speed_rad_s)
        self.emf_limited = beyond_v > (EMF_CLEAR_V if self.emf_limited else 0.0)
        self.overspeed = size > self._motor.overspeed * (OVERSPEED_CLEAR if self.overspeed else 1.0)

    def _find_ripple(self, turn_rad: float) -> tuple[float, float]:
        """Return the means over a step, in which the rotor turns by so much, of B sin(3 N theta) and C sin(N theta)."""
        settings = self._motor.settings
        ripple, cogging = settings.ripple, settings.cogging_nm
        if not ripple and not cogging:
            return 0.0, 0.0
        return (
            ripple * _mean_sine(3.0 * settings.poles * self.theta_rad, 3.0 * settings.poles * turn_rad),
            cogging * _mean_sine(settings.poles * self.theta_rad, settings.poles * turn_rad),
        )

    def _warm(self, current_a: float, speed_rad_s: float, dt_s: float, state: WheelDisturbance) -> None:
        """Let the motor warm up over a step: it changes by millionths of a degree, so first order will do."""
        settings = self._motor.settings
        lost_w = current_a * current_a * settings.bridge_ohm + settings.quiescent_w
        lost_w += abs(self.find_friction(speed_rad_s, state) * speed_rad_s)
        lost_w -= (self.temperature_c - settings.ambient_c) / settings.thermal_resistance_k_w
        self.temperature_c += dt_s * lost_w / settings.heat_capacity_j_k


def _mean_sine(angle_rad: float, turn_rad: float) -> float:
    """Return the mean of the sine from an angle over a turn: (cos a - cos b) / (b - a), which fades as it turns faster."""
    if abs(turn_rad) < SMALL_RAD:
        return math.sin(angle_rad + 0.5 * turn_rad)
    return (math.cos(angle_rad) - math.cos(angle_rad + turn_rad)) / turn_rad
