"""One ideal wheel: from the commanded torque to the torque on the body, one integration step at a time."""

from __future__ import annotations

import math

from plant_server.config import WheelConfig
from plant_server.faults.effects import WheelDisturbance
from plant_server.faults.timeline import FaultTimeline
from plant_server.wheels.wheel import Wheel, WheelFault


class IdealWheel(Wheel):
    """Motor, faults and drag of one wheel without a motor model: its torque is what it is told, within limits."""

    __slots__ = (
        "_ampere_per_nm", "_config_coulomb", "_config_viscous", "_coulomb", "_has_drag", "_has_lag", "_lag_end", "_lag_mean",
        "_max_torque", "_unfaulted_nm", "_viscous",
    )  # fmt: skip

    def __init__(self, unit: str, config: WheelConfig, timeline: FaultTimeline, step_s: float) -> None:
        super().__init__(unit, config.inertia_kgm2, config.max_speed_rad_s, timeline, step_s)
        self._ampere_per_nm = 1.0 / config.motor_constant_nm_a
        self._max_torque = config.max_torque_nm
        self._viscous = self._config_viscous = config.viscous_nm_s
        self._coulomb = self._config_coulomb = config.coulomb_nm
        self._has_drag = config.viscous_nm_s != 0.0 or config.coulomb_nm != 0.0
        lag = config.torque_lag_s
        self._has_lag = lag > 0.0
        # first-order lag over one step: torque at its end, and its mean, as fractions of the way to the command
        self._lag_end = 1.0 - math.exp(-step_s / lag) if lag > 0.0 else 1.0
        self._lag_mean = 1.0 - self._lag_end * lag / step_s if lag > 0.0 else 1.0
        self._unfaulted_nm = 0.0  # lagged torque at the end of the last step

    def _take_up(self) -> None:
        """Let the faults of the bearing change the drag, those of the motor its torque."""
        state = self.state
        self._viscous = self._config_viscous * state.viscous_gain
        self._coulomb = self._find_dry(state)
        self._has_drag = self._viscous != 0.0 or self._coulomb != 0.0

    def _find_dry(self, state: WheelDisturbance) -> float:
        """Return the dry friction that a bearing of this state has, seizure included [N m]."""
        return self._config_coulomb * state.coulomb_gain + state.friction_nm + state.static_nm + state.seize_nm

    def _compose(self, left_out: WheelFault | None) -> WheelDisturbance:
        state = super()._compose(left_out)
        if not state.motor_on:
            state.gain = 0.0
        return state

    def drive(self, step: int, command: float, mode: int, speed_rad_s: float) -> float:
        """Return the torque on the body over the integration step `step` [N m].

        Command limit, motor lag (mean over the step), faults, speed limit (a torque that would take the rotor further
        beyond its limit is zero), then drag.
        """
        limit = self._max_torque
        motor = limit if command > limit else -limit if command < -limit else command
        if self._has_lag:
            start = self._unfaulted_nm
            self._unfaulted_nm = start + (motor - start) * self._lag_end
            motor = start + (motor - start) * self._lag_mean
        state = self.state
        wanted = state.gain * motor + state.offset_nm
        torque = self._limit(wanted, speed_rad_s)
        self.limited = torque != wanted
        self.is_steady = not (self._has_lag or self._has_drag or self.limited)
        self.current_a = torque * self._ampere_per_nm
        if self._pending:
            self._note_torques(step, motor, torque, speed_rad_s)
        if not self._has_drag:
            return torque
        return torque + self._drag(self._viscous, self._coulomb, torque, speed_rad_s)

    def _limit(self, motor_nm: float, speed_rad_s: float) -> float:
        """Return the torque, zero where it would take the rotor further beyond its limit [N m]."""
        limit = self.max_speed_rad_s
        speed_after = speed_rad_s - motor_nm * self.speed_per_nm
        if (speed_after > limit and motor_nm < 0.0) or (speed_after < -limit and motor_nm > 0.0):
            return 0.0
        return motor_nm

    def _drag(self, viscous_nm_s: float, coulomb_nm: float, motor_nm: float, speed_rad_s: float) -> float:
        """Return the drag torque on the body [N m]: viscous, and dry friction that stops the rotor but never turns it.

        Drag takes momentum from the rotor and gives it to the body. Dry friction is the torque that would bring the
        rotor to rest within the step, limited to the Coulomb torque.
        """
        viscous = viscous_nm_s * speed_rad_s
        stopping = speed_rad_s / self.speed_per_nm - motor_nm - viscous
        return viscous + (coulomb_nm if stopping > coulomb_nm else -coulomb_nm if stopping < -coulomb_nm else stopping)

    # -- effects -------------------------------------------------------------------------------------------------------

    def _note_torques(self, step: int, motor_nm: float, torque_nm: float, speed_rad_s: float) -> None:
        """Note which of the pending faults make the torque of this step another."""
        now = self._drag(self._viscous, self._coulomb, torque_nm, speed_rad_s)
        for fault, without in self._pending:
            motor = self._limit(without.gain * motor_nm + without.offset_nm, speed_rad_s)
            viscous = self._config_viscous * without.viscous_gain
            drag = self._drag(viscous, self._find_dry(without), torque_nm, speed_rad_s)
            if motor != torque_nm or drag != now:
                self._note(fault, step)
