"""Publish: the telemetry topics of the flight software, by the rate group whose work they show.

One record a tick: /fsw/attitude, /fsw/fdi, /fsw/timing. One record a control period, on the ticks on which control ran:
/fsw/control, /fsw/observer, /fsw/executive, /fsw/law, /fsw/detector. With control_divider 1 that is the same.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bus.telemetry.link import Field, Topic

FIRST_CHANNEL = 101
SOURCE = 2  # which stream of the recorder this process writes

ATTITUDE = Topic(
    "/fsw/attitude",
    "hilsat/FswAttitude",
    (
        Field("q_ib_hat", "float64", 4, "1", "attitude of body in inertial, scalar first"),
        Field("omega_bi_b_hat_rad_s", "float64", 3, "rad/s", "body rate as the controller uses it"),
        Field("bias_b_hat_rad_s", "float64", 3, "rad/s", "gyro bias estimate"),
        Field("q_err", "float64", 4, "1", "body with respect to target, scalar part not negative up to hysteresis"),
        Field("error_deg", "float64", 1, "deg", "angle of q_err"),
    ),
)
CONTROL = Topic(
    "/fsw/control",
    "hilsat/FswControl",
    (
        Field("tau_cmd_b_nm", "float64", 3, "N m", "body torque commanded, after limiting"),
        Field("tau_rw_cmd_nm", "float64", 4, "N m", "wheel torques commanded, after limiting"),
    ),
)
OBSERVER = Topic(
    "/fsw/observer",
    "hilsat/FswObserver",
    (Field("tau_fault_hat_b_nm", "float64", 3, "N m", "lumped fault torque on the body, body axes"),),
)
DETECTION = Topic(
    "/fsw/fdi",
    "hilsat/FswDetection",
    (
        Field("fault_hat_b_rad_s", "float64", 3, "rad/s", "gyro fault estimate"),
        Field("gyro_state", "float64", 3, "1", "0 nominal, 1 suspect, 2 alarm, 3 classified"),
        Field("wheel_alarm", "float64", 4, "1", "1 while the wheel's torque is not what was commanded"),
    ),
)
EXECUTIVE = Topic(
    "/fsw/executive",
    "hilsat/FswExecutive",
    (
        Field("tick", "float64", 1, "1", "tick of this cycle"),
        Field("mode", "float64", 1, "1", "0 standby, 1 detumble, 2 point, 3 safe"),
        Field("slips", "float64", 1, "1", "deadlines missed so far"),
        Field("refused", "float64", 1, "1", "frames refused so far: length, checksum or alive counter"),
        Field("foreign", "float64", 1, "1", "frames so far that are not for the flight software"),
        Field("implausible", "float64", 1, "1", "well-formed values so far that cannot be"),
    ),
)
TIMING = Topic(
    "/fsw/timing",
    "hilsat/FswTiming",
    (
        Field("cycle_us", "float64", 1, "us", "wall time of the previous cycle"),
        Field("max_cycle_us", "float64", 1, "us", "longest cycle so far"),
        Field("lateness_us", "float64", 1, "us", "release after deadline; 0 in lock-step"),
        Field("dropped_ticks", "float64", 1, "1", "ticks whose telemetry the recorder had no room for"),
    ),
    deterministic=False,
)

TICK_TOPICS = (ATTITUDE, DETECTION, TIMING)


def make_control_topics(law: tuple[Any, ...], detector: tuple[Any, ...]) -> tuple[Topic, ...]:
    """The topics of the control rate group; the last two carry what the chosen law and detector hold inside.

    law, detector : their `internals`, named tuples of numbers and tuples of numbers; only names and shapes count here
    """
    inside = (
        internals_topic("/fsw/law", "hilsat/FswLaw", law),
        internals_topic("/fsw/detector", "hilsat/FswDetector", detector),
    )
    return (CONTROL, OBSERVER, EXECUTIVE, *(topic for topic in inside if topic.fields))


def internals_topic(name: str, schema_name: str, internals: tuple[Any, ...]) -> Topic:
    """A topic with one field for each field of a named tuple."""
    shapes = zip(type(internals)._fields, internals, strict=True)  # type: ignore[attr-defined]
    fields = tuple(Field(key, "float64", len(value) if isinstance(value, tuple) else 1) for key, value in shapes)
    return Topic(name, schema_name, fields)


def make_flattener(internals: tuple[Any, ...]) -> Callable[[tuple[Any, ...]], tuple[float, ...]]:
    """A function that gives the numbers of such a named tuple in order. Shapes are fixed, so no value is looked at."""
    parts = [f"*v[{i}]" if isinstance(value, tuple) else f"v[{i}]" for i, value in enumerate(internals)]
    flatten: Callable[[tuple[Any, ...]], tuple[float, ...]] = eval(f"lambda v: ({', '.join([*parts, ''])})")
    return flatten
