"""Spin axes of the four wheels in body axes, nominal and as mounted."""

from __future__ import annotations

import math
from typing import Final, Literal

from bus.units import DEG, Vec3

Mount = Literal["x", "y", "z", "skew"]

SKEW_ELEVATION_RAD: Final = math.asin(1.0 / math.sqrt(3.0))  # with azimuth 45 deg: along (1, 1, 1)
SKEW_AZIMUTH_RAD: Final = math.pi / 4.0


def nominal_axis(mount: Mount) -> Vec3:
    """Return the unit vector of a wheel's nominal spin axis, body axes.

    Zhang, Ye & Sun 2018, eq (5): x, y, z and a skew wheel along (1, 1, 1)/sqrt(3).
    """
    s = 1.0 / math.sqrt(3.0)
    return {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0), "skew": (s, s, s)}[mount]


def true_axis(mount: Mount, tilt_deg: float, clock_deg: float) -> Vec3:
    """Return the unit vector of a wheel's spin axis as mounted, body axes.

    Zhang, Ye & Sun 2018, eqs (3)-(4), exact form: tilt is delta alpha, clock is delta beta. Differs from the paper:
    the y wheel's first component is sin(tilt) cos(clock), as its linearisation (6) has it; (3) prints sin sin.
    The nominal axis is returned untouched for zero angles, free of rounding.
    """
    if tilt_deg == 0.0 and (clock_deg == 0.0 or mount != "skew"):
        return nominal_axis(mount)
    tilt, clock = tilt_deg * DEG, clock_deg * DEG
    along = math.cos(tilt)
    p = math.sin(tilt) * math.cos(clock)
    r = math.sin(tilt) * math.sin(clock)
    if mount == "x":
        return (along, p, r)
    if mount == "y":
        return (p, along, r)
    if mount == "z":
        return (p, r, along)
    elevation, azimuth = SKEW_ELEVATION_RAD + tilt, SKEW_AZIMUTH_RAD + clock
    return (
        math.cos(elevation) * math.cos(azimuth),
        math.cos(elevation) * math.sin(azimuth),
        math.sin(elevation),
    )
