"""Attitude in one convention for both sides: unit quaternions, scalar first, Hamilton product, v_i = R(q_ib) v_b.

`q_ib` is the attitude of the body frame b in the inertial frame i. Two letters read right to left, so that
q_ib = q_it * q_tb and R_ib = R_it R_tb. Its kinematics are q_ib' = 1/2 q_ib * (0, omega_bi_b), which is component by
component eq (1) of Zhang, Ye & Sun 2018: q0' = -1/2 q.w, q' = 1/2 (q x w + q0 w). Their Q, body relative to a fixed
target, is q_tb here. q and -q are one attitude.

Modified Rodrigues parameters are sigma = e tan(theta/4) of the same rotation. Everything is plain floats and tuples.
"""

from __future__ import annotations

import math

from bus.units import Mat3, Vec3, Vec4

__all__ = [
    "IDENTITY", "angle_between", "canonical", "conjugate", "dcm_from_quaternion", "error_quaternion", "exp_map",
    "log_map", "mrp_from_quaternion", "multiply", "normalise", "quaternion_from_dcm", "quaternion_from_mrp", "rotate",
    "rotate_back", "shadow_mrp",
]  # fmt: skip

IDENTITY: Vec4 = (1.0, 0.0, 0.0, 0.0)


def normalise(q: Vec4) -> Vec4:
    """Return q scaled to unit norm. Raises ValueError where the norm is zero or not finite."""
    a, b, c, d = q
    norm = math.sqrt(a * a + b * b + c * c + d * d)
    if not 0.0 < norm < math.inf:
        raise ValueError(f"cannot normalise the quaternion {q}: its norm is {norm}, a rotation needs a finite one > 0")
    return (a / norm, b / norm, c / norm, d / norm)


def canonical(q: Vec4) -> Vec4:
    """Return the one of q and -q whose scalar part is not negative: the short way round."""
    return (-q[0], -q[1], -q[2], -q[3]) if q[0] < 0.0 else q


def conjugate(q: Vec4) -> Vec4:
    """Return the inverse of a unit quaternion: q_bi of q_ib."""
    return (q[0], -q[1], -q[2], -q[3])


def multiply(p: Vec4, q: Vec4) -> Vec4:
    """Return the Hamilton product p * q, the rotation q followed by p: q_ac = q_ab * q_bc."""
    p0, p1, p2, p3 = p
    q0, q1, q2, q3 = q
    return (
        p0 * q0 - p1 * q1 - p2 * q2 - p3 * q3,
        p0 * q1 + p1 * q0 + p2 * q3 - p3 * q2,
        p0 * q2 - p1 * q3 + p2 * q0 + p3 * q1,
        p0 * q3 + p1 * q2 - p2 * q1 + p3 * q0,
    )


def rotate(q: Vec4, v: Vec3) -> Vec3:
    """Return R(q) v: a vector given in body axes, in inertial axes, for q = q_ib of unit norm."""
    q0, q1, q2, q3 = q
    x, y, z = v
    a = 2.0 * (q2 * z - q3 * y)
    b = 2.0 * (q3 * x - q1 * z)
    c = 2.0 * (q1 * y - q2 * x)
    return (x + q0 * a + q2 * c - q3 * b, y + q0 * b + q3 * a - q1 * c, z + q0 * c + q1 * b - q2 * a)


def rotate_back(q: Vec4, v: Vec3) -> Vec3:
    """Return R(q)^T v: a vector given in inertial axes, in body axes, for q = q_ib of unit norm."""
    return rotate((q[0], -q[1], -q[2], -q[3]), v)


def error_quaternion(q_ib: Vec4, q_it: Vec4) -> Vec4:
    """Return q_tb = q_it^-1 * q_ib, the attitude of the body relative to the target, with q0 >= 0."""
    return canonical(multiply(conjugate(q_it), q_ib))


def angle_between(p: Vec4, q: Vec4) -> float:
    """Return the angle of the rotation from one attitude to the other [rad], 0..pi, exact also near zero."""
    p0, p1, p2, p3 = p
    q0, q1, q2, q3 = q
    x = p0 * q1 - p1 * q0 - p2 * q3 + p3 * q2
    y = p0 * q2 + p1 * q3 - p2 * q0 - p3 * q1
    z = p0 * q3 - p1 * q2 + p2 * q1 - p3 * q0
    return 2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), abs(p0 * q0 + p1 * q1 + p2 * q2 + p3 * q3))


