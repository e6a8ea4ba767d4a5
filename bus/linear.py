"""Vectors and matrices of three and four plain floats: what both sides need of linear algebra, written out.

Fixed summation order, no matrix library: the same bits on every run.
"""

from __future__ import annotations

from bus.units import Mat3, Vec3, Vec4

__all__ = [
    "IDENTITY3", "ZERO3", "ZERO4", "add", "cross", "dot", "invert_symmetric", "scale", "subtract", "times", "times_matrix",
]  # fmt: skip

ZERO3: Vec3 = (0.0, 0.0, 0.0)
ZERO4: Vec4 = (0.0, 0.0, 0.0, 0.0)
IDENTITY3: Mat3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def add(a: Vec3, b: Vec3) -> Vec3:
    """Return a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def subtract(a: Vec3, b: Vec3) -> Vec3:
    """Return a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(a: Vec3, k: float) -> Vec3:
    """Return k a."""
    return (a[0] * k, a[1] * k, a[2] * k)


def dot(a: Vec3, b: Vec3) -> float:
    """Return the inner product of a and b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vec3, b: Vec3) -> Vec3:
    """Return a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def times(m: Mat3, v: Vec3) -> Vec3:
    """Return the matrix m, rows first, times the vector v."""
    (a, b, c), (d, e, f), (g, h, i) = m
    x, y, z = v
    return (a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z)


def times_matrix(a: Mat3, b: Mat3) -> Mat3:
    """Return the product a b of two matrices, rows first."""
    (b00, b01, b02), (b10, b11, b12), (b20, b21, b22) = b
    rows = [(x * b00 + y * b10 + z * b20, x * b01 + y * b11 + z * b21, x * b02 + y * b12 + z * b22) for x, y, z in a]
    return (rows[0], rows[1], rows[2])


def invert_symmetric(m: Mat3) -> Mat3:
    """Return the inverse of a symmetric matrix, by cofactors. Raises ValueError when it is singular."""
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
