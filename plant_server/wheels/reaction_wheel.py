"""One reaction wheel: from the commanded torque to the torque on the body, one integration step at a time."""

from __future__ import annotations

import math

from plant_server.config import WheelConfig
from plant_server.faults import FaultChain, compose_torque


class ReactionWheel:
    """Motor, faults and drag of one wheel. Torques are those on the body, about the wheel's axis [N m]."""

    __slots__ = (
        "_coulomb", "_dt_per_inertia", "_gain", "_lag_end", "_lag_mean", "_max_speed", "_max_torque", "_offset",
        "_settled", "_step_s", "_unfaulted_nm", "_viscous", "ampere_per_nm", "chain", "inertia", "limited",
        "motor_nm", "reach", "silent", "simple",
    )  # fmt: skip

    def __init__(self, config: WheelConfig, chain: FaultChain, step_s: float) -> None:
        self.chain = chain
        self.inertia = config.inertia_kgm2
        self.ampere_per_nm = 1.0 / config.motor_constant_nm_a
        self._max_torque = config.max_torque_nm
        self._max_speed = config.max_speed_rad_s
        self._viscous = config.viscous_nm_s
        self._coulomb = config.coulomb_nm
        self._step_s = step_s
        self._dt_per_inertia = step_s / config.inertia_kgm2
        lag = config.torque_lag_s
        # first-order lag over one step: torque at its end, and its mean, as fractions of the way to the command
        self._lag_end = 1.0 - math.exp(-step_s / lag) if lag > 0.0 else 1.0
        self._lag_mean = 1.0 - self._lag_end * lag / step_s if lag > 0.0 else 1.0
        self.simple = lag == 0.0 and self._viscous == 0.0 and self._coulomb == 0.0
        self._gain = 1.0
        self._offset = 0.0
        self._settled = True
        self._unfaulted_nm = 0.0  # lagged torque at the end of the last step
        self.motor_nm = 0.0  # torque of the motor over the last step, faults included
        self.limited = False  # at its speed limit
        self.reach = -1.0  # up to this speed [rad/s] the torque in hand cannot take the rotor to its limit in a step
        self.silent = False

    def update_faults(self, step: int, t_s: float) -> bool:
        """Bring the faults up to date for the step at t_s; return whether the next step needs another look."""
        chain = self.chain
        if step >= chain.next_edge:
            chain.refresh(step)
            self._settled = False
        if not self._settled:
            self._gain, self._offset = compose_torque(chain.active, t_s)
            self.silent = any(fault.kind == "silent" for fault in chain.active)
            self._settled = not any(fault.is_rising(t_s) for fault in chain.active)
        return not self._settled

    def drive(self, command_nm: float, speed_rad_s: float) -> float:
        """Return the torque on the body over the next step [N m].

        Command limit, motor lag (mean over the step), faults, speed limit (a torque that would take the rotor further
        beyond its limit is zero), then drag.
        """
        limit = self._max_torque
        motor = limit if command_nm > limit else -limit if command_nm < -limit else command_nm
        if not self.simple:
            start = self._unfaulted_nm
            self._unfaulted_nm = start + (motor - start) * self._lag_end
            motor = start + (motor - start) * self._lag_mean
        motor = self._gain * motor + self._offset
        speed_after = speed_rad_s - motor * self._dt_per_inertia
        limit = self._max_speed
        if (speed_after > limit and motor < 0.0) or (speed_after < -limit and motor > 0.0):
            motor = 0.0
            self.limited = True
            self.reach = -1.0
        else:
            self.limited = False
            self.reach = limit - abs(motor) * self._dt_per_inertia
        self.motor_nm = motor
        return motor if self.simple else motor + self._drag(motor, speed_rad_s)

    def _drag(self, motor_nm: float, speed_rad_s: float) -> float:
        """Return the drag torque on the body [N m]: viscous, and dry friction that stops the rotor but never turns it.

        Drag takes momentum from the rotor and gives it to the body. Dry friction is the torque that would bring the
        rotor to rest within the step, limited to the Coulomb torque.
        """
        viscous = self._viscous * speed_rad_s
        stopping = speed_rad_s / self._dt_per_inertia - motor_nm - viscous
        coulomb = self._coulomb
        return viscous + (coulomb if stopping > coulomb else -coulomb if stopping < -coulomb else stopping)
