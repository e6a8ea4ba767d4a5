"""The satellite as a scene of Foxglove's: body, wheels about their true spin axes, torque arrows, faults in words.

Every message is whole: it replaces all that its topic showed before, so that a viewer that jumps to any time has all of
it from the last message of each topic. Lengths are for the eye, not those of the satellite, which has none in a scenario.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from bus.telemetry.events import stamp
from bus.units import Vec3, Vec4
from plant_server.wheels.axes import true_axis

INERTIAL, BODY_FRAME, TARGET_FRAME = "inertial", "body", "target"
BODY_SIZE_M: Final = (0.6, 0.6, 0.8)
PANEL_SIZE_M: Final = (0.5, 1.2, 0.02)
WHEEL_AT_M: Final = 0.62  # from the centre of the body, along the spin axis
WHEEL_DIAMETER_M: Final = 0.22
THIN_M, THICK_M = 0.04, 0.20  # a wheel at rest, and at its largest torque
ARROW_M: Final = 0.6  # at the largest torque
STEPS: Final = 100  # of torque that are told apart: a wheel that does not change is not sent again

Colour = tuple[float, float, float, float]
HEALTHY: Final[Colour] = (0.15, 0.45, 0.85, 1.0)
FAULTED: Final[Colour] = (0.85, 0.12, 0.12, 1.0)
TORQUE: Final[Colour] = (0.95, 0.65, 0.10, 1.0)
HULL: Final[Colour] = (0.75, 0.77, 0.80, 0.55)
PANEL: Final[Colour] = (0.10, 0.16, 0.42, 1.0)
BORESIGHT: Final[Colour] = (0.20, 0.65, 0.35, 1.0)
WORDS: Final[Colour] = (0.95, 0.35, 0.30, 1.0)
UPRIGHT: Final[Vec4] = (1.0, 0.0, 0.0, 0.0)
ALONG_Z: Final[Vec4] = (math.sqrt(0.5), 0.0, -math.sqrt(0.5), 0.0)  # turns x, the way of an arrow, to z


class Scene:
    """Makes the messages. `wheels`: of the plant's settings, each with mount, tilt_deg, clock_deg, max_torque_nm."""

    def __init__(self, wheels: Sequence[Any]) -> None:
        self.axes_b: tuple[Vec3, ...] = tuple(true_axis(w.mount, w.tilt_deg, w.clock_deg) for w in wheels)
        self._limits_nm = tuple(max(w.max_torque_nm, 1e-9) for w in wheels)
        self._places = tuple(tuple(WHEEL_AT_M * part for part in axis) for axis in self.axes_b)
        self._discs = tuple(
            _pose(place, turn_to(axis, (0.0, 0.0, 1.0))) for place, axis in zip(self._places, self.axes_b, strict=True)
        )
        self._arrows = tuple(
            {sign: _pose(place, turn_to(tuple(sign * part for part in axis), (1.0, 0.0, 0.0))) for sign in (1.0, -1.0)}
            for place, axis in zip(self._places, self.axes_b, strict=True)
        )

    def format_frames(self, t_ns: int, q_ib: Vec4, q_it: Vec4 | None) -> bytes:
        """foxglove.FrameTransforms: attitude of the body, and of the target where there is one; scalar first."""
        frames = [(BODY_FRAME, q_ib)] + ([] if q_it is None else [(TARGET_FRAME, q_it)])
        head = f'{{"timestamp":{_time(t_ns)},"parent_frame_id":"{INERTIAL}","child_frame_id":"'
        parts = [
            f'{head}{name}","translation":{{"x":0,"y":0,"z":0}},"rotation":{_quaternion(q)}}}' for name, q in frames
        ]
        return f'{{"transforms":[{",".join(parts)}]}}'.encode()

    def format_body(self, t_ns: int) -> bytes:
        """foxglove.SceneUpdate: hull, solar panels, and the z axis, which points."""
        arm = (BODY_SIZE_M[1] + PANEL_SIZE_M[1]) / 2.0 + 0.05
        cubes = [
            _cube((0.0, 0.0, 0.0), BODY_SIZE_M, HULL),
            _cube((0.0, arm, 0.0), PANEL_SIZE_M, PANEL),
            _cube((0.0, -arm, 0.0), PANEL_SIZE_M, PANEL),
        ]
        pointer = _arrow(_pose((0.0, 0.0, BODY_SIZE_M[2] / 2.0), ALONG_Z), 0.35, 0.03, BORESIGHT)
        return _update([_entity(t_ns, "body", arrows=[pointer], cubes=cubes)])

    def grade_torques(self, tau_nm: Sequence[float]) -> tuple[int, ...]:
        """Torque of each wheel in hundredths of its largest, as it is shown."""
        return tuple(
            max(-STEPS, min(STEPS, round(STEPS * tau / limit)))
            for tau, limit in zip(tau_nm, self._limits_nm, strict=True)
        )

    def format_wheels(self, t_ns: int, shares: Sequence[int], faulted: Sequence[bool]) -> bytes:
        """foxglove.SceneUpdate: a disc a wheel, red when a fault acts, thicker by torque, and the torque as an arrow.

        shares : as grade_torques gives them
        """
        time, entities = _time(t_ns), []
        for number, (share, broken) in enumerate(zip(shares, faulted, strict=True)):
            size = abs(share) / STEPS
            disc = (
                f'{{"pose":{self._discs[number]},"size":{{"x":{WHEEL_DIAMETER_M},"y":{WHEEL_DIAMETER_M},'
                f'"z":{THIN_M + (THICK_M - THIN_M) * size:.4f}}},"bottom_scale":1,"top_scale":1,'
                f'"color":{_colour(FAULTED if broken else HEALTHY)}}}'
            )
            pose = self._arrows[number][1.0 if share > 0 else -1.0]
            arrow = _arrow(pose, ARROW_M * size, 0.025, TORQUE) if share else ""
            entities.append(
                f'{{"timestamp":{time},"frame_id":"{BODY_FRAME}","id":"wheel.{number + 1}",'
                f'"lifetime":{{"sec":0,"nsec":0}},"frame_locked":true,"metadata":[],'
                f'"arrows":[{arrow}],"cubes":[],"cylinders":[{disc}],"texts":[]}}'
            )
        return _update(entities)

    def format_faults(self, t_ns: int, acting: Mapping[str, Sequence[str]]) -> bytes:
        """foxglove.SceneUpdate: what is broken, in words; at its wheel, or above the body. `acting`: unit -> kinds."""
        texts, above = [], 0
        for unit, kinds in sorted(acting.items()):
            if not kinds:
                continue
            number = int(unit[6:]) - 1 if unit[:6] == "wheel." and unit[6:].isdigit() else -1
            if 0 <= number < len(self._places):
                x, y, z = (1.35 * part for part in self._places[number])
            else:
                x, y, z = 0.0, 0.0, 0.9 + 0.15 * above
                above += 1
            texts.append(_text((x, y, z), f"{unit}: {', '.join(kinds)}"))
        return _update([_entity(t_ns, "faults", texts=texts)])


