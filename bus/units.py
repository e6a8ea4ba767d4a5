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
    "DEG", "RPM", "Deg", "Ge", "Gt", "Hz", "KgM2", "Le", "Lt", "Mat3", "NewtonMetre", "NonNegative",
    "Positive", "RadS", "Seconds", "Unit", "Vec3", "Vec4",
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


Seconds = Annotated[float, Unit("s")]
Hz = Annotated[float, Unit("Hz"), Gt(0)]
Deg = Annotated[float, Unit("deg")]
RadS = Annotated[float, Unit("rad/s")]
NewtonMetre = Annotated[float, Unit("N m")]
KgM2 = Annotated[float, Unit("kg m^2")]
Positive = Annotated[float, Gt(0)]
NonNegative = Annotated[float, Ge(0)]
