"""Signals of a bench as they stand, by the names that they have in a log."""

from __future__ import annotations

from itertools import islice
from typing import Any

from bus.errors import UsageError
from bus.words import suggest
from fsw.flight import Flight
from fsw.telemetry import (
    CONTROL_TOPICS,
    LINK_HEALTH,
    TICK_TOPICS,
    flatten,
    read_control,
    read_internals,
    read_link_health,
    read_tick,
)
from plant_server.truth import TRUTH_FIELDS, Truth

KNOWN = tuple(topic for topic in TICK_TOPICS if topic.deterministic)  # wall-clock times are nothing that a flight knows


def read_signal(signal: str, truth: Truth, flight: Flight) -> Any:
    """The value of `topic.field`. Raises UsageError where there is none, with the near miss."""
    topic, _, field = signal.rpartition(".")
    values = list_values(topic, truth, flight)
    if not values:
        topics = list_topics(flight)
        raise UsageError(f"there is no topic {topic or signal}; {suggest(topic, topics)}there are: {', '.join(topics)}")
    if field not in values:
        raise UsageError(f"{topic} has no {field}; {suggest(field, values)}there are: {', '.join(values)}")
    return values[field]


def list_topics(flight: Flight) -> list[str]:
    """Names of the topics that can be read, as expectations write them."""
    names = [*(topic.name for topic in (*KNOWN, *CONTROL_TOPICS, LINK_HEALTH)), *read_internals(flight)]
    return [*(f"truth.{group}" for group in TRUTH_FIELDS), *(name.strip("/").replace("/", ".") for name in names)]


def list_values(topic: str, truth: Truth, flight: Flight) -> dict[str, Any]:
    """Fields of a topic and what they are now; empty for a topic that there is not."""
    side, _, name = topic.partition(".")
    if side == "truth" and name in TRUTH_FIELDS:
        return {field[0]: getattr(truth, field[0]) for field in TRUTH_FIELDS[name]}
    path = "/" + topic.replace(".", "/")
    inside = read_internals(flight).get(path)
    if inside is not None:
        return dict(zip(type(inside)._fields, inside, strict=True))  # type: ignore[attr-defined]
    for topics, read in ((KNOWN, read_tick), (CONTROL_TOPICS, read_control), ((LINK_HEALTH,), read_link_health)):
        if any(layout.name == path for layout in topics):
            values = iter(flatten(read(flight)))
            parts = {
                (layout.name, field.name): next(values) if field.count == 1 else tuple(islice(values, field.count))
                for layout in topics
                for field in layout.fields
            }
            return {field: value for (name, field), value in parts.items() if name == path}
    return {}
