"""The JSON schemas of Foxglove's scenes, flat and without references, and the topics of a scene.

After foxglove-sdk, schemas/jsonschema: FrameTransforms.json and SceneUpdate.json. Kinds of primitives that a scene of ours
has not (lines, triangles, models, spheres) are left out: readers take an absent list for an empty one.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Final

_NUMBER: Final[dict[str, Any]] = {"type": "number"}
_TEXT: Final[dict[str, Any]] = {"type": "string"}
_SWITCH: Final[dict[str, Any]] = {"type": "boolean"}


def _object(title: str, **properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "title": title, "properties": properties}


def _list(item: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": item}


_COUNT: Final = {"type": "integer", "minimum": 0}
TIME: Final = _object("time", sec=_COUNT, nsec=_COUNT)
_DURATION: Final = _object("duration", sec={"type": "integer"}, nsec=_COUNT)
_VECTOR: Final = _object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION: Final = _object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_COLOR: Final = _object("foxglove.Color", r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_POSE: Final = _object("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION)
_ARROW: Final = _object(
    "foxglove.ArrowPrimitive", pose=_POSE, shaft_length=_NUMBER, shaft_diameter=_NUMBER, head_length=_NUMBER,
    head_diameter=_NUMBER, color=_COLOR,
)  # fmt: skip
_CUBE: Final = _object("foxglove.CubePrimitive", pose=_POSE, size=_VECTOR, color=_COLOR)
_CYLINDER: Final = _object(
    "foxglove.CylinderPrimitive", pose=_POSE, size=_VECTOR, bottom_scale=_NUMBER, top_scale=_NUMBER, color=_COLOR
)
_WORDS: Final = _object(
    "foxglove.TextPrimitive", pose=_POSE, billboard=_SWITCH, font_size=_NUMBER, scale_invariant=_SWITCH, color=_COLOR,
    text=_TEXT,
)  # fmt: skip
_ENTITY: Final = _object(
    "foxglove.SceneEntity", timestamp=TIME, frame_id=_TEXT, id=_TEXT, lifetime=_DURATION, frame_locked=_SWITCH,
    metadata=_list(_object("foxglove.KeyValuePair", key=_TEXT, value=_TEXT)), arrows=_list(_ARROW),
    cubes=_list(_CUBE), cylinders=_list(_CYLINDER), texts=_list(_WORDS),
)  # fmt: skip
_DELETION: Final = _object(
    "foxglove.SceneEntityDeletion", timestamp=TIME, type={"type": "integer", "minimum": 0}, id=_TEXT
)
_TRANSFORM: Final = _object(
    "foxglove.FrameTransform", timestamp=TIME, parent_frame_id=_TEXT, child_frame_id=_TEXT, translation=_VECTOR,
    rotation=_QUATERNION,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class SceneTopic:
    """One topic of a scene. `channel`: its number in a log, which nothing else uses."""

    name: str
    channel: int
    schema_name: str
    schema: str  # JSON


_TRANSFORMS: Final = json.dumps(_object("foxglove.FrameTransforms", transforms=_list(_TRANSFORM)))
_UPDATE: Final = json.dumps(_object("foxglove.SceneUpdate", deletions=_list(_DELETION), entities=_list(_ENTITY)))

PREFIX: Final = "/scene/"
FRAMES: Final = SceneTopic("/scene/frames", 241, "foxglove.FrameTransforms", _TRANSFORMS)
BODY: Final = SceneTopic("/scene/body", 242, "foxglove.SceneUpdate", _UPDATE)
WHEELS: Final = SceneTopic("/scene/wheels", 243, "foxglove.SceneUpdate", _UPDATE)
FAULTS: Final = SceneTopic("/scene/faults", 244, "foxglove.SceneUpdate", _UPDATE)
TOPICS: Final = (FRAMES, BODY, WHEELS, FAULTS)
