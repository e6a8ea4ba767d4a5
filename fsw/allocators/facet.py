"""A facet of the attainable set: which wheels are at a limit there, and what the others do at a point of it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from bus.linear import cross, dot
from bus.units import Vec3

FLAT = 1e-9  # sine of the angle below which an axis lies in a plane, and two axes are one
MOST_REACH = 1e300  # beyond it a quotient overflows: so small a torque is none


class Column:
    """One wheel that can give a torque: its axis, the share of a command that it gives, and the limits of the command."""

    __slots__ = ("axis_b", "high_nm", "index", "low_nm", "share")

    def __init__(self, index: int, axis_b: Vec3, share: float, low_nm: float, high_nm: float) -> None:
        self.index = index  # of its command
        self.axis_b = axis_b  # unit vector
        self.share = share  # above 0
        self.low_nm = low_nm
        self.high_nm = high_nm

    def find_end(self, along: float) -> float:
        """Return the command that gives most in a direction along which the axis has this component [N m]."""
        return self.high_nm if along > 0.0 else self.low_nm


def find_normal(one_b: Vec3, other_b: Vec3) -> Vec3 | None:
    """Return the unit normal of two unit vectors; None where they are parallel.

    Two that are nearly parallel are taken apart first: their difference is exact, the plain product would lose as many
    digits as they have in common.
    """
    sign = 1.0 if dot(one_b, other_b) > 0.0 else -1.0
    apart = (other_b[0] - sign * one_b[0], other_b[1] - sign * one_b[1], other_b[2] - sign * one_b[2])
    x, y, z = cross(one_b, apart)
    length = math.sqrt(x * x + y * y + z * z)
    if length <= FLAT:
        return None
    return (x / length, y / length, z / length)


class Facet:
    """The points of the attainable set that lie furthest along one normal.

    The wheels whose axis has a part along the normal are at the limit that its sign says; the others are free, and
    their axes span the facet.
    """

    __slots__ = (
        "_axis", "_commands", "_cosine", "_dual", "_fixed", "_one", "_other", "_patch", "free", "normal_b", "support_nm",
    )  # fmt: skip

    def __init__(self, normal_b: Vec3, columns: Sequence[Column], size: int) -> None:
        """size : number of commands, of wheels that give no torque as well."""
        self.normal_b = normal_b
        free: list[Column] = []
        commands = [0.0] * size
        x = y = z = 0.0
        for column in columns:
            along = dot(normal_b, column.axis_b)
            if abs(along) <= FLAT:
                free.append(column)
                continue
            end = column.find_end(along)
            commands[column.index] = end
            torque = column.share * end
            x, y, z = x + torque * column.axis_b[0], y + torque * column.axis_b[1], z + torque * column.axis_b[2]
        self.free = tuple([column.index for column in free])
        self._fixed: Vec3 = (x, y, z)
        self._commands = commands
        self.support_nm = dot(normal_b, self._fixed)  # distance of the facet from no torque
        self._one, self._other = free[0], free[1]
        self._axis: Vec3 = free[0].axis_b
        self._cosine = dot(free[0].axis_b, free[1].axis_b)
        across = cross(normal_b, free[0].axis_b)
        sine = dot(across, free[1].axis_b)
        self._dual: Vec3 = (across[0] / sine, across[1] / sine, across[2] / sine) if len(free) == 2 else across
        self._patch = Zonogon(normal_b, free) if len(free) > 2 else None

    def solve(self, x: float, y: float, z: float) -> list[float]:
        """Return the commands that give a torque on the facet, each within its limits [N m].

        Two free wheels give what the others leave by the pseudo-inverse of their axes; more of them by `Zonogon`.
        """
        one, other = self._one, self._other
        commands = self._commands.copy()
        (fx, fy, fz), (ax, ay, az), (wx, wy, wz) = self._fixed, self._axis, self._dual
        x, y, z = x - fx, y - fy, z - fz
        patch = self._patch
        if patch is not None:
            _, values = patch.solve((x, y, z))
            for index, value in zip(self.free, values, strict=True):
                commands[index] = value
            return commands
        torque = wx * x + wy * y + wz * z
        # The first from what the second leaves, so that the sum is right however small the angle between the two
        value = (ax * x + ay * y + az * z - self._cosine * torque) / one.share
        commands[one.index] = one.low_nm if value < one.low_nm else one.high_nm if value > one.high_nm else value
        value = torque / other.share
        commands[other.index] = (
            other.low_nm if value < other.low_nm else other.high_nm if value > other.high_nm else value
        )
        return commands

    def contains(self, point_b_nm: Vec3, slack: float) -> bool:
        """Whether a point of the facet's plane lies on the facet.

        slack : by how much of its range a free wheel may pass a limit
        """
        fx, fy, fz = self._fixed
        rest = (point_b_nm[0] - fx, point_b_nm[1] - fy, point_b_nm[2] - fz)
        if self._patch is not None:
            return self._patch.solve(rest)[0] >= 1.0 - slack
        torque = dot(self._dual, rest)
        first = (dot(self._axis, rest) - self._cosine * torque) / self._one.share
        return _is_within(first, self._one, slack) and _is_within(torque / self._other.share, self._other, slack)


def _is_within(command_nm: float, column: Column, slack: float) -> bool:
    room = slack * (column.high_nm - column.low_nm)
    return column.low_nm - room <= command_nm <= column.high_nm + room


class Edge:
    """One direction of a facet: which wheels lie along it, and where the others are at its two edges."""

    __slots__ = ("ends", "line_nm", "normal_b", "offset_b_nm", "parallel", "support_nm", "way_b")

    def __init__(self, normal_b: Vec3, way_b: Vec3, columns: Sequence[Column]) -> None:
        self.normal_b = normal_b  # of the edge, in the facet's plane
        self.way_b = way_b  # along the edge
        ends: list[float] = []
        parallel: list[float] = []
        line = 0.0
        x = y = z = 0.0
        for column in columns:
            half = 0.5 * (column.high_nm - column.low_nm)
            along = dot(normal_b, column.axis_b)
            if abs(along) <= FLAT:
                ends.append(0.0)
                parallel.append(half if dot(way_b, column.axis_b) > 0.0 else -half)
                line += column.share * half
                continue
            end = half if along > 0.0 else -half
            ends.append(end)
            parallel.append(0.0)
            torque, (ax, ay, az) = column.share * end, column.axis_b
            x, y, z = x + torque * ax, y + torque * ay, z + torque * az
        self.ends = ends  # of the command of each wheel, from its middle
        self.parallel = parallel  # half range of each wheel that lies along the edge, signed; zero for the others
        self.line_nm = line  # half the length of the edge
        self.offset_b_nm: Vec3 = (x, y, z)  # middle of the edge from the middle of the facet
        self.support_nm = dot(normal_b, self.offset_b_nm)


class Zonogon:
    """A facet with more than two free wheels: their axes lie in one plane, and a torque can be shared in many ways.

    Taken is the one on the ray from the middle of the facet: on the edge that the ray hits all wheels are at a limit but
    those along the edge, which take the rest alike; at the point itself each is as far from its middle as the point is on
    the ray. The commands change steadily with the torque.
    """

    __slots__ = ("_edges", "_middle_b_nm", "_middles")

    def __init__(self, normal_b: Vec3, columns: Sequence[Column]) -> None:
        self._middles = [0.5 * (column.low_nm + column.high_nm) for column in columns]
        x = y = z = 0.0
        for column, middle in zip(columns, self._middles, strict=True):
            torque, (ax, ay, az) = column.share * middle, column.axis_b
            x, y, z = x + torque * ax, y + torque * ay, z + torque * az
        self._middle_b_nm: Vec3 = (x, y, z)
        self._edges: list[Edge] = []
        for column in columns:
            way = column.axis_b
            if all(abs(dot(edge.normal_b, way)) > FLAT for edge in self._edges):
                self._edges.append(Edge(cross(normal_b, way), way, columns))

    def solve(self, torque_b_nm: Vec3) -> tuple[float, list[float]]:
        """Return how often the ray from the middle to a torque fits in [1], and the commands of the wheels [N m]."""
        mx, my, mz = self._middle_b_nm
        x, y, z = torque_b_nm[0] - mx, torque_b_nm[1] - my, torque_b_nm[2] - mz
        hit, sign, reach = self._edges[0], 1.0, math.inf
        for edge in self._edges:
            along = dot(edge.normal_b, (x, y, z))
            if abs(along) * min(reach, MOST_REACH) > edge.support_nm:
                hit, sign, reach = edge, (1.0 if along > 0.0 else -1.0), edge.support_nm / abs(along)
        if reach == math.inf:
            return reach, self._middles.copy()
        ox, oy, oz = hit.offset_b_nm
        rest = (reach * x - sign * ox, reach * y - sign * oy, reach * z - sign * oz)
        line = dot(hit.way_b, rest) / hit.line_nm
        line = -1.0 if line < -1.0 else 1.0 if line > 1.0 else line
        back = 1.0 / reach if reach > 1.0 else 1.0
        return reach, [
            middle + back * (sign * end + line * part)
            for middle, end, part in zip(self._middles, hit.ends, hit.parallel, strict=True)
        ]
