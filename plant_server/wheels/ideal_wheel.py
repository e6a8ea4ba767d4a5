"""One ideal wheel: from the commanded torque to the torque on the body, one integration step at a time."""

from __future__ import annotations

import math
from typing import NamedTuple, cast

from plant_server.config import WheelConfig
from plant_server.faults.effects import WheelDisturbance, WheelEffect
from plant_server.faults.timeline import ActiveFault, FaultChain, FaultTimeline

WheelFault = ActiveFault[WheelEffect]


class Pending(NamedTuple):
    """A fault that has changed nothing yet, and what the wheel would be without it."""

    fault: WheelFault
    without: WheelDisturbance


class IdealWheel:
    """Motor, faults and drag of one wheel. Torques are those on the body, about the wheel's axis [N m]."""

    __slots__ = (
        "_chain", "_coulomb", "_has_drag", "_has_lag", "_lag_end", "_lag_mean", "_max_torque", "_pending", "_state",
        "_timeline", "_unfaulted_nm", "_viscous", "ampere_per_nm", "inertia", "limited", "max_speed_rad_s", "motor_nm",
        "speed_per_nm",
    )  # fmt: skip

    def __init__(self, unit: str, config: WheelConfig, timeline: FaultTimeline, step_s: float) -> None:
        self._timeline = timeline
        self._chain = cast(FaultChain[WheelEffect], timeline.chains[unit])
        self.inertia = config.inertia_kgm2
        self.ampere_per_nm = 1.0 / config.motor_constant_nm_a
        self._max_torque = config.max_torque_nm
        self.max_speed_rad_s = config.max_speed_rad_s
        self._viscous = config.viscous_nm_s
        self._coulomb = config.coulomb_nm
        self._has_drag = config.viscous_nm_s != 0.0 or config.coulomb_nm != 0.0
        self.speed_per_nm = (
            step_s / config.inertia_kgm2
        )  # how much of it a torque on the body costs the rotor in a step
        lag = config.torque_lag_s
        self._has_lag = lag > 0.0
        # first-order lag over one step: torque at its end, and its mean, as fractions of the way to the command
        self._lag_end = 1.0 - math.exp(-step_s / lag) if lag > 0.0 else 1.0
        self._lag_mean = 1.0 - self._lag_end * lag / step_s if lag > 0.0 else 1.0
        self._state = WheelDisturbance()
        self._pending: tuple[Pending, ...] = ()
        self._unfaulted_nm = 0.0  # lagged torque at the end of the last step
        self.motor_nm = 0.0  # torque of the motor over the last step, faults included
        self.limited = False  # at its speed limit

    @property
    def silent(self) -> bool:
        """Whether it sends no telemetry."""
        return self._state.silent

    @property
    def is_steady(self) -> bool:
        """Whether its torque stays what it is but for a speed limit, while command and faults do."""
        return not (self._has_lag or self._has_drag or self.limited)

    def look(self, step: int, t_s: float, speed_rad_s: float) -> int:
        """Bring the faults up to date for the step at t_s; return the step of the next look that is due."""
        chain = self._chain
        if step >= chain.next_edge:
            chain.refresh(step)
        for fault in chain.active:
            fault.bring_to(t_s, speed_rad_s)
        self._state = self._compose(None)
        self._pending = tuple(Pending(fault, self._compose(fault)) for fault in chain.without_effect_yet())
        return chain.next_edge if all(fault.is_settled() for fault in chain.active) else step + 1

    def _compose(self, left_out: WheelFault | None) -> WheelDisturbance:
        """Return what all active faults but one make of the wheel."""
        state = WheelDisturbance()
        for fault in self._chain.active:
            if fault is not left_out:
                fault.effect.disturb(state, fault.now)
        if not state.motor_on:
            state.gain = 0.0
        return state

    def drive(self, step: int, command_nm: float, speed_rad_s: float) -> float:
        """Return the torque on the body over the integration step `step` [N m].

        Command limit, motor lag (mean over the step), faults, speed limit (a torque that would take the rotor further
        beyond its limit is zero), then drag.
        """
        limit = self._max_torque
        motor = limit if command_nm > limit else -limit if command_nm < -limit else command_nm
        if self._has_lag:
            start = self._unfaulted_nm
            self._unfaulted_nm = start + (motor - start) * self._lag_end
            motor = start + (motor - start) * self._lag_mean
        state = self._state
        wanted = state.gain * motor + state.offset_nm
        torque = self._limit(wanted, speed_rad_s)
        self.limited = torque != wanted
        self.motor_nm = torque
        if self._pending:
            self._note_torques(step, motor, torque, speed_rad_s)
        return torque + self._drag(torque, speed_rad_s) if self._has_drag else torque

    def _limit(self, motor_nm: float, speed_rad_s: float) -> float:
        """Return the torque, zero where it would take the rotor further beyond its limit [N m]."""
        limit = self.max_speed_rad_s
        speed_after = speed_rad_s - motor_nm * self.speed_per_nm
        if (speed_after > limit and motor_nm < 0.0) or (speed_after < -limit and motor_nm > 0.0):
            return 0.0
        return motor_nm

    def _drag(self, motor_nm: float, speed_rad_s: float) -> float:
        """Return the drag torque on the body [N m]: viscous, and dry friction that stops the rotor but never turns it.

        Drag takes momentum from the rotor and gives it to the body. Dry friction is the torque that would bring the
        rotor to rest within the step, limited to the Coulomb torque.
        """
        viscous = self._viscous * speed_rad_s
        stopping = speed_rad_s / self.speed_per_nm - motor_nm - viscous
        coulomb = self._coulomb
        return viscous + (coulomb if stopping > coulomb else -coulomb if stopping < -coulomb else stopping)

    # -- effects -------------------------------------------------------------------------------------------------------

    def _note_torques(self, step: int, motor_nm: float, torque_nm: float, speed_rad_s: float) -> None:
        """Note which of the pending faults make the torque of this step another."""
        for fault, without in self._pending:
            if self._limit(without.gain * motor_nm + without.offset_nm, speed_rad_s) != torque_nm:
                self._note(fault, step)

    def note_silence(self, step: int) -> None:
        """Note which of the pending faults keep back the telemetry that is due on this step."""
        for fault, without in self._pending:
            if without.silent != self._state.silent:
                self._note(fault, step)

    def _note(self, fault: WheelFault, step: int) -> None:
        self._timeline.note_effect(fault, step)
        self._pending = tuple(entry for entry in self._pending if entry.fault is not fault)
