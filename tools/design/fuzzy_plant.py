"""A body with three ITHACO Type-A wheels on its axes, for studies that fly it thousands of times.

Spec of paper 003, section 2.2, without what no flight of the study reaches or needs: limiters, ripple, cogging, thermal
state. The wheels of the bench are those of plant_server/wheels; these are plain floats in one function, for speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from bus.units import Vec3, Vec4

DRIVER_GAIN: Final = 0.19  # [A/V]
TORQUE_CONSTANT: Final = 0.029  # [N m/A]
BANDWIDTH_RAD_S: Final = 9.0
ROTOR_KGM2: Final = 0.0077
COULOMB_NM: Final = 0.002
VISCOUS_NM_S: Final = 3.9e-5  # at 20 C
STEP_S: Final = 0.1  # gives the angles of the recorded flights to 1e-5 rad
ORBIT_RAD_S: Final = 0.0011
State = tuple[float, ...]  # q (4), omega (3), momenta of the rotors (3)


@dataclass(frozen=True, slots=True, kw_only=True)
class Draw:
    """One flight: where it starts and what goes wrong."""

    theta_rad: Vec3  # 2 q at the start
    omega_rad_s: Vec3
    speeds_rad_s: Vec3  # of the wheels at the start
    gain: Vec3  # of the motors after the fault
    onset_s: float
    ramp_s: float  # how long the gains take to fall; 0: at once
    inertia_kgm2: Vec3
    disturbance_nm: float  # section 6.5, its factor


class FuzzyPlant:
    """The state, moved by RK4; the driver's current by its closed form, as its demand is constant over a period."""

    __slots__ = ("_draw", "_state", "current", "square_n2m2s")

    def __init__(self, draw: Draw) -> None:
        self._draw = draw
        x, y, z = (0.5 * theta for theta in draw.theta_rad)
        momenta = (ROTOR_KGM2 * (speed + rate) for speed, rate in zip(draw.speeds_rad_s, draw.omega_rad_s, strict=True))
        self._state: State = (math.sqrt(1.0 - x * x - y * y - z * z), x, y, z, *draw.omega_rad_s, *momenta)
        self.current: Vec3 = (0.0, 0.0, 0.0)
        self.square_n2m2s = 0.0  # of the torques that the currents are worth with sound motors

    @property
    def q(self) -> Vec4:
        """Attitude of the body with respect to its target, scalar first."""
        a, b, c, d = self._state[:4]
        return (a, b, c, d)

    @property
    def omega(self) -> Vec3:
        """Rate of the body, body axes [rad/s]."""
        a, b, c = self._state[4:7]
        return (a, b, c)

    def find_theta(self) -> Vec3:
        """2 sgn(q0) q, body axes [rad]."""
        q0, x, y, z = self._state[:4]
        k = math.copysign(2.0, q0)
        return (k * x, k * y, k * z)

    def find_speeds(self) -> Vec3:
        """Speeds of the wheels with respect to the body [rad/s]."""
        _, _, _, _, wx, wy, wz, hx, hy, hz = self._state
        return (hx / ROTOR_KGM2 - wx, hy / ROTOR_KGM2 - wy, hz / ROTOR_KGM2 - wz)

    def advance(self, dt_s: float, t_s: float, command_v: Vec3) -> None:
        """Move by dt_s from the time t_s under these commands."""
        steps = round(dt_s / STEP_S)
        half_decay, full_decay = math.exp(-0.5 * BANDWIDTH_RAD_S * STEP_S), math.exp(-BANDWIDTH_RAD_S * STEP_S)
        demand = [DRIVER_GAIN * v for v in command_v]
        for step in range(steps):
            t = t_s + step * STEP_S
            start, middle, end = self._find_gain(t), self._find_gain(t + 0.5 * STEP_S), self._find_gain(t + STEP_S)
            (ia, ib, ic), (da, db, dc) = self.current, demand
            ha, hb, hc = da + (ia - da) * half_decay, db + (ib - db) * half_decay, dc + (ic - dc) * half_decay
            ea, eb, ec = da + (ia - da) * full_decay, db + (ib - db) * full_decay, dc + (ic - dc) * full_decay
            m0 = (start[0] * ia, start[1] * ib, start[2] * ic)
            m1 = (middle[0] * ha, middle[1] * hb, middle[2] * hc)
            m2 = (end[0] * ea, end[1] * eb, end[2] * ec)
            self._step(t, m0, m1, m2)
            self.current = (ea, eb, ec)
            self.square_n2m2s += STEP_S * TORQUE_CONSTANT**2 * (ha * ha + hb * hb + hc * hc)

    def _find_gain(self, t_s: float) -> Vec3:
        """Torque for a current, each wheel [N m/A]."""
        draw = self._draw
        since = t_s - draw.onset_s
        if since < 0.0:
            part = 0.0
        else:
            part = 1.0 if since >= draw.ramp_s else since / draw.ramp_s
        a, b, c = draw.gain
        k = TORQUE_CONSTANT
        return (k * (1.0 + part * (a - 1.0)), k * (1.0 + part * (b - 1.0)), k * (1.0 + part * (c - 1.0)))

    def _step(self, t: float, m0: Vec3, m1: Vec3, m2: Vec3) -> None:
        """RK4 over STEP_S with the motors' torques at its start, middle and end."""
        x, h, find = self._state, STEP_S, self._differentiate
        k1 = find(t, x, m0)
        k2 = find(t + 0.5 * h, tuple([a + 0.5 * h * b for a, b in zip(x, k1, strict=True)]), m1)
        k3 = find(t + 0.5 * h, tuple([a + 0.5 * h * b for a, b in zip(x, k2, strict=True)]), m1)
        k4 = find(t + h, tuple([a + h * b for a, b in zip(x, k3, strict=True)]), m2)
        w = h / 6.0
        self._state = tuple(
            [a + w * (b + 2.0 * c + 2.0 * d + e) for a, b, c, d, e in zip(x, k1, k2, k3, k4, strict=True)]
        )

    def _differentiate(self, t: float, x: State, motor_nm: Vec3) -> State:
        q0, qx, qy, qz, wx, wy, wz, hx, hy, hz = x
        ma, mb, mc = motor_nm
        sa, sb, sc = hx / ROTOR_KGM2 - wx, hy / ROTOR_KGM2 - wy, hz / ROTOR_KGM2 - wz
        na = ma - COULOMB_NM * math.tanh(10.0 * sa) - VISCOUS_NM_S * sa
        nb = mb - COULOMB_NM * math.tanh(10.0 * sb) - VISCOUS_NM_S * sb
        nc = mc - COULOMB_NM * math.tanh(10.0 * sc) - VISCOUS_NM_S * sc
        jx, jy, jz = self._draw.inertia_kgm2
        lx, ly, lz = jx * wx + hx, jy * wy + hy, jz * wz + hz
        angle, d = ORBIT_RAD_S * t, self._draw.disturbance_nm
        cosine, sine = math.cos(angle), math.sin(angle)
        return (
            0.5 * (-qx * wx - qy * wy - qz * wz),
            0.5 * (q0 * wx + qy * wz - qz * wy),
            0.5 * (q0 * wy + qz * wx - qx * wz),
            0.5 * (q0 * wz + qx * wy - qy * wx),
            (d * (3.0 * cosine + 1.0) - na - (wy * lz - wz * ly)) / jx,
            (d * (1.5 * sine + 3.0 * cosine) - nb - (wz * lx - wx * lz)) / jy,
            (d * (3.0 * sine + 1.0) - nc - (wx * ly - wy * lx)) / jz,
            na,
            nb,
            nc,
        )
