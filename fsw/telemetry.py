"""Publish: the telemetry topics of the flight software, by the rate group whose work they show.

One record a cycle: /fsw/attitude, /fsw/fdi, /fsw/timing, and /fsw/input with what the cycle was given. One record a control
period, on the ticks on which control ran: /fsw/guidance, /fsw/control, /fsw/observer, /fsw/wheel_health, /fsw/executive.
With them, unless the executive sheds them, what the chosen algorithms hold inside: /fsw/law, /fsw/detector, ..., with
/fsw/null_space where the wheels do anything among themselves, and /fsw/wheel_power where a wheel has a motor of its own.

A topic stands here twice: its layout, and its line in `read_tick` or `read_control`, in the same order. The log and a
bench in Python both have their values from there.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

from bus.telemetry.link import Field, Topic
from fsw.families import NO_INTERNALS
from fsw.flight import Flight

FIRST_CHANNEL: Final = 101
INPUT_CHANNEL: Final = 100
INPUT_TOPIC: Final = "/fsw/input"
SOURCE: Final = 2  # which stream of the recorder this process writes

GUIDANCE = Topic(
    "/fsw/guidance",
    "hilsat/FswGuidance",
    (
        Field("omega_ti_t_rad_s", "float64", 3, "rad/s", "rate of the target, target axes"),
        Field("alpha_ti_t_rad_s2", "float64", 3, "rad/s^2", "its rate of change, target axes"),
    ),
    every="control",
)
ATTITUDE = Topic(
    "/fsw/attitude",
    "hilsat/FswAttitude",
    (
        Field("q_ib_hat", "float64", 4, "1", "attitude of body in inertial, scalar first"),
        Field("omega_bi_b_hat_rad_s", "float64", 3, "rad/s", "body rate as the controller uses it"),
        Field("bias_b_hat_rad_s", "float64", 3, "rad/s", "gyro bias estimate"),
        Field(
            "q_err",
            "float64",
            4,
            "1",
            "body in target when control last ran, scalar part not negative up to hysteresis",
        ),
        Field("error_deg", "float64", 1, "deg", "angle of q_err"),
        Field("q_it", "float64", 4, "1", "attitude of the target in inertial, scalar first"),
    ),
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
TIMING = Topic(
    "/fsw/timing",
    "hilsat/FswTiming",
    (
        Field("cycle_us", "float64", 1, "us", "wall time of this cycle, from its frames in hand to its commands ready"),
        Field("max_cycle_us", "float64", 1, "us", "longest cycle so far"),
        Field("lateness_us", "float64", 1, "us", "release after deadline; 0 in lock-step"),
        Field("dropped_ticks", "float64", 1, "1", "ticks whose telemetry the recorder had no room for"),
    ),
    deterministic=False,
)
CONTROL = Topic(
    "/fsw/control",
    "hilsat/FswControl",
    (
        Field("tau_cmd_b_nm", "float64", 3, "N m", "body torque commanded, as sent"),
        Field("tau_rw_cmd_nm", "float64", 4, "N m", "wheel torques commanded, as sent"),
        Field("margin", "float64", 1, "1", "share of the most loaded wheel's torque that was still free"),
    ),
    every="control",
)
OBSERVER = Topic(
    "/fsw/observer",
    "hilsat/FswObserver",
    (Field("tau_fault_hat_b_nm", "float64", 3, "N m", "lumped fault torque on the body, body axes"),),
    every="control",
)
WHEEL_HEALTH = Topic(
    "/fsw/wheel_health",
    "hilsat/FswWheelHealth",
    (
        Field("effectiveness", "float64", 4, "1", "share of its commanded torque that each wheel is thought to give"),
        Field("available", "float64", 4, "1", "0: switched off and not used"),
        Field("explained_b_nm", "float64", 3, "N m", "the part of the fault torque that these shares account for"),
        Field("driver_gain", "float64", 4, "1", "current of each wheel against that of a sound driver"),
        Field("torque_gain", "float64", 4, "1", "torque of each wheel against that of a sound motor at its current"),
        Field("friction_nm", "float64", 4, "N m", "friction of each wheel beyond the nominal"),
        Field("deficit_nm", "float64", 4, "N m", "torque that each rotor lacks, whatever took it"),
        Field(
            "kind",
            "float64",
            4,
            "1",
            "0 nominal, 1 deficit of unknown cause, 2 driver gain, 3 torque gain, 4 friction, 5 bias, 6 seized, "
            "7 runaway, 8 no torque, 9 no telemetry",
        ),
        Field("confidence", "float64", 4, "1", "that it is this kind"),
        Field("dither", "float64", 1, "1", "0 off, 1 on, 2 asked for but the wheels in use leave no null space"),
    ),
    every="control",
)
EXECUTIVE = Topic(
    "/fsw/executive",
    "hilsat/FswExecutive",
    (
        Field("tick", "float64", 1, "1", "tick of this cycle"),
        Field("mode", "float64", 1, "1", "0 standby, 1 detumble, 2 point, 3 safe, 4 degraded"),
        Field("slips", "float64", 1, "1", "deadlines missed so far"),
        Field("refused", "float64", 1, "1", "frames refused so far: length, checksum or alive counter"),
        Field("foreign", "float64", 1, "1", "frames so far that are not for the flight software"),
        Field("implausible", "float64", 1, "1", "well-formed values so far that cannot be"),
        Field("unit_fault", "float64", 1, "1", "frames so far in which a unit says that its value is not good"),
        Field("skipped", "float64", 1, "1", "ticks so far that were not run at all"),
        Field("caught_up", "float64", 1, "1", "ticks so far that were run late, back to back"),
        Field("shed", "float64", 1, "1", "times so far that a group which is not essential was left out"),
        Field("torques_saturated", "float64", 1, "1", "wheel torques so far that no frame could carry"),
        Field("rivals", "float64", 1, "1", "frames so far that show a second sender of an id"),
    ),
    every="control",
)

LINK_HEALTH = Topic(
    "/fsw/link_health",
    "hilsat/FswLinkHealth",
    (
        Field(
            "silent",
            "float64",
            8,
            "1",
            "1 while wheel.1 .. wheel.4, gyro.x .. gyro.z, star_tracker send nothing usable",
        ),
        Field("babbling", "float64", 1, "1", "ids that come far too often now"),
        Field("babbler", "float64", 1, "1", "id that was last named for that; -1: ids that nobody listens to"),
        Field("flooded", "float64", 1, "1", "frames so far that were left in a batch, so that the cycle stays short"),
        Field("error_frames", "float64", 1, "1", "error frames of the CAN controller so far"),
        Field(
            "controller",
            "float64",
            1,
            "1",
            "as it last reported: 0 error active, 1 warning, 2 error passive, 3 bus-off",
        ),
    ),
    every="irregular",
)

TICK_TOPICS = (ATTITUDE, DETECTION, TIMING)
CONTROL_TOPICS = (
    GUIDANCE,
    CONTROL,
    OBSERVER,
    WHEEL_HEALTH,
    EXECUTIVE,
)


def read_tick(flight: Flight) -> tuple[Any, ...]:
    """What a flight knows at the end of a cycle, number by number, in the order of TICK_TOPICS without TIMING."""
    detection = flight.detection
    estimate = detection.estimate
    q0, q1, q2, q3 = estimate.q_ib
    wx, wy, wz = estimate.omega_bi_b_rad_s
    bx, by, bz = estimate.bias_b_rad_s
    e0, e1, e2, e3 = flight.error.q_tb
    t0, t1, t2, t3 = flight.guidance.target.q_it
    fx, fy, fz = detection.fault_hat_b_rad_s
    sx, sy, sz = detection.gyro_state
    a1, a2, a3, a4 = flight.health.alarm
    return (
        q0, q1, q2, q3, wx, wy, wz, bx, by, bz, e0, e1, e2, e3, flight.error_deg, t0, t1, t2, t3,
        fx, fy, fz, sx, sy, sz, a1, a2, a3, a4,
    )  # fmt: skip


def read_control(flight: Flight) -> tuple[Any, ...]:
    """What the control group and the executive have to show: a value a field, in the order of CONTROL_TOPICS.

    Tuples and numbers: they are kept until the log is written, so that no record that a later cycle changes may be in it.
    """
    counters, inputs, health = flight.executive, flight.inputs.counters, flight.health
    target, sensors = flight.guidance.target, flight.inputs.sensors
    return (
        target.omega_ti_t_rad_s, target.alpha_ti_t_rad_s2,
        flight.tau_cmd_b_nm, flight.wheel_commands.tau_rw_nm, flight.allocation.margin,
        flight.tau_fault_hat_b_nm,
        health.effectiveness, health.available, health.explained_b_nm, health.driver_gain, health.torque_gain,
        health.friction_nm, health.deficit_nm, health.kind, health.confidence, health.dither,
        sensors.tick, flight.modes.mode, counters.slips, inputs.refused, inputs.foreign, inputs.implausible,
        inputs.unit_fault, counters.skipped, counters.caught_up, flight.diagnostics_slot.shed, flight.torques_saturated,
        flight.inputs.count_rivals(),
    )  # fmt: skip


def read_link_health(flight: Flight) -> tuple[Any, ...]:
    """What is wrong with the links: a value a field, in the order of LINK_HEALTH."""
    watch = flight.inputs.watch
    return (
        tuple(watch.silent), watch.babbling, watch.last_babbler, watch.flooded, watch.error_frames, watch.controller,
    )  # fmt: skip


def read_internals(flight: Flight) -> dict[str, tuple[Any, ...]]:
    """What the algorithms of a flight hold inside, and what wheels with a motor report of themselves; named tuples by the
    name of the topic that carries each.
    """
    return {
        "/fsw/law": flight.controller.internals,
        "/fsw/detector": flight.detector.internals,
        "/fsw/estimator": flight.estimator.internals,
        "/fsw/observer_state": flight.observer.internals,
        "/fsw/wheel_state": flight.wheel_health.internals,
        "/fsw/allocator": flight.allocator.internals,
        "/fsw/null_space": flight.null_space.internals if flight.null_space.on else NO_INTERNALS,
        "/fsw/wheel_power": flight.wheel_power,
    }


def make_diagnostics(flight: Flight) -> tuple[Topic, ...]:
    """The topics of the diagnostics group: those of the chosen algorithms that have anything inside."""
    topics = (internals_topic(name, internals) for name, internals in read_internals(flight).items())
    return tuple(topic for topic in topics if topic.fields)


def internals_topic(name: str, internals: tuple[Any, ...]) -> Topic:
    """A topic with one field for each field of a named tuple of numbers and tuples of numbers."""
    shapes = zip(type(internals)._fields, internals, strict=True)  # type: ignore[attr-defined]
    fields = tuple(Field(key, "float64", len(value) if isinstance(value, tuple) else 1) for key, value in shapes)
    words = name.strip("/").replace("_", "/").split("/")
    return Topic(name, "hilsat/" + "".join(word.capitalize() for word in words), fields, every="diagnostic")


def flatten(values: Iterable[Any]) -> list[float]:
    """The numbers of values that are numbers and tuples of numbers, in order."""
    flat: list[float] = []
    for value in values:
        if isinstance(value, tuple):
            flat += value
        else:
            flat.append(value)
    return flat
