"""PID on the rate: the law that paper 003 calls PID, without its fuzzy part."""

from __future__ import annotations

from typing import NamedTuple

from bus.linear import ZERO3
from bus.units import Vec3
from fsw.controllers.rate_slope import RateSlope
from fsw.controllers.settings import RatePidConfig
from fsw.families import Controller
from fsw.records import PointingError, WheelHealth
from fsw.vehicle import Vehicle


class RatePidInternals(NamedTuple):
    """What the law computed last, for telemetry."""

    sigma_b_rad: Vec3
    alpha_b_rad_s2: Vec3


class RatePid(Controller):
    """u = -kp w - ki sigma - kd a - v per axis, sigma = 2 q: the angle is the integral of the rate, and a its derivative.

    Spec of paper 003, section 6.1 (law A); its equations are lost. That the loop is one on the rate is the only reading that
    reproduces what the paper shows: docs/fuzzy-pid.md. Nothing is integrated against friction: the angle keeps an error of
    friction / ki. The sign of q is the caller's (q0 >= 0 but near the half turn).
    """

    __slots__ = ("_kd", "_ki", "_kp", "_sigma", "_slope")

    def __init__(self, config: RatePidConfig, vehicle: Vehicle, period_s: float) -> None:
        self._kp: Vec3 = config.kp
        self._ki: Vec3 = config.ki
        self._kd: Vec3 = config.kd
        self._slope = RateSlope(config.alpha_share)
        self.reset()

    def reset(self) -> None:
        """Forget the rates."""
        self._slope.reset()
        self._sigma: Vec3 = ZERO3

    @property
    def internals(self) -> RatePidInternals:
        """Angle and smoothed acceleration."""
        return RatePidInternals(self._sigma, self._slope.alpha_b_rad_s2)

    def step(self, dt_s: float, error: PointingError, tau_fault_hat_b_nm: Vec3, health: WheelHealth) -> Vec3:
        """Return the body torque [N m].

        tau_fault_hat_b_nm : v, the observer's fault torque, body axes; the paper has none, so fly it with `observer: none`
        health             : not used
        """
        _, qx, qy, qz = error.q_tb
        wx, wy, wz = omega = error.omega_bt_b_rad_s
        ax, ay, az = self._slope.step(dt_s, omega)
        sx, sy, sz = self._sigma = (2.0 * qx, 2.0 * qy, 2.0 * qz)
        (px, py, pz), (ix, iy, iz), (dx, dy, dz) = self._kp, self._ki, self._kd
        vx, vy, vz = tau_fault_hat_b_nm
        return (
            -px * wx - ix * sx - dx * ax - vx,
            -py * wy - iy * sy - dy * ay - vy,
            -pz * wz - iz * sz - dz * az - vz,
        )
