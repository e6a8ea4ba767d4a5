"""Rigid body with spinning wheels: attitude and momentum over one step, to fourth order, plain floats.

Model, body axes. `J` is the inertia of the spacecraft without the rotors' inertia about their own spin axes (the
rotors' mass and transverse inertia are in it). `h_i` is the spin momentum of rotor i, absolute: I_i (speed_i + a_i.w),
with `speed_i` the speed relative to the body and `a_i` the true axis. Then, exactly,

    P = J w + D h                 total angular momentum
    P' = -w x P + d               which is J w' = -w x (J w + D h) + D tau + d
    h_i' = -tau_i                 tau_i: torque of wheel i on the body about its axis
    q0' = -1/2 q.w,  q' = 1/2 (q x w + q0 w)

(Hughes, Spacecraft Attitude Dynamics, 1986, sec 6.2: gyrostat.) P is the state, so that wheel torque only moves
momentum between rotor and body and total momentum is conserved to the accuracy of the step. A wheel torque is constant
over a step, so D h is linear in it and no stage has to integrate it.

With `wheel_gyroscopic: false` the papers' plant, J w' = -w x (J w) + D tau + d (Zhang, Ye & Sun 2018, eq (2)), is the
same code with D h = 0 and D tau counted as external.

The attitude turns by q exp(phi/2) with the rotation vector phi = integral of w + dt^2/12 w(0) x w(dt), Magnus' series
(Iserles & Norsett 1999, sec 5), which needs no stages of its own; its norm stays what it is but for rounding, 1e-16 a
step: whoever takes thousands of steps normalises it now and then.
"""

from __future__ import annotations

import math
from typing import Final

from bus.attitude import normalise
from bus.linear import ZERO3, add, invert_symmetric, times
from bus.units import Mat3, Vec3, Vec4

NORMALISE_MASK: Final = 0xFF  # the attitude's norm is set right every 256 steps
THIRD: Final = 1.0 / 3.0
SIXTH: Final = 1.0 / 6.0


