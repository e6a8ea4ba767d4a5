"""Four reaction wheels and their axes: between what each wheel does and what the body feels of it.

D0, shape (3, 4), has the wheels' nominal axes as its columns: tau_b = D0 tau_rw (Zhang, Ye & Sun 2018, eq (5)). Every
product is unrolled: fixed summation order, no matrix library in the cycle.
"""

from __future__ import annotations

import itertools
import math
from typing import Final

from bus.errors import ConfigError
from bus.linear import ZERO3, ZERO4, cross, dot, invert_symmetric, times
from bus.units import Mat3, Vec3, Vec4
from fsw.records import ALL_WHEELS, Flags4

SKEW: Final = 1.0 / math.sqrt(3.0)  # of each body axis in the direction of the wheel that is askew to all
PARALLEL: Final = 1e-9  # sine of the angle below which two axes are one
FLAT: Final = 1e-6  # determinant of D0 D0^T below which the axes lie in a plane
THIN: Final = 1e-3  # sine of the angle below which an axis adds no direction that could be used
NOTHING_NM: Final = 1e-12  # far below any torque, keeps a quotient finite
WheelAxes = tuple[Vec3, Vec3, Vec3, Vec3]


class WheelGeometry:
    """Axes and torque limits of the four wheels."""

    __slots__ = ("_facets", "_rows", "_spread", "axes_b", "max_torque_nm")

    def __init__(self, axes_b: WheelAxes, max_torque_nm: Vec4) -> None:
        """axes_b: unit vectors, body axes; zero for a wheel that is not there.

        Raises ConfigError where they lie in one plane: an axis is then out of reach.
        """
        self.axes_b = axes_b
        self.max_torque_nm = max_torque_nm
        (ax, ay, az), (bx, by, bz), (cx, cy, cz), (dx, dy, dz) = axes_b
        self._rows: tuple[Vec4, Vec4, Vec4] = ((ax, bx, cx, dx), (ay, by, cy, dy), (az, bz, cz, dz))
        gram = self._find_gram((1.0, 1.0, 1.0, 1.0))
        if not _determine(gram) > FLAT:
            raise ConfigError(
                f"model.wheels: the axes {axes_b} lie in one plane; no torque about its normal is possible"
            )
        inverse = invert_symmetric(gram)
        a, b, c, d = (times(inverse, axis) for axis in axes_b)
        self._spread: WheelAxes = (a, b, c, d)
        self._facets = tuple(self._find_facets())

    def combine(self, per_wheel: Vec4) -> Vec3:
        """Return D0 per_wheel: body vector of a per-wheel quantity, in that quantity's unit (torque or momentum)."""
        p, q, r, s = per_wheel
        (ax, bx, cx, dx), (ay, by, cy, dy), (az, bz, cz, dz) = self._rows
        return (ax * p + bx * q + cx * r + dx * s, ay * p + by * q + cy * r + dy * s, az * p + bz * q + cz * r + dz * s)

    def project(self, vector_b: Vec3) -> Vec4:
        """Return D0^T vector_b: component of a body vector along each wheel axis, in the vector's unit."""
        a, b, c, d = self.axes_b
        return (dot(a, vector_b), dot(b, vector_b), dot(c, vector_b), dot(d, vector_b))

    def spread(self, vector_b: Vec3) -> Vec4:
        """Return D0^T (D0 D0^T)^-1 vector_b: the wheel torques (or momenta) of least square that add up to it."""
        x, y, z = vector_b
        (ax, ay, az), (bx, by, bz), (cx, cy, cz), (dx, dy, dz) = self._spread
        return (ax * x + ay * y + az * z, bx * x + by * y + bz * z, cx * x + cy * y + cz * z, dx * x + dy * y + dz * z)

    def spread_weighted(self, vector_b: Vec3, share: Vec4) -> Vec4:
        """Return the commands u of least square with D0 diag(share) u = vector_b, in the vector's unit.

        u = C D0^T z with (D0 C^2 D0^T) z = vector_b, C = diag(share): a weaker wheel is asked for less. Where the wheels
        with a share > 0 cannot give every direction, what they can give of the vector (least squares).
        """
        gram = self._find_gram(share)
        largest = max(gram[0][0], gram[1][1], gram[2][2])
        if not largest > 0.0:
            return ZERO4
        if _determine(gram) <= FLAT * largest**3:
            small = FLAT * largest  # Tikhonov: out of the directions that are left, none is asked for beyond reason
            (a, b, c), (_, d, e), (_, _, f) = gram
            gram = ((a + small, b, c), (b, d + small, e), (c, e, f + small))
        z = times(invert_symmetric(gram), vector_b)
        p, q, r, s = self.project(z)
        a_, b_, c_, d_ = share
        return (a_ * p, b_ * q, c_ * r, d_ * s)

    def limit(self, tau_rw_nm: Vec4) -> Vec4:
        """Return the wheel torques, each cut to its own limit [N m]."""
        a, b, c, d = tau_rw_nm
        la, lb, lc, ld = self.max_torque_nm
        return (
            -la if a < -la else la if a > la else a,
            -lb if b < -lb else lb if b > lb else b,
            -lc if c < -lc else lc if c > lc else c,
            -ld if d < -ld else ld if d > ld else d,
        )

    def add_within(self, tau_rw_nm: Vec4, more_nm: Vec4) -> Vec4:
        """Return the wheel torques with others added, by one factor up to 1 that keeps every wheel in its limit [N m]."""
        factor = 1.0
        for torque, add, limit in zip(tau_rw_nm, more_nm, self.max_torque_nm, strict=True):
            if add != 0.0:
                room = (limit - abs(torque)) / abs(add)
                factor = min(factor, room if room > 0.0 else 0.0)
        (a, b, c, d), (p, q, r, s) = tau_rw_nm, more_nm
        return (a + factor * p, b + factor * q, c + factor * r, d + factor * s)

    def find_load(self, tau_rw_nm: Vec4) -> float:
        """Return the largest share of its limit that a wheel is asked for [1]."""
        a, b, c, d = tau_rw_nm
        la, lb, lc, ld = self.max_torque_nm
        return max(abs(a) / la, abs(b) / lb, abs(c) / lc, abs(d) / ld)

    def find_authority(self, direction_b: Vec3, limit_nm: Vec4, given_b_nm: Vec3 = ZERO3) -> tuple[float, float]:
        """Return the largest m with D0 u + given = m t, |u_i| <= limit_i, now and after the worst loss of one wheel [1].

        The torques that can be had are a polytope whose facets each lie between two wheels' axes: with n the normal of
        such a pair, turned so that n.t > 0, m n.t <= sum |n.a_k| limit_k + n.given. Losing a wheel takes its term out of
        the sum. Infinite for t = 0; 0 where what is given leaves nothing in the direction t.

        given_b_nm : torque on the body that is there whatever the wheels are told, body axes [N m]
        """
        now = worst = math.inf
        la, lb, lc, ld = limit_nm
        for normal, (wa, wb, wc, wd) in self._facets:
            along, help_nm = dot(normal, direction_b), dot(normal, given_b_nm)
            if along == 0.0:
                continue
            if along < 0.0:
                along, help_nm = -along, -help_nm
            a, b, c, d = wa * la, wb * lb, wc * lc, wd * ld
            total = a + b + c + d + help_nm
            m = (total + NOTHING_NM) / along
            if m < now:
                now = m
            m = (total - max(a, b, c, d) + NOTHING_NM) / along
            if m < worst:
                worst = m
        return (now if now > 0.0 else 0.0, worst if worst > 0.0 else 0.0)

    def find_weakest(self, limit_nm: Vec4) -> float:
        """Return the torque that these wheels can give in every direction: the least of those along the facets' normals."""
        return min([self.find_authority(normal, limit_nm)[0] for normal, _ in self._facets])

    def count_axes(self, available: Flags4) -> int:
        """Return how many independent directions of torque these wheels have, 0 .. 3."""
        axes = [axis for axis, use in zip(self.axes_b, available, strict=True) if use and dot(axis, axis) > 0.0]
        if not axes:
            return 0
        first = axes[0]
        for other in axes[1:]:
            normal = cross(first, other)
            square = dot(normal, normal)
            if square > THIN * THIN:
                least = THIN * math.sqrt(square)
                return 3 if any(abs(dot(normal, axis)) > least for axis in axes) else 2
        return 1

    def find_null(self, available: Flags4) -> Vec4:
        """Return the wheel torques, the largest of them 1, that add up to nothing on the body; zeros where there are none.

        By cofactors of D0: one wheel more than axes is needed, and all four to be available.
        """
        if available != ALL_WHEELS:
            return ZERO4
        a, b, c, d = self.axes_b
        p, q = dot(cross(b, c), d), -dot(cross(a, c), d)
        r, s = dot(cross(a, b), d), -dot(cross(a, b), c)
        largest = max(abs(p), abs(q), abs(r), abs(s))
        if not largest > THIN:
            return ZERO4
        return (p / largest, q / largest, r / largest, s / largest)

    def find_largest(self, row: Vec3) -> float:
        """Return the largest |row . tau_b| that the wheels can give, each within its limit, in row's unit times N m."""
        a, b, c, d = self.project(row)
        la, lb, lc, ld = self.max_torque_nm
        return abs(a) * la + abs(b) * lb + abs(c) * lc + abs(d) * ld

    def _find_gram(self, share: Vec4) -> Mat3:
        """D0 diag(share)^2 D0^T."""
        (ax, ay, az), (bx, by, bz), (cx, cy, cz), (dx, dy, dz) = self.axes_b
        a, b, c, d = share[0] ** 2, share[1] ** 2, share[2] ** 2, share[3] ** 2
        xy = a * ax * ay + b * bx * by + c * cx * cy + d * dx * dy
        xz = a * ax * az + b * bx * bz + c * cx * cz + d * dx * dz
        yz = a * ay * az + b * by * bz + c * cy * cz + d * dy * dz
        return (
            (a * ax * ax + b * bx * bx + c * cx * cx + d * dx * dx, xy, xz),
            (xy, a * ay * ay + b * by * by + c * cy * cy + d * dy * dy, yz),
            (xz, yz, a * az * az + b * bz * bz + c * cz * cz + d * dz * dz),
        )

    def _find_facets(self) -> list[tuple[Vec3, Vec4]]:
        """Normal of each pair of axes that is not one axis, and what of each wheel lies along it."""
        facets = []
        for one, other in itertools.combinations(self.axes_b, 2):
            x, y, z = cross(one, other)
            length = math.sqrt(x * x + y * y + z * z)
            if length > PARALLEL:
                normal = (x / length, y / length, z / length)
                a, b, c, d = (abs(dot(normal, axis)) for axis in self.axes_b)
                facets.append((normal, (a, b, c, d)))
        return facets


def _determine(m: Mat3) -> float:
    (a, b, c), (d, e, f), (g, h, i) = m
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
