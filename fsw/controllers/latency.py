"""Where the body will be once a torque commanded now begins to act: past the torques sent that have not acted yet."""

from __future__ import annotations

import math
from typing import Final

from bus.attitude import exp_map, multiply
from bus.linear import ZERO3, add, cross, subtract, times
from bus.units import Vec3
from fsw.records import PointingError
from fsw.vehicle import Vehicle

MOST_TURN_RAD: Final = 1.0  # in a period, above which the midpoint rule says nothing of the gyroscopic torque


class Latency:
    """The torques on their way to the body, oldest first, and the error once they have acted.

    Midpoint rule, one step a control period: J w' = tau - w x J w for the body, d' = R w_t' + d x w for the target's rate d
    in body axes, and q_tb turned by the midpoint of w - d (an exact rotation, so that it stays one whatever the rate).
    With the wheels' momentum in play the gyroscopic torque is left out: w x (J w + h) is then near zero.
    """

    __slots__ = ("_gyroscopic", "_inertia", "_inverse", "_period_s", "_sent")

    def __init__(self, samples: int, vehicle: Vehicle, period_s: float) -> None:
        """samples : control periods that pass before a torque begins to act; 0: none, the error is what it is."""
        self._inertia, self._inverse = vehicle.inertia_kgm2, vehicle.inverse_inertia
        self._gyroscopic = not vehicle.wheel_momentum
        self._period_s = period_s
        self._sent: list[Vec3] = [ZERO3] * samples

    def reset(self) -> None:
        """Nothing is on its way."""
        self._sent = [ZERO3] * len(self._sent)

    def note_sent(self, tau_b_nm: Vec3) -> None:
        """Another torque has been sent, body axes [N m]."""
        if self._sent:
            self._sent.pop(0)
            self._sent.append(tau_b_nm)

    def predict(self, error: PointingError, tau_fault_b_nm: Vec3) -> PointingError:
        """Return the error after the torques on their way, each with the fault torque tau_fault_b_nm beside it [N m]."""
        for tau_b_nm in self._sent:
            error = self._advance(error, add(tau_b_nm, tau_fault_b_nm))
        return error

    def _advance(self, error: PointingError, tau_b_nm: Vec3) -> PointingError:
        """The error one period later."""
        dt, alpha = self._period_s, error.alpha_ti_b_rad_s2
        d = error.omega_ti_b_rad_s
        w = add(error.omega_bt_b_rad_s, d)
        w_mid = _move(w, self._accelerate(w, tau_b_nm), 0.5 * dt)
        d_mid = _move(d, add(alpha, cross(d, w)), 0.5 * dt)
        w_end = _move(w, self._accelerate(w_mid, tau_b_nm), dt)
        d_end = _move(d, add(alpha, cross(d_mid, w_mid)), dt)
        x, y, z = subtract(w_mid, d_mid)
        q_tb = multiply(error.q_tb, exp_map((x * dt, y * dt, z * dt)))
        return PointingError(q_tb, subtract(w_end, d_end), d_end, alpha)

    def _accelerate(self, w: Vec3, tau_b_nm: Vec3) -> Vec3:
        x, y, z = w
        if self._gyroscopic and math.sqrt(x * x + y * y + z * z) * self._period_s < MOST_TURN_RAD:
            tau_b_nm = subtract(tau_b_nm, cross(w, times(self._inertia, w)))
        return times(self._inverse, tau_b_nm)


def _move(v: Vec3, rate: Vec3, dt: float) -> Vec3:
    (x, y, z), (a, b, c) = v, rate
    return (x + dt * a, y + dt * b, z + dt * c)
