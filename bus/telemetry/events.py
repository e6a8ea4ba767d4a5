"""Telemetry that happens now and then, as JSON: events, faults and coordinate frames.

The schemas are flat (no $ref, no anyOf) and no value is NaN, which is what Foxglove takes. `foxglove.Log` and
`foxglove.FrameTransform` are its well-known schemas (foxglove-sdk, schemas/jsonschema).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from bus.errors import UsageError
from bus.units import Vec3, Vec4

LEVELS: Final = {"debug": 1, "info": 2, "warning": 3, "error": 4, "fatal": 5}

_TIME: Final = {
    "type": "object",
    "title": "time",
    "properties": {"sec": {"type": "integer", "minimum": 0}, "nsec": {"type": "integer", "minimum": 0}},
}
_TEXT: Final = {"type": "string"}
_NUMBER: Final = {"type": "number"}


@dataclass(frozen=True, slots=True)
class JsonTopic:
    """A topic of JSON objects. Its channel belongs to the recorder, whoever the records come from."""

    name: str
    channel: int
    schema_name: str
    properties: Mapping[str, Any]

    def json_schema(self) -> str:
        """The schema text that the log file carries."""
        return json.dumps({"type": "object", "title": self.schema_name, "properties": self.properties})


EVENTS: Final = JsonTopic(
    "/events",
    201,
    "foxglove.Log",
    {
        "timestamp": _TIME,
        "level": {"type": "integer"},
        "message": _TEXT,
        "name": _TEXT,
        "file": _TEXT,
        "line": {"type": "integer", "minimum": 0},
    },
)
FAULTS: Final = JsonTopic(
    "/faults",
    202,
    "hilsat.Fault",
    {
        "timestamp": _TIME,
        "id": {
            "type": "string",
            "description": "which fault: its own id, faults[0] the first of the scenario, command[0]",
        },
        "number": {"type": "integer", "description": "in the order of the scenario, then of commands; -1: none"},
        "unit": {"type": "string", "description": "the unit it bites, for example wheel.1"},
        "fault": {"type": "string", "description": "kind of fault"},
        "phase": {
            "type": "string",
            "description": "onset, effect (first changed its unit's output), end, cleared, refused",
        },
        "tick": {"type": "integer", "description": "tick at which that happened"},
        "value": {"type": "number", "description": "first magnitude of the fault, in the unit of its kind"},
        "definition": {"type": "string", "description": "the whole fault as JSON, keys as in a scenario file"},
        "message": _TEXT,
    },
)
TF: Final = JsonTopic(
    "/tf",
    203,
    "foxglove.FrameTransform",
    {
        "timestamp": _TIME,
        "parent_frame_id": _TEXT,
        "child_frame_id": _TEXT,
        "translation": {
            "type": "object",
            "title": "foxglove.Vector3",
            "properties": {"x": _NUMBER, "y": _NUMBER, "z": _NUMBER},
        },
        "rotation": {
            "type": "object",
            "title": "foxglove.Quaternion",
            "properties": {"x": _NUMBER, "y": _NUMBER, "z": _NUMBER, "w": _NUMBER},
        },
    },
)
JSON_TOPICS: Final = {topic.name: topic for topic in (EVENTS, FAULTS, TF)}


def stamp(t_ns: int) -> dict[str, int]:
    sec, nsec = divmod(t_ns, 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


def format_event(t_ns: int, level: int | str, name: str, message: str) -> bytes:
    """One foxglove.Log record as JSON. `level` is a name of LEVELS or its number 1..5."""
    number = LEVELS.get(level, 0) if isinstance(level, str) else level
    if not 1 <= number <= 5:
        raise UsageError(f'event "{message}": level {level!r} is not one of {", ".join(LEVELS)} (1..5)')
    record = {"timestamp": stamp(t_ns), "level": number, "message": message, "name": name, "file": "", "line": 0}
    return json.dumps(record).encode()


def format_fault(
    t_ns: int,
    tick: int,
    unit: str,
    fault: str,
    phase: str,
    value: float = 0.0,
    message: str = "",
    *,
    id: str = "",
    number: int = -1,
    definition: str = "",
) -> bytes:
    """One record of what became of a fault as JSON, keys as FAULTS says; a value that is not finite is left out."""
    record: dict[str, Any] = {"timestamp": stamp(t_ns), "id": id, "number": number, "unit": unit, "fault": fault}
    record |= {"phase": phase, "tick": tick}
    if math.isfinite(value):
        record["value"] = value
    return json.dumps({**record, "definition": definition, "message": message}).encode()


def format_transform(t_ns: int, parent: str, child: str, translation_m: Vec3, q: Vec4) -> bytes:
    """One foxglove.FrameTransform as JSON: pose of `child` in `parent`; q scalar first, v_parent = R(q) v_child."""
    x, y, z = translation_m
    qw, qx, qy, qz = q
    record = {
        "timestamp": stamp(t_ns),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": {"x": x, "y": y, "z": z},
        "rotation": {"x": qx, "y": qy, "z": qz, "w": qw},
    }
    return json.dumps(record, allow_nan=False).encode()
