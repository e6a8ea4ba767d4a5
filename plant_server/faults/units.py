"""The units that a fault can be on, and the families that they belong to."""

from __future__ import annotations

WHEELS = ("wheel.1", "wheel.2", "wheel.3", "wheel.4")
GYRO = "gyro"  # all three axes at once
GYRO_AXES = ("gyro.x", "gyro.y", "gyro.z")
STAR_TRACKER = "star_tracker"
BUS = "bus"
SIMPLE_UNITS = (*WHEELS, *GYRO_AXES, STAR_TRACKER, BUS)  # each has a chain of faults of its own
UNITS = (*WHEELS, GYRO, *GYRO_AXES, STAR_TRACKER, BUS)
FAMILIES = ("wheel", "gyro", "star_tracker", "bus")


def family_of(unit: str) -> str:
    """Return the family of a known unit: wheel, gyro, star_tracker or bus."""
    return unit.partition(".")[0]


def parts_of(unit: str) -> tuple[str, ...]:
    """Return the simple units that a known unit stands for."""
    return GYRO_AXES if unit == GYRO else (unit,)