def dcm_from_quaternion(q: Vec4) -> Mat3:
    """Return R(q), rows first: R_ib of q_ib, so that v_i = R_ib v_b."""
    q0, q1, q2, q3 = q
    return (
        (1.0 - 2.0 * (q2 * q2 + q3 * q3), 2.0 * (q1 * q2 - q0 * q3), 2.0 * (q1 * q3 + q0 * q2)),
        (2.0 * (q1 * q2 + q0 * q3), 1.0 - 2.0 * (q1 * q1 + q3 * q3), 2.0 * (q2 * q3 - q0 * q1)),
        (2.0 * (q1 * q3 - q0 * q2), 2.0 * (q2 * q3 + q0 * q1), 1.0 - 2.0 * (q1 * q1 + q2 * q2)),
    )


def quaternion_from_dcm(r: Mat3) -> Vec4:
    """Return the unit quaternion of a rotation matrix, q0 >= 0.

    Shepperd 1978: divide by the largest of the four components, so that no rotation loses digits.
    """
    (a, b, c), (d, e, f), (g, h, i) = r
    trace = a + e + i
    largest = max(trace, a, e, i)
    if largest == trace:
        q = (1.0 + trace, h - f, c - g, d - b)
    elif largest == a:
        q = (h - f, 1.0 + 2.0 * a - trace, b + d, c + g)
    elif largest == e:
        q = (c - g, b + d, 1.0 + 2.0 * e - trace, f + h)
    else:
        q = (d - b, c + g, f + h, 1.0 + 2.0 * i - trace)
    return canonical(normalise(q))


def mrp_from_quaternion(q: Vec4) -> Vec3:
    """Return the modified Rodrigues parameters of the short rotation, |sigma| <= 1."""
    q0, q1, q2, q3 = canonical(q)
    scale = 1.0 / (1.0 + q0)
    return (q1 * scale, q2 * scale, q3 * scale)


def quaternion_from_mrp(sigma: Vec3) -> Vec4:
    """Return the unit quaternion of modified Rodrigues parameters, which may be the shadow set (then q0 < 0)."""
    x, y, z = sigma
    square = x * x + y * y + z * z
    scale = 1.0 / (1.0 + square)
    return ((1.0 - square) * scale, 2.0 * x * scale, 2.0 * y * scale, 2.0 * z * scale)


def shadow_mrp(sigma: Vec3) -> Vec3:
    """Return the other set of modified Rodrigues parameters of one attitude, -sigma/|sigma|^2.

    Raises ValueError at sigma = 0, whose shadow is at infinity.
    """
    x, y, z = sigma
    square = x * x + y * y + z * z
    if not square > 0.0:
        raise ValueError("the modified Rodrigues parameters (0, 0, 0) have no shadow set: it lies at infinity")
    return (-x / square, -y / square, -z / square)


def exp_map(phi: Vec3) -> Vec4:
    """Return the unit quaternion of a rotation vector phi = e theta [rad]."""
    x, y, z = phi
    square = x * x + y * y + z * z
    if square < 1e-6:  # the series is exact to the last bit here and has no 0/0
        half_sinc = 0.5 - square * (1.0 / 48.0 - square / 3840.0)
        cosine = 1.0 - square * (0.125 - square / 384.0)
    else:
        theta = math.sqrt(square)
        half_sinc = math.sin(0.5 * theta) / theta
        cosine = math.cos(0.5 * theta)
    return (cosine, x * half_sinc, y * half_sinc, z * half_sinc)


def log_map(q: Vec4) -> Vec3:
    """Return the rotation vector e theta [rad] of the short rotation of a unit quaternion, |phi| <= pi."""
    q0, q1, q2, q3 = canonical(q)
    sine = math.sqrt(q1 * q1 + q2 * q2 + q3 * q3)
    # atan2(s, c)/s tends to 1/c as s tends to 0, and c to 1
    scale = 2.0 * math.atan2(sine, q0) / sine if sine > 0.0 else 2.0
    return (q1 * scale, q2 * scale, q3 * scale)