def turn_to(axis: Sequence[float], start: Sequence[float]) -> Vec4:
    """The shortest rotation, scalar first, that takes the unit vector `start` to the unit vector `axis`."""
    ax, ay, az = axis
    sx, sy, sz = start
    w = 1.0 + ax * sx + ay * sy + az * sz
    x, y, z = sy * az - sz * ay, sz * ax - sx * az, sx * ay - sy * ax
    if w < 1e-9:  # opposite: half a turn about any axis across
        x, y, z = (0.0, 1.0, 0.0) if abs(sy) < 0.9 else (0.0, 0.0, 1.0)
        w = 0.0
    length = math.sqrt(w * w + x * x + y * y + z * z)
    return w / length, x / length, y / length, z / length


# -- pieces of JSON ------------------------------------------------------------------------------------------------


def _time(t_ns: int) -> str:
    return json.dumps(stamp(t_ns))


def _vector(parts: Sequence[float]) -> str:
    x, y, z = parts
    return f'{{"x":{x:.4f},"y":{y:.4f},"z":{z:.4f}}}'


def _quaternion(q: Sequence[float]) -> str:
    w, x, y, z = q
    return f'{{"x":{x:.6f},"y":{y:.6f},"z":{z:.6f},"w":{w:.6f}}}'


def _colour(colour: Colour) -> str:
    r, g, b, a = colour
    return f'{{"r":{r},"g":{g},"b":{b},"a":{a}}}'


def _pose(position_m: Sequence[float], q: Vec4) -> str:
    return f'{{"position":{_vector(position_m)},"orientation":{_quaternion(q)}}}'


def _cube(position_m: Vec3, size_m: Vec3, colour: Colour) -> str:
    return f'{{"pose":{_pose(position_m, UPRIGHT)},"size":{_vector(size_m)},"color":{_colour(colour)}}}'


def _arrow(pose: str, length_m: float, diameter_m: float, colour: Colour) -> str:
    head = min(0.12, 0.4 * length_m)
    return (
        f'{{"pose":{pose},"shaft_length":{length_m - head:.4f},"shaft_diameter":{diameter_m},"head_length":{head:.4f},'
        f'"head_diameter":{2.2 * diameter_m:.4f},"color":{_colour(colour)}}}'
    )


def _text(position_m: Vec3, words: str) -> str:
    return (
        f'{{"pose":{_pose(position_m, UPRIGHT)},"billboard":true,"font_size":14,"scale_invariant":true,'
        f'"color":{_colour(WORDS)},"text":{json.dumps(words)}}}'
    )


def _entity(t_ns: int, name: str, **parts: Sequence[str]) -> str:
    lists = ",".join(
        f'"{kind}":[{",".join(parts.get(kind, ()))}]' for kind in ("arrows", "cubes", "cylinders", "texts")
    )
    return (
        f'{{"timestamp":{_time(t_ns)},"frame_id":"{BODY_FRAME}","id":"{name}","lifetime":{{"sec":0,"nsec":0}},'
        f'"frame_locked":true,"metadata":[],{lists}}}'
    )


def _update(entities: Sequence[str]) -> bytes:
    return f'{{"deletions":[],"entities":[{",".join(entities)}]}}'.encode()
