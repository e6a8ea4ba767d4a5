"""Takagi-Sugeno model of the rigid body: nine operating points, weights, and the matrices between them.

Wang, Li & Ma 2010 (J. Harbin Inst. Tech. 42(9)), section 2. The membership functions of the paper are lost; `exact9`
makes the interpolation of the nine local models exact, which the paper's model is not (see docs/gyro-fdi.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable

from bus.units import Mat3, Vec3

OPERATING_RATE_RAD_S = 0.15
# Signs of the nine operating points, times OPERATING_RATE_RAD_S; the order is part of every gains file.
VERTEX_SIGNS: tuple[Vec3, ...] = (
    (0.0, 0.0, 0.0),
    (1.0, 1.0, 1.0),
    (1.0, -1.0, 1.0),
    (-1.0, -1.0, 1.0),
    (-1.0, 1.0, 1.0),
    (1.0, 1.0, -1.0),
    (1.0, -1.0, -1.0),
    (-1.0, -1.0, -1.0),
    (-1.0, 1.0, -1.0),
)
Weights = tuple[float, ...]  # one per operating point, never negative, sum 1


def clip_premise(z_rad_s: Vec3) -> Vec3:
    """Return the rate [rad/s] moved to the nearest point of the cube of operating points."""
    a = OPERATING_RATE_RAD_S
    x, y, z = z_rad_s
    return (-a if x < -a else min(x, a), -a if y < -a else min(y, a), -a if z < -a else min(z, a))


def is_inside(z_rad_s: Vec3) -> bool:
    """Return whether a rate [rad/s] lies in the cube of operating points."""
    a = OPERATING_RATE_RAD_S
    x, y, z = z_rad_s
    return -a <= x <= a and -a <= y <= a and -a <= z <= a


def weigh_exact9(z_rad_s: Vec3) -> Weights:
    """Return nine weights whose mean of the operating points is the (clipped) rate itself, hence A_TS = A exactly.

    h_0 = 1 - s with s = max |z_j| / a; the rest is spread trilinearly on the cube scaled by s, on which z lies.
    """
    x, y, z = clip_premise(z_rad_s)
    a = OPERATING_RATE_RAD_S
    s = max(abs(x), abs(y), abs(z)) / a
    if s < 1e-12:  # closer to the origin than any rate is known
        return (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    k = 1.0 / (a * s)
    return (1.0 - s, *_spread(x * k, y * k, z * k, s))


def weigh_tri8(z_rad_s: Vec3) -> Weights:
    """Return the trilinear weights of the eight vertices; the rule at rest gets none. As exact as `exact9`."""
    x, y, z = clip_premise(z_rad_s)
    k = 1.0 / OPERATING_RATE_RAD_S
    return (0.0, *_spread(x * k, y * k, z * k, 1.0))


def weigh_gauss(z_rad_s: Vec3) -> Weights:
    """Return normalised Gaussian weights of width a/2, a common choice and not exact: for comparison only."""
    a = OPERATING_RATE_RAD_S
    x, y, z = clip_premise(z_rad_s)
    raw = [
        math.exp(-2.0 * ((x - a * p) ** 2 + (y - a * q) ** 2 + (z - a * r) ** 2) / (a * a)) for p, q, r in VERTEX_SIGNS
    ]
    total = math.fsum(raw)
    return tuple(h / total for h in raw)


WEIGHTS: dict[str, Callable[[Vec3], Weights]] = {"exact9": weigh_exact9, "tri8": weigh_tri8, "gauss": weigh_gauss}


def make_a(j: Mat3, j_inv: Mat3, w: Vec3) -> Mat3:
    """Return A(w) = -J^-1 [w x] J, shape (3, 3) [rad/s]: w' = A(w) w + J^-1 u."""
    return _times(j_inv, _times(_cross_matrix((-w[0], -w[1], -w[2])), j))


def make_f(j: Mat3, j_inv: Mat3, w: Vec3, h_rw_b_nms: Vec3 = (0.0, 0.0, 0.0)) -> Mat3:
    """Return F(w, h) = -J^-1 ([w x] J - [(J w + h) x]), shape (3, 3) [rad/s].

    The error of an observer with premise xh obeys e' = F((x + xh)/2) e - v exactly, A being linear in w.
    """
    h = h_rw_b_nms
    jw = tuple(r[0] * w[0] + r[1] * w[1] + r[2] * w[2] + h[i] for i, r in enumerate(j))
    first, second = _times(_cross_matrix(w), j), _cross_matrix((jw[0], jw[1], jw[2]))
    inner = tuple(tuple(s - f for f, s in zip(p, q, strict=True)) for p, q in zip(first, second, strict=True))
    return _times(j_inv, inner)  # type: ignore[arg-type]


def invert(m: Mat3) -> Mat3:
    """Return the inverse of a symmetric positive definite matrix, shape (3, 3)."""
    (a, b, c), (_, d, e), (_, _, f) = m
    p, q, r = d * f - e * e, c * e - b * f, b * e - c * d
    k = 1.0 / (a * p + b * q + c * r)
    s, t, u = (a * f - c * c) * k, (b * c - a * e) * k, (a * d - b * b) * k
    return ((p * k, q * k, r * k), (q * k, s, t), (r * k, t, u))


def _spread(x: float, y: float, z: float, total: float) -> Weights:
    """Trilinear weights of the eight vertices for coordinates in [-1, 1], in the order of VERTEX_SIGNS."""
    k = 0.125 * total
    xp, xm, yp, ym = 1.0 + x, 1.0 - x, 1.0 + y, 1.0 - y
    zp, zm = k * (1.0 + z), k * (1.0 - z)
    pp, pm, mm, mp = xp * yp, xp * ym, xm * ym, xm * yp
    return (pp * zp, pm * zp, mm * zp, mp * zp, pp * zm, pm * zm, mm * zm, mp * zm)


def _cross_matrix(w: Vec3) -> Mat3:
    x, y, z = w
    return ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))


def _times(a: Mat3, b: Mat3) -> Mat3:
    (b00, b01, b02), (b10, b11, b12), (b20, b21, b22) = b
    return tuple(  # type: ignore[return-value]
        (x * b00 + y * b10 + z * b20, x * b01 + y * b11 + z * b21, x * b02 + y * b12 + z * b22) for x, y, z in a
    )
