"""Rigid body with spinning wheels: attitude and momentum over one step, RK4, plain floats.

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

from collections.abc import Callable

from bus.units import Mat3, Vec3, Vec4

# attitude, momentum, wheel momentum, rate, angle turned through about each body axis over the step
StepResult = tuple[Vec4, Vec3, Vec3, Vec3, Vec3]
Stepper = Callable[[Vec4, Vec3, Vec3, Vec3, Vec3, Vec3], StepResult]


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


def build_stepper(inertia_inverse: Mat3, dt_s: float) -> Stepper:
    """Return the function that advances attitude and momentum by one step of dt_s, fourth-order Runge-Kutta.

    The function takes (q_ib, momentum_b_nms, h_b_nms, omega_bi_b_rad_s, h_rate_b_nm, torque_b_nm): attitude, total
    angular momentum, wheel momentum and body rate at the start of the step, the constant rate of change of the wheel
    momentum, and the external torque held over the step; all body axes. It returns the first four at the end of the
    step, q_ib renormalised, and the integral of each body rate [rad].

    Stages work on g = dt/4 w, so that q + q * g is the half-step of q and P + 2 P x g that of P.
    """
    quarter = 0.25 * dt_s
    (a, b, c), (_, d, e), (_, _, f) = inertia_inverse
    a, b, c, d, e, f = a * quarter, b * quarter, c * quarter, d * quarter, e * quarter, f * quarter
    half = 0.5 * dt_s
    per_quarter = 1.0 / quarter
    third = 1.0 / 3.0
    two_thirds = 2.0 / 3.0

    def step(q: Vec4, momentum: Vec3, h: Vec3, omega: Vec3, h_rate: Vec3, torque: Vec3) -> StepResult:
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
        # stage 1: u = increment of q over half a step, k = increment of P over half a step
        gx, gy, gz = omega
        gx *= quarter
        gy *= quarter
        gz *= quarter
        u0 = -q1 * gx - q2 * gy - q3 * gz
        u1 = q0 * gx + q2 * gz - q3 * gy
        u2 = q0 * gy + q3 * gx - q1 * gz
        u3 = q0 * gz + q1 * gy - q2 * gx
        kx = 2.0 * (py * gz - pz * gy) + tx
        ky = 2.0 * (pz * gx - px * gz) + ty
        kz = 2.0 * (px * gy - py * gx) + tz
        # stage 2
        hx += sx
        hy += sy
        hz += sz
        r0 = q0 + u0
        r1 = q1 + u1
        r2 = q2 + u2
        r3 = q3 + u3
        mx = px + kx
        my = py + ky
        mz = pz + kz
        x = mx - hx
        y = my - hy
        z = mz - hz
        ax = a * x + b * y + c * z
        ay = b * x + d * y + e * z
        az = c * x + e * y + f * z
        v0 = -r1 * ax - r2 * ay - r3 * az
        v1 = r0 * ax + r2 * az - r3 * ay
        v2 = r0 * ay + r3 * ax - r1 * az
        v3 = r0 * az + r1 * ay - r2 * ax
        lx = 2.0 * (my * az - mz * ay) + tx
        ly = 2.0 * (mz * ax - mx * az) + ty
        lz = 2.0 * (mx * ay - my * ax) + tz
        # stage 3
        r0 = q0 + v0
        r1 = q1 + v1
        r2 = q2 + v2
        r3 = q3 + v3
        mx = px + lx
        my = py + ly
        mz = pz + lz
        x = mx - hx
        y = my - hy
        z = mz - hz
        bx = a * x + b * y + c * z
        by = b * x + d * y + e * z
        bz = c * x + e * y + f * z
        w0 = -r1 * bx - r2 * by - r3 * bz
        w1 = r0 * bx + r2 * bz - r3 * by
        w2 = r0 * by + r3 * bx - r1 * bz
        w3 = r0 * bz + r1 * by - r2 * bx
        nx = 2.0 * (my * bz - mz * by) + tx
        ny = 2.0 * (mz * bx - mx * bz) + ty
        nz = 2.0 * (mx * by - my * bx) + tz
        # stage 4, at the end of the step
        r0 = q0 + w0 + w0
        r1 = q1 + w1 + w1
        r2 = q2 + w2 + w2
        r3 = q3 + w3 + w3
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
        # dt/6 (k1 + 2 k2 + 2 k3 + k4) = 1/3 (u + 2 v + 2 w + z) with the half-step increments
        q0 += third * (u0 + 2.0 * (v0 + w0) - r1 * ex - r2 * ey - r3 * ez)
        q1 += third * (u1 + 2.0 * (v1 + w1) + r0 * ex + r2 * ez - r3 * ey)
        q2 += third * (u2 + 2.0 * (v2 + w2) + r0 * ey + r3 * ex - r1 * ez)
        q3 += third * (u3 + 2.0 * (v3 + w3) + r0 * ez + r1 * ey - r2 * ex)
        # one Newton step of 1/|q|: the norm is within 1e-9 of one after a step
        norm = 1.5 - 0.5 * (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
        px += third * (kx + 2.0 * (lx + nx + my * ez - mz * ey) + tx)
        py += third * (ky + 2.0 * (ly + ny + mz * ex - mx * ez) + ty)
        pz += third * (kz + 2.0 * (lz + nz + mx * ey - my * ex) + tz)
        x = per_quarter * (px - hx)
        y = per_quarter * (py - hy)
        z = per_quarter * (pz - hz)
        return (
            (q0 * norm, q1 * norm, q2 * norm, q3 * norm),
            (px, py, pz),
            (hx, hy, hz),
            (a * x + b * y + c * z, b * x + d * y + e * z, c * x + e * y + f * z),
            (
                two_thirds * (gx + 2.0 * (ax + bx) + ex),
                two_thirds * (gy + 2.0 * (ay + by) + ey),
                two_thirds * (gz + 2.0 * (az + bz) + ez),
            ),
        )

    return step
