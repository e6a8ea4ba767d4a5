"""Telemetry topics of the plant: the truth, which only the log and the grader ever see."""

from __future__ import annotations

from bus.telemetry.link import Field, TickPacker, Topic
from plant_server.plant import TRUTH_FIELDS

FRAMES_CHANNEL = 1
FIRST_CHANNEL = 2
SOURCE = 1  # which stream of the recorder this process writes


def make_topics() -> tuple[Topic, ...]:
    """One topic for each group of truth fields: /truth/attitude, /truth/wheels, ..."""
    return tuple(
        Topic(
            f"/truth/{group}",
            f"hilsat/Truth{group.title().replace('_', '')}",
            tuple(Field(name, "float64", count, unit, doc) for name, count, unit, doc in fields),
        )
        for group, fields in TRUTH_FIELDS.items()
    )


def make_packer() -> TickPacker:
    """Packs one tick of truth with a single call; values in the order of `Plant.expand()`."""
    return TickPacker(make_topics(), FIRST_CHANNEL)
