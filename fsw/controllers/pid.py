"""PID on the angle with an integral that does not wind up: what an engineer would fly."""

from __future__ import annotations

from typing import NamedTuple

from bus.linear import ZERO3
from bus.units import Vec3
from fsw.controllers.error_integral import ErrorIntegral
from fsw.controllers.pid_gains import choose_gains, place_poles
from fsw.controllers.settings import PidConfig
from fsw.families import Controller
from fsw.records import PointingError, WheelHealth
from fsw.vehicle import Vehicle


class PidInternals(NamedTuple):
    """What the law holds, for telemetry."""

    sigma_b_rad: Vec3
    integral_b_rad_s: Vec3  # z
    limit_b_nm: Vec3  # torque that can be had about each axis


class Pid(Controller):
    """u = -kp sigma + ki z - kd w - v per axis, sigma = 2 q, z the integral of -sigma (spec of paper 003, section 6.4).

    z stands still where u saturates and would grow (fsw/controllers/error_integral.py). The torque is computed before z
    advances: a sample of the error counts in the integral from the next period on.
    """

    __slots__ = ("_integral", "_kd", "_ki", "_kp", "_limit", "_sigma")

    def __init__(self, config: PidConfig, vehicle: Vehicle, period_s: float) -> None:
        """Raises ConfigError where one or two of the three gains are given."""
        placed = place_poles(config.frequency_rad_s, config.damping, config.integral_rad_s, vehicle)
        self._kp, self._ki, self._kd = choose_gains((config.kp, config.ki, config.kd), placed, "pid")
        self._integral = ErrorIntegral(config.limit_nm, vehicle)
        self.reset()

    def reset(self) -> None:
        """Back to an integral of zero."""
        self._integral.reset()
        self._sigma: Vec3 = ZERO3
        self._limit: Vec3 = ZERO3

    @property
    def internals(self) -> PidInternals:
        """Angle, integral and limit of the torque."""
        return PidInternals(self._sigma, self._integral.z_b_rad_s, self._limit)

    def step(self, dt_s: float, error: PointingError, tau_fault_hat_b_nm: Vec3, health: WheelHealth) -> Vec3:
        """Return the body torque [N m].

        tau_fault_hat_b_nm : v, the observer's fault torque, body axes. With an observer two parts make up for a steady
                             torque, the faster of them first; nothing is counted twice.
        health             : makes the limit of the torque smaller where wheels give less
        """
        _, qx, qy, qz = error.q_tb
        wx, wy, wz = error.omega_bt_b_rad_s
        sx, sy, sz = self._sigma = (2.0 * qx, 2.0 * qy, 2.0 * qz)
        (px, py, pz), (ix, iy, iz), (dx, dy, dz) = self._kp, self._ki, self._kd
        zx, zy, zz = self._integral.z_b_rad_s
        vx, vy, vz = tau_fault_hat_b_nm
        torque = (
            -px * sx + ix * zx - dx * wx - vx,
            -py * sy + iy * zy - dy * wy - vy,
            -pz * sz + iz * zz - dz * wz - vz,
        )
        self._integral.step(dt_s, self._sigma, torque, health)
        self._limit = self._integral.find_limit(health)
        return torque
