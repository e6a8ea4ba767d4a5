"""External torques on the body: constant, sinusoidal, gravity gradient. Body axes, N m, held over a step."""

from __future__ import annotations

import math
from typing import Final

from bus.units import DEG, Mat3, Vec3, Vec4
from plant_server.config import ConstantTorque, GravityGradient, SinusoidalTorque, TorqueConfig

MU_M3_S2: Final = 3.986004418e14  # Earth's gravitational parameter, WGS 84
EARTH_RADIUS_M: Final = 6378137.0  # equatorial, WGS 84


class Environment:
    """Sum of the configured torques."""

    __slots__ = ("_gradients", "_inertia", "_sines", "constant_b_nm", "is_constant")

    def __init__(self, torques: tuple[TorqueConfig, ...], inertia_total_kgm2: Mat3) -> None:
        self._inertia = inertia_total_kgm2
        self._sines: list[tuple[Vec3, float, Vec3]] = []  # amplitude, angular frequency, phase
        self._gradients: list[float] = []  # orbital rate
        x = y = z = 0.0
        for torque in torques:
            if isinstance(torque, ConstantTorque):
                x, y, z = x + torque.torque_nm[0], y + torque.torque_nm[1], z + torque.torque_nm[2]
            elif isinstance(torque, SinusoidalTorque):
                a, b, c = torque.phase_deg
                phase = (a * DEG, b * DEG, c * DEG)
                self._sines.append((torque.amplitude_nm, 2.0 * math.pi / torque.period_s, phase))
            else:
                self._gradients.append(find_orbital_rate(torque))
        self.constant_b_nm: Vec3 = (x, y, z)
        self.is_constant = not self._sines and not self._gradients

    def sum_torques(self, t_s: float, q_ib: Vec4) -> Vec3:
        """Return the external torque at the time t_s and the attitude q_ib, body axes [N m]."""
        x, y, z = self.constant_b_nm
        for (a, b, c), rate, (pa, pb, pc) in self._sines:
            angle = rate * t_s
            x += a * math.sin(angle + pa)
            y += b * math.sin(angle + pb)
            z += c * math.sin(angle + pc)
        for rate in self._gradients:
            gx, gy, gz = self._pull(rate, t_s, q_ib)
            x, y, z = x + gx, y + gy, z + gz
        return (x, y, z)

    def _pull(self, orbital_rate_rad_s: float, t_s: float, q_ib: Vec4) -> Vec3:
        """Return the gravity-gradient torque 3 n^2 o x J o [N m], o the direction of the spacecraft from Earth.

        Hughes, Spacecraft Attitude Dynamics, 1986, sec 8.1; for a circular orbit mu/r^3 = n^2.
        """
        angle = orbital_rate_rad_s * t_s
        c, s = math.cos(angle), math.sin(angle)
        q0, q1, q2, q3 = q_ib
        # o = R(q)' (c, s, 0), as bus.attitude.rotate_back has it; then J o
        a = 2.0 * q3 * s
        b = -2.0 * q3 * c
        d = 2.0 * (q2 * c - q1 * s)
        x = c + q0 * a - q2 * d + q3 * b
        y = s + q0 * b - q3 * a + q1 * d
        z = q0 * d - q1 * b + q2 * a
        (j00, j01, j02), (j10, j11, j12), (j20, j21, j22) = self._inertia
        a = j00 * x + j01 * y + j02 * z
        b = j10 * x + j11 * y + j12 * z
        c = j20 * x + j21 * y + j22 * z
        k = 3.0 * orbital_rate_rad_s * orbital_rate_rad_s
        return (k * (y * c - z * b), k * (z * a - x * c), k * (x * b - y * a))


def find_orbital_rate(orbit: GravityGradient) -> float:
    """Return the angular rate of a circular orbit, sqrt(mu/r^3) [rad/s]."""
    return math.sqrt(MU_M3_S2 / (EARTH_RADIUS_M + 1000.0 * orbit.altitude_km) ** 3)
