"""Units as types: what a number means is written once, beside the number, and read by people and by the validator.

`Annotated[float, Unit("N m"), Gt(0)]` says unit and range of a setting. The constraint words come from
annotated-types, so that neither side of the bus needs a validation library to state its limits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Gt, Le, Lt

__all__ = [
    "DEG", "MOST_LISTED", "REACH", "RPM", "Deg", "Ge", "Gt", "Hz", "KgM2", "Le", "Lt", "Mat3", "NewtonMetre",
    "NonNegative", "Positive", "RadS", "Reach", "Seconds", "Unit", "Vec3", "Vec4",
]  # fmt: skip

Vec3 = tuple[float, float, float]
Vec4 = tuple[float, float, float, float]
Mat3 = tuple[Vec3, Vec3, Vec3]

DEG = math.pi / 180.0  # rad per degree
RPM = 2.0 * math.pi / 60.0  # rad/s per revolution per minute


@dataclass(frozen=True, slots=True)
class Unit:
    """The unit of a setting, as printed in messages, schemas and documents."""

    symbol: str


@dataclass(frozen=True, slots=True)
class Reach:
    """Magnitudes that a setting of some unit may have, beside its own limits: what can be computed with.

    least : of a setting that must be above 0
    most  : of any setting
    """

    least: float
    most: float


# Every number of a scenario is held to the reach of its unit; far beyond any satellite, far within what a square or an
# inverse of it overflows at. docs/limits.md has the same table.
REACH: dict[str, Reach] = {
    "s": Reach(1e-9, 1e7),
    "Hz": Reach(1e-6, 1e6),
    "deg": Reach(1e-9, 1e6),
    "arcsec": Reach(1e-9, 1e6),
    "deg/s": Reach(1e-9, 1e6),
    "deg/s^2": Reach(1e-12, 1e6),
    "rad/s": Reach(1e-12, 1e4),
    "rad/s^2": Reach(1e-15, 1e4),
    "N m": Reach(1e-12, 1e4),
    "kg m^2": Reach(1e-9, 1e7),
    "km": Reach(1e-3, 1e9),
    "A": Reach(1e-9, 1e4),
    "V": Reach(1e-6, 1e6),
    "A/V": Reach(1e-6, 1e4),
    "N m/A": Reach(1e-9, 1e4),
    "N m s/rad": Reach(1e-15, 1e4),
    "ohm": Reach(1e-6, 1e6),
    "H": Reach(1e-9, 1e4),
}
ANY_REACH = Reach(1e-18, 1e12)  # of a number without one of these units
WHOLE_REACH = 1_000_000_000  # magnitude of a whole number that has no limit of its own
MOST_LISTED = 1000  # entries of a list of any length

Seconds = Annotated[float, Unit("s")]
Hz = Annotated[float, Unit("Hz"), Gt(0)]
Deg = Annotated[float, Unit("deg")]
RadS = Annotated[float, Unit("rad/s")]
NewtonMetre = Annotated[float, Unit("N m")]
KgM2 = Annotated[float, Unit("kg m^2")]
Positive = Annotated[float, Gt(0)]
NonNegative = Annotated[float, Ge(0)]
