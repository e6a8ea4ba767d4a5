"""Attitude arithmetic of the flight software: scalar-first Hamilton quaternions, v_i = R(q_ib) v_b, in plain floats.

Unrolled because these run several times in every tick; sums have a fixed order, so results repeat bit for bit.
"""

from __future__ import annotations

import math

from bus.units import Mat3, Vec3, Vec4


def multiply(p: Vec4, q: Vec4) -> Vec4:
    """Return p q: the rotation q followed, in the frame it is seen from, by p."""
    a, b, c, d = p
    e, f, g, h = q
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


def conjugate(q: Vec4) -> Vec4:
    """Return the inverse of a unit quaternion."""
    return (q[0], -q[1], -q[2], -q[3])


def normalise(q: Vec4) -> Vec4:
    """Return q scaled to length one; its length must not be zero."""
    a, b, c, d = q
    n = 1.0 / math.sqrt(a * a + b * b + c * c + d * d)
    return (a * n, b * n, c * n, d * n)


def turn(q: Vec4, x: float, y: float, z: float) -> Vec4:
    """Return q exp((x, y, z) / 2): q turned by a rotation vector in body axes [rad]."""
    n2 = x * x + y * y + z * z
    if n2 < 0.01:  # series to 1e-11 of the exact half-angle functions
        s = 0.5 - n2 * (1.0 / 48.0 - n2 / 3840.0)
        e = 1.0 - n2 * (0.125 - n2 / 384.0)
    else:
        n = math.sqrt(n2)
        s = math.sin(0.5 * n) / n
        e = math.cos(0.5 * n)
    f, g, h = s * x, s * y, s * z
    a, b, c, d = q
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


def rotation_vector(q: Vec4) -> Vec3:
    """Return the rotation vector of a unit quaternion, the shorter way round [rad]."""
    a, b, c, d = q
    if a < 0.0:
        a, b, c, d = -a, -b, -c, -d
    s = math.sqrt(b * b + c * c + d * d)
    k = 2.0 * math.atan2(s, a) / s if s > 1e-12 else 2.0
    return (k * b, k * c, k * d)


def rotation_matrix(q: Vec4) -> Mat3:
    """Return R(q) of a unit quaternion, shape (3, 3), v_i = R(q_ib) v_b."""
    a, b, c, d = q
    return (
        (1.0 - 2.0 * (c * c + d * d), 2.0 * (b * c - a * d), 2.0 * (b * d + a * c)),
        (2.0 * (b * c + a * d), 1.0 - 2.0 * (b * b + d * d), 2.0 * (c * d - a * b)),
        (2.0 * (b * d - a * c), 2.0 * (c * d + a * b), 1.0 - 2.0 * (b * b + c * c)),
    )
