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
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from bus.units import Mat3, Vec3, Vec4

# attitude, momentum, wheel momentum, rate, angle turned through about each body axis over the step, momentum and
# relative speed of each rotor
StepResult = tuple[Vec4, Vec3, Vec3, Vec3, Vec3, Vec4, Vec4]
Stepper = Callable[[Vec4, Vec3, Vec3, Vec3, Vec3, Vec3, Vec4, Vec4], StepResult]

NO_WHEELS: tuple[Vec3, ...] = ((0.0, 0.0, 0.0),) * 4


def invert_symmetric(m: Mat3) -> Mat3:
    """Return the inverse of a symmetric 3 x 3 matrix, by cofactors. Raises ValueError when it is singular."""
    (a, b, c), (_, d, e), (_, _, f) = m
    c11 = d * f - e * e
    c12 = c * e - b * f
    c13 = b * e - c * d
    det = a * c11 + b * c12 + c * c13
    if det == 0.0:
        raise ValueError(f"the matrix {m} is singular")
    c22 = a * f - c * c
    c23 = b * c - a * e
    c33 = a * d - b * b
    k = 1.0 / det
    return ((c11 * k, c12 * k, c13 * k), (c12 * k, c22 * k, c23 * k), (c13 * k, c23 * k, c33 * k))


def multiply_matrix(m: Mat3, v: Vec3) -> Vec3:
    """Return m v."""
    x, y, z = v
    return (
        m[0][0] * x + m[0][1] * y + m[0][2] * z,
        m[1][0] * x + m[1][1] * y + m[1][2] * z,
        m[2][0] * x + m[2][1] * y + m[2][2] * z,
    )


def build_stepper(
    inertia_inverse: Mat3,
    dt_s: float,
    axes_b: Sequence[Vec3] = NO_WHEELS,
    rotor_inertia_kgm2: Vec4 = (1.0, 1.0, 1.0, 1.0),
) -> Stepper:
    """Return the function that advances attitude and momenta by one step of dt_s, to fourth order.

    The function takes (q_ib, momentum_b_nms, h_b_nms, omega_bi_b_rad_s, h_rate_b_nm, torque_b_nm, h_rw_nms, tau_rw_nm):
    attitude, total angular momentum, wheel momentum and body rate at the start of the step, the constant rate of change of
    the wheel momentum, and the external torque held over the step, body axes; then momentum and torque of each rotor. It
    returns the first four at the end of the step, the integral of each body rate [rad], the momentum of each rotor and its
    speed relative to the body. The norm of q_ib stays what it is but for rounding, 1e-16 a step: whoever takes thousands of
    steps normalises it now and then.

    Momentum and rate integral: classical Runge-Kutta; its stages work on g = dt/2 w, so that P + P x g is the half-step
    of P. Attitude: q exp(phi/2) with the rotation vector phi = integral of w + dt^2/12 w(0) x w(dt), Magnus' series
    (Iserles & Norsett 1999, sec 5), which needs no stages of its own.
    """
    half = 0.5 * dt_s
    (a, b, c), (_, d, e), (_, _, f) = inertia_inverse
    a, b, c, d, e, f = a * half, b * half, c * half, d * half, e * half, f * half
    (ax1, ay1, az1), (ax2, ay2, az2), (ax3, ay3, az3), (ax4, ay4, az4) = axes_b
    i1, i2, i3, i4 = (1.0 / inertia for inertia in rotor_inertia_kgm2)
    per_half = 1.0 / half
    third = 1.0 / 3.0
    sixth = 1.0 / 6.0
    sqrt, sin, cos = math.sqrt, math.sin, math.cos

    def step(
        q: Vec4, momentum: Vec3, h: Vec3, omega: Vec3, h_rate: Vec3, torque: Vec3, h_rw: Vec4, tau_rw: Vec4
    ) -> StepResult:
        q0, q1, q2, q3 = q
        px, py, pz = momentum
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
        gx, gy, gz = omega
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
        px += third * (kx + 2.0 * (lx + nx) + my * ez - mz * ey + tx)
        py += third * (ky + 2.0 * (ly + ny) + mz * ex - mx * ez + ty)
        pz += third * (kz + 2.0 * (lz + nz) + mx * ey - my * ex + tz)
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
        rx = sixth * (ax + gy * ez - gz * ey)
        ry = sixth * (ay + gz * ex - gx * ez)
        rz = sixth * (az + gx * ey - gy * ex)
        angle = sqrt(rx * rx + ry * ry + rz * rz)
        r0 = cos(angle)
        if angle:
            x = sin(angle) / angle
            rx *= x
            ry *= x
            rz *= x
        q = (
            q0 * r0 - q1 * rx - q2 * ry - q3 * rz,
            q0 * rx + q1 * r0 + q2 * rz - q3 * ry,
            q0 * ry + q2 * r0 + q3 * rx - q1 * rz,
            q0 * rz + q3 * r0 + q1 * ry - q2 * rx,
        )
        x = ex * per_half
        y = ey * per_half
        z = ez * per_half
        h1, h2, h3, h4 = h_rw
        t1, t2, t3, t4 = tau_rw
        h1 -= t1 * dt_s
        h2 -= t2 * dt_s
        h3 -= t3 * dt_s
        h4 -= t4 * dt_s
        return (
            q, (px, py, pz), (hx, hy, hz), (x, y, z), (third * ax, third * ay, third * az), (h1, h2, h3, h4),
            (
                h1 * i1 - ax1 * x - ay1 * y - az1 * z,
                h2 * i2 - ax2 * x - ay2 * y - az2 * z,
                h3 * i3 - ax3 * x - ay3 * y - az3 * z,
                h4 * i4 - ax4 * x - ay4 * y - az4 * z,
            ),
        )  # fmt: skip

    return step
