"""Signals of a bench as they stand, by the names that they have in a log."""

from __future__ import annotations

from typing import Any

from bus.errors import UsageError
from bus.telemetry.link import Topic
from bus.words import suggest
from fsw.flight import Flight
from fsw.telemetry import ATTITUDE, CONTROL, DETECTION, EXECUTIVE, GUIDANCE, OBSERVER, WHEEL_HEALTH, read_internals
from plant_server.truth import TRUTH_FIELDS, Truth


def read_signal(signal: str, truth: Truth, flight: Flight) -> Any:
    """The value of `topic.field`. Raises UsageError where there is none, with the near miss."""
    topic, _, field = signal.rpartition(".")
    values = list_values(topic, truth, flight)
    if not values:
        topics = list_topics()
        raise UsageError(f"there is no topic {topic or signal}; {suggest(topic, topics)}there are: {', '.join(topics)}")
    if field not in values:
        raise UsageError(f"{topic} has no {field}; {suggest(field, values)}there are: {', '.join(values)}")
    return values[field]


def list_topics() -> list[str]:
    """Names of the topics that can be read, as expectations write them."""
    flying = ("attitude", "fdi", "guidance", "control", "observer", "wheel_health", "executive", "law", "detector")
    more = ("estimator", "observer_state", "wheel_state", "allocator")
    return [*(f"truth.{group}" for group in TRUTH_FIELDS), *(f"fsw.{name}" for name in (*flying, *more))]


def list_values(topic: str, truth: Truth, flight: Flight) -> dict[str, Any]:
    """Fields of a topic and what they are now; empty for a topic that there is not."""
    side, _, name = topic.partition(".")
    if side == "truth" and name in TRUTH_FIELDS:
        return {field[0]: getattr(truth, field[0]) for field in TRUTH_FIELDS[name]}
    inside = read_internals(flight).get("/" + topic.replace(".", "/"))
    if inside is not None:
        return dict(zip(type(inside)._fields, inside, strict=True))  # type: ignore[attr-defined]
    if topic not in _READERS:
        return {}
    layout, read = _READERS[topic]
    return dict(zip((field.name for field in layout.fields), read(flight), strict=True))


def _read_attitude(flight: Flight) -> tuple[Any, ...]:
    estimate, error = flight.detection.estimate, flight.error
    target = flight.guidance.target.q_it
    return (estimate.q_ib, estimate.omega_bi_b_rad_s, estimate.bias_b_rad_s, error.q_tb, flight.error_deg, target)


def _read_detection(flight: Flight) -> tuple[Any, ...]:
    return (flight.detection.fault_hat_b_rad_s, flight.detection.gyro_state, flight.health.alarm)


def _read_guidance(flight: Flight) -> tuple[Any, ...]:
    target = flight.guidance.target
    return (target.omega_ti_t_rad_s, target.alpha_ti_t_rad_s2)


def _read_control(flight: Flight) -> tuple[Any, ...]:
    return (flight.tau_cmd_b_nm, flight.wheel_commands.tau_rw_nm, flight.allocation.margin)


def _read_health(flight: Flight) -> tuple[Any, ...]:
    return (flight.health.effectiveness, flight.health.available, flight.health.explained_b_nm)


def _read_executive(flight: Flight) -> tuple[Any, ...]:
    inputs, counters = flight.inputs.counters, flight.executive
    return (
        flight.inputs.sensors.tick, int(flight.modes.mode), counters.slips, inputs.refused, inputs.foreign,
        inputs.implausible, inputs.unit_fault, counters.skipped, counters.caught_up, flight.diagnostics_slot.shed,
        flight.torques_saturated,
    )  # fmt: skip


_READERS: dict[str, tuple[Topic, Any]] = {
    "fsw.attitude": (ATTITUDE, _read_attitude),
    "fsw.fdi": (DETECTION, _read_detection),
    "fsw.guidance": (GUIDANCE, _read_guidance),
    "fsw.control": (CONTROL, _read_control),
    "fsw.observer": (OBSERVER, lambda flight: (flight.tau_fault_hat_b_nm,)),
    "fsw.wheel_health": (WHEEL_HEALTH, _read_health),
    "fsw.executive": (EXECUTIVE, _read_executive),
}
