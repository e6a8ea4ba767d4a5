"""The body torques that wheels can give within their limits, and the commands that give one: direct allocation.

With b_k = share_k axis_k the set {sum b_k u_k, low_k <= u_k <= high_k} is a zonotope. Each of its facets lies between two
axes: n = +-(b_i x b_j) normalised, at the distance h = sum over the other wheels of max(n.b_k low_k, n.b_k high_k).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from bus.errors import ConfigError
from bus.linear import ZERO3, cross, dot
from bus.units import Vec3
from fsw.allocators.facet import FLAT, MOST_REACH, Column, Facet, find_normal

LEVEL = 1e-14  # part of a torque along a normal below which it is rounding, and no facet ahead
SLACK = 1e-12  # of a wheel's range, for the sorted search: rounding at an edge leaves no facet out
Plane = tuple[float, float, float, float, float, int]  # normal, distances of its two facets, number of the first


class AttainableSet:
    """The attainable torques of any number of wheels, and direct allocation on them.

    Patent CN103699131B (Wang, Duan, Liu & He 2016), claim 1: the ray along the torque meets one facet; its wheels' commands,
    scaled back to the torque, are the allocation. Differences:

    - the facet is found as the least of h / n.tau over the facets ahead, without the order by angle of the patent
      (`allocate_sorted` has that, as a cross-check);
    - limits may differ by sign, wheels may be dead (share 0: command 0) or stuck (low = high: what it gives is
      subtracted from the torque first), facets may have more than two free wheels (coplanar or parallel axes);
    - wheels that span fewer than three axes (`rank`) get the part of the torque that lies in their span.

    With limits that do not differ by sign the commands are those of the least max |u_k| / limit_k, which is 1/reach: the
    weighted L-infinity allocation (its envelope: Markley, Reynolds, Liu & Lebsock 2010).
    Nothing in it changes once it is made.
    """

    __slots__ = ("_columns", "_facets", "_plain", "_planes", "_size", "_stuck", "_unreachable", "offset_b_nm", "rank")

    def __init__(
        self, axes_b: Sequence[Vec3], shares: Sequence[float], low_nm: Sequence[float], high_nm: Sequence[float]
    ) -> None:
        """axes_b          : unit vectors, body axes; zero for a wheel that is not there
        shares          : share of its command that each wheel gives; 0: dead
        low_nm, high_nm : limits of each command [N m], with 0 between them unless they are one

        Raises ConfigError where these are not as said.
        """
        self._size = len(axes_b)
        self._stuck: list[tuple[int, float]] = []
        self._columns: list[Column] = []
        offset = ZERO3
        for index, (axis, share, low, high) in enumerate(zip(axes_b, shares, low_nm, high_nm, strict=True)):
            _check(index, axis, share, low, high)
            if share == 0.0 or axis == ZERO3:
                continue
            if low == high:
                self._stuck.append((index, low))
                torque, (x, y, z) = share * low, axis
                offset = (offset[0] + torque * x, offset[1] + torque * y, offset[2] + torque * z)
            else:
                self._columns.append(Column(index, axis, share, low, high))
        self.offset_b_nm = offset  # torque of the stuck wheels on the body
        self._unreachable = _find_unreachable(self._columns)
        self.rank = 3 - len(self._unreachable)  # how many independent directions of torque there are
        self._plain = not self._unreachable and not self._stuck
        self._facets: list[Facet] = []
        self._planes: list[Plane] = []
        if self.rank > 0:
            self._build()

    def list_facets(self) -> list[tuple[Vec3, float]]:
        """Return outward unit normal and distance from no torque [N m] of each facet (rank 2: edge, rank 1: end)."""
        return [(facet.normal_b, facet.support_nm) for facet in self._facets]

    def count_facets(self) -> int:
        """Return how many facets there are."""
        return len(self._facets)

    def find_reach(self, tau_b_nm: Vec3) -> float:
        """Return the largest factor [1] with which a torque, less that of stuck wheels, can be had; infinite for none.

        With rank < 3 that of its part in the wheels' span.
        """
        x, y, z = tau_b_nm if self._plain else self._bring_within(tau_b_nm)
        return self._find_hit(x, y, z)[0]

    def allocate(self, tau_b_nm: Vec3) -> tuple[float, ...]:
        """Return the command of each wheel [N m], within its limits; see `solve`."""
        return self.solve(tau_b_nm)[1]

    def solve(self, tau_b_nm: Vec3) -> tuple[float, tuple[float, ...]]:
        """Return the reach of a torque [1] (see `find_reach`), and the command of each wheel [N m].

        Reach >= 1: the torque is exact. Below: its direction is, and its length is all that can be had.
        """
        x, y, z = tau_b_nm if self._plain else self._bring_within(tau_b_nm)
        reach, hit = self._find_hit(x, y, z)
        if not reach < MOST_REACH:
            return reach, self._finish([0.0] * self._size)
        return reach, self._finish(_go_back(self._facets[hit].solve(reach * x, reach * y, reach * z), reach))

    def allocate_sorted(self, tau_b_nm: Vec3) -> tuple[tuple[float, ...], int]:
        """Return the commands [N m] by the search of the patent, and how many facets it had to try.

        Facets are tried by the angle between normal and torque, the least first, until one contains the ray.
        """
        x, y, z = self._bring_within(tau_b_nm)
        least = LEVEL * (abs(x) + abs(y) + abs(z))
        ahead: list[tuple[float, int]] = []
        for index, facet in enumerate(self._facets):
            along = dot(facet.normal_b, (x, y, z))
            if along > least and facet.support_nm < MOST_REACH * along:
                ahead.append((-along, index))  # normals are unit vectors: the order of the cosines
        tried = 0
        for negative, index in sorted(ahead):
            tried += 1
            facet = self._facets[index]
            reach = facet.support_nm / -negative
            if facet.contains((reach * x, reach * y, reach * z), SLACK):
                return self._finish(_go_back(facet.solve(reach * x, reach * y, reach * z), reach)), tried
        return self._finish([0.0] * self._size), tried

    def _find_hit(self, x: float, y: float, z: float) -> tuple[float, int]:
        """The reach of a torque and the facet that its ray meets; infinite and -1 for no torque."""
        least = LEVEL * (abs(x) + abs(y) + abs(z))
        reach, hit = math.inf, -1
        for nx, ny, nz, ahead, behind, index in self._planes:
            along = nx * x + ny * y + nz * z
            if along > least:
                ratio = ahead / along
                if ratio < reach:
                    reach, hit = ratio, index
            elif along < -least:
                ratio = behind / -along
                if ratio < reach:
                    reach, hit = ratio, index + 1
        return reach, hit

    def _bring_within(self, tau_b_nm: Vec3) -> Vec3:
        """What is left for the wheels that can be told something, in their span."""
        ox, oy, oz = self.offset_b_nm
        x, y, z = tau_b_nm[0] - ox, tau_b_nm[1] - oy, tau_b_nm[2] - oz
        for ax, ay, az in self._unreachable:
            along = ax * x + ay * y + az * z
            x, y, z = x - along * ax, y - along * ay, z - along * az
        return (x, y, z)

    def _finish(self, commands: list[float]) -> tuple[float, ...]:
        if self._plain:
            return tuple(commands)
        for index, command in self._stuck:
            commands[index] = command
        return tuple(commands[: self._size])

    def _build(self) -> None:
        """Find the facets: one pair for each plane between two axes.

        Where wheels do not span three axes, a wheel is thought up for each direction out of reach. It is never asked for
        anything, as no torque is left along it, and facets that only such a wheel bounds are left out.
        """
        columns = list(self._columns)
        for axis in self._unreachable:
            columns.append(Column(self._size + len(columns) - len(self._columns), axis, 1.0, -1.0, 1.0))
        size = self._size + len(self._unreachable)
        normals: list[Vec3] = []
        for i, one in enumerate(columns):
            for other in columns[i + 1 :]:
                normal = find_normal(one.axis_b, other.axis_b)
                if normal is None or _has(normals, normal):
                    continue
                normals.append(normal)
                if all(abs(dot(normal, column.axis_b)) <= FLAT for column in self._columns):
                    continue
                x, y, z = normal
                ahead, behind = Facet(normal, columns, size), Facet((-x, -y, -z), columns, size)
                self._planes.append((x, y, z, ahead.support_nm, behind.support_nm, len(self._facets)))
                self._facets += [ahead, behind]


def _go_back(commands: list[float], reach: float) -> list[float]:
    """The commands scaled from the facet back to the torque, where that lies within."""
    if reach <= 1.0:
        return commands
    back = 1.0 / reach
    return [command * back for command in commands]


def _has(normals: list[Vec3], normal: Vec3) -> bool:
    """Whether a normal is there already, either way round.

    By the distance of the two: their product is 1 to rounding at angles that are still far apart.
    """
    x, y, z = normal
    for a, b, c in normals:
        if abs(a - x) <= FLAT and abs(b - y) <= FLAT and abs(c - z) <= FLAT:
            return True
        if abs(a + x) <= FLAT and abs(b + y) <= FLAT and abs(c + z) <= FLAT:
            return True
    return False


def _find_unreachable(columns: Sequence[Column]) -> list[Vec3]:
    """Unit vectors, at right angles, along which the wheels give no torque: none of them where they span three axes."""
    if not columns:
        return [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    best, found, first = 0.0, ZERO3, columns[0].axis_b
    for i, one in enumerate(columns):
        for other in columns[i + 1 :]:
            normal = find_normal(one.axis_b, other.axis_b)
            if normal is not None:
                product = cross(one.axis_b, other.axis_b)
                if dot(product, product) > best:
                    best, found = dot(product, product), normal
    if found != ZERO3:
        return [] if any(abs(dot(found, column.axis_b)) > FLAT for column in columns) else [found]
    x, y, z = first  # all along one line: square to it, from the body axis that is furthest from it
    away = (
        (1.0, 0.0, 0.0) if abs(x) <= min(abs(y), abs(z)) else (0.0, 1.0, 0.0) if abs(y) <= abs(z) else (0.0, 0.0, 1.0)
    )
    side = find_normal(first, away) or ZERO3
    return [side, cross(first, side)]


def _check(index: int, axis_b: Vec3, share: float, low_nm: float, high_nm: float) -> None:
    """Raises ConfigError where a wheel is not one that can be reckoned with."""
    if axis_b != ZERO3 and not abs(dot(axis_b, axis_b) - 1.0) < 1e-9:
        raise ConfigError(
            f"attainable set: the axis of wheel {index} is {axis_b}, of length {math.sqrt(dot(axis_b, axis_b)):g}; "
            "give a unit vector, or zeros for a wheel that is not there"
        )
    if not 0.0 <= share < math.inf:
        raise ConfigError(f"attainable set: the share of wheel {index} is {share:g}; it must be 0 (dead) or above")
    if not (-math.inf < low_nm <= 0.0 <= high_nm < math.inf or -math.inf < low_nm == high_nm < math.inf):
        raise ConfigError(
            f"attainable set: the limits of wheel {index} are {low_nm:g} and {high_nm:g} N m; 0 must lie between them, or "
            "both be the command at which the wheel is stuck"
        )
