"""sig(x)^a = sign(x) |x|^a: the power that finite-time laws are made of. Steep at zero for a < 1."""

from __future__ import annotations

import math

from bus.units import Vec3


def sig(x: float, a: float) -> float:
    """Return sign(x) |x|^a, in the unit of x to the a; 0 for x = 0."""
    return math.copysign(math.pow(abs(x), a), x)


def sig3(v: Vec3, a: float) -> Vec3:
    """Return sig(v)^a element by element."""
    x, y, z = v
    return (sig(x, a), sig(y, a), sig(z, a))


def sig_along(v: Vec3, a: float) -> Vec3:
    """Return |v|^(a - 1) v, which keeps the direction of v; zeros for v = 0."""
    x, y, z = v
    norm = math.sqrt(x * x + y * y + z * z)
    if norm == 0.0:
        return v
    k = math.pow(norm, a) / norm
    return (k * x, k * y, k * z)