class RigidBody:
    """Attitude and momentum of the body, advanced step by step.

    q_ib             : attitude, scalar first
    omega_bi_b_rad_s : body rate, body axes
    turn_b_rad       : integral of the body rate over the last step, each axis
    """

    __slots__ = ("_dt_s", "_gyroscopic", "_momentum", "_rates", "_step", "omega_bi_b_rad_s", "q_ib", "turn_b_rad")

    def __init__(
        self,
        inertia_kgm2: Mat3,
        q_ib: Vec4,
        omega_bi_b_rad_s: Vec3,
        h_b_nms: Vec3,
        dt_s: float,
        gyroscopic: bool = True,
    ) -> None:
        """h_b_nms: momentum of the wheels at the start. Raises ValueError when the inertia is singular."""
        self.q_ib = normalise(q_ib)
        self.omega_bi_b_rad_s = omega_bi_b_rad_s
        self.turn_b_rad: Vec3 = ZERO3
        self._dt_s = dt_s
        self._gyroscopic = gyroscopic
        momentum = times(inertia_kgm2, omega_bi_b_rad_s)
        self._momentum = add(momentum, h_b_nms) if gyroscopic else momentum  # P, or J w alone
        (a, b, c), (_, d, e), (_, _, f) = invert_symmetric(inertia_kgm2)
        half = 0.5 * dt_s
        self._rates = (a * half, b * half, c * half, d * half, e * half, f * half)  # from P - h to g = dt/2 w
        self._step = 0

    def find_total_momentum(self, h_b_nms: Vec3) -> Vec3:
        """Return the angular momentum of body and wheels, body axes [N m s]."""
        return self._momentum if self._gyroscopic else add(self._momentum, h_b_nms)

    def advance(self, h_b_nms: Vec3, tau_b_nm: Vec3, external_b_nm: Vec3) -> Vec3:
        """Move to the end of the step; return the momentum of the wheels there, body axes [N m s].

        h_b_nms       : momentum of the wheels at the start of the step
        tau_b_nm      : torque of the wheels on the body, constant over the step: h' = -tau
        external_b_nm : external torque, held over the step
        """
        tx, ty, tz = tau_b_nm
        if self._gyroscopic:
            h_b_nms = self._integrate(h_b_nms, (-tx, -ty, -tz), external_b_nm)
        else:
            x, y, z = external_b_nm
            self._integrate(ZERO3, ZERO3, (x + tx, y + ty, z + tz))
            x, y, z = h_b_nms
            dt_s = self._dt_s
            h_b_nms = (x - tx * dt_s, y - ty * dt_s, z - tz * dt_s)
        if not self._step & NORMALISE_MASK:
            self.q_ib = normalise(self.q_ib)
        self._step += 1
        return h_b_nms

    def _integrate(self, h: Vec3, h_rate: Vec3, torque: Vec3) -> Vec3:
        """Advance attitude, momentum and rate; return the wheels' momentum at the end.

        Momentum and rate integral: classical Runge-Kutta; its stages work on g = dt/2 w, so that P + P x g is the
        half-step of P. One function, long but straight: the stages share their numbers, and calls would cost as much
        as the work.
        """
        half = 0.5 * self._dt_s
        a, b, c, d, e, f = self._rates
        q0, q1, q2, q3 = self.q_ib
        px, py, pz = self._momentum
        hx, hy, hz = h
        sx, sy, sz = h_rate
        sx *= half
        sy *= half
        sz *= half
        tx, ty, tz = torque
        tx *= half
        ty *= half
        tz *= half
        # stage 1; k, l and n are increments of P over half a step
        gx, gy, gz = self.omega_bi_b_rad_s
        gx *= half
        gy *= half
        gz *= half
        kx = py * gz - pz * gy + tx
        ky = pz * gx - px * gz + ty
        kz = px * gy - py * gx + tz
        # stage 2
        hx += sx
        hy += sy
        hz += sz
        mx = px + kx
        my = py + ky
        mz = pz + kz
        x = mx - hx
        y = my - hy
        z = mz - hz
        ax = a * x + b * y + c * z
        ay = b * x + d * y + e * z
        az = c * x + e * y + f * z
        lx = my * az - mz * ay + tx
        ly = mz * ax - mx * az + ty
        lz = mx * ay - my * ax + tz
        # stage 3
        mx = px + lx
        my = py + ly
        mz = pz + lz
        x = mx - hx
        y = my - hy
        z = mz - hz
        bx = a * x + b * y + c * z
        by = b * x + d * y + e * z
        bz = c * x + e * y + f * z
        nx = my * bz - mz * by + tx
        ny = mz * bx - mx * bz + ty
        nz = mx * by - my * bx + tz
        # stage 4, at the end of the step
        mx = px + nx + nx
        my = py + ny + ny
        mz = pz + nz + nz
        hx += sx
        hy += sy
        hz += sz
        x = mx - hx
        y = my - hy
        z = mz - hz
        ex = a * x + b * y + c * z
        ey = b * x + d * y + e * z
        ez = c * x + e * y + f * z
        px += THIRD * (kx + 2.0 * (lx + nx) + my * ez - mz * ey + tx)
        py += THIRD * (ky + 2.0 * (ly + ny) + mz * ex - mx * ez + ty)
        pz += THIRD * (kz + 2.0 * (lz + nz) + mx * ey - my * ex + tz)
        ax = gx + 2.0 * (ax + bx) + ex
        ay = gy + 2.0 * (ay + by) + ey
        az = gz + 2.0 * (az + bz) + ez
        # from here on: e = g at the end of the step, r = phi/2
        x = px - hx
        y = py - hy
        z = pz - hz
        ex = a * x + b * y + c * z
        ey = b * x + d * y + e * z
        ez = c * x + e * y + f * z
        rx = SIXTH * (ax + gy * ez - gz * ey)
        ry = SIXTH * (ay + gz * ex - gx * ez)
        rz = SIXTH * (az + gx * ey - gy * ex)
        angle = math.sqrt(rx * rx + ry * ry + rz * rz)
        r0 = math.cos(angle)
        if angle:
            x = math.sin(angle) / angle
            rx *= x
            ry *= x
            rz *= x
        self.q_ib = (
            q0 * r0 - q1 * rx - q2 * ry - q3 * rz,
            q0 * rx + q1 * r0 + q2 * rz - q3 * ry,
            q0 * ry + q2 * r0 + q3 * rx - q1 * rz,
            q0 * rz + q3 * r0 + q1 * ry - q2 * rx,
        )
        per_half = 1.0 / half
        self._momentum = (px, py, pz)
        self.omega_bi_b_rad_s = (ex * per_half, ey * per_half, ez * per_half)
        self.turn_b_rad = (THIRD * ax, THIRD * ay, THIRD * az)
        return (hx, hy, hz)
