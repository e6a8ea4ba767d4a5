"""Takagi-Sugeno model of the rigid body: nine operating points, weights, and the matrices between them.

Wang, Li & Ma 2010 (J. Harbin Inst. Tech. 42(9)), section 2. The membership functions of the paper are lost; `exact9`
makes the interpolation of the nine local models exact, which the paper's model is not (see docs/gyro-fdi.md).
"""

from __future__ import annotations

from typing import Final

from bus.linear import ZERO3, times_matrix
from bus.units import Mat3, Vec3

OPERATING_RATE_RAD_S: Final = 0.15
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


def make_a(j: Mat3, j_inv: Mat3, w: Vec3) -> Mat3:
    """Return A(w) = -J^-1 [w x] J, shape (3, 3) [rad/s]: w' = A(w) w + J^-1 u."""
    return times_matrix(j_inv, times_matrix(_cross_matrix((-w[0], -w[1], -w[2])), j))


def make_f(j: Mat3, j_inv: Mat3, w: Vec3, h_rw_b_nms: Vec3 = ZERO3) -> Mat3:
    """Return F(w, h) = -J^-1 ([w x] J - [(J w + h) x]), shape (3, 3) [rad/s].

    The error of an observer with premise xh obeys e' = F((x + xh)/2) e - v exactly, A being linear in w.
    """
    h = h_rw_b_nms
    jw = tuple(r[0] * w[0] + r[1] * w[1] + r[2] * w[2] + h[i] for i, r in enumerate(j))
    first, second = times_matrix(_cross_matrix(w), j), _cross_matrix((jw[0], jw[1], jw[2]))
    inner = tuple(tuple(s - f for f, s in zip(p, q, strict=True)) for p, q in zip(first, second, strict=True))
    return times_matrix(j_inv, inner)  # type: ignore[arg-type]


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
