"""What is so, as opposed to what is measured: a record of it, and the topics in which only log and grader ever see it."""

from __future__ import annotations

from typing import Final, NamedTuple

from bus.telemetry.link import Field, TickPacker, Topic
from bus.units import Vec3, Vec4

FRAMES_CHANNEL: Final = 1
FIRST_CHANNEL: Final = 2
SOURCE: Final = 1  # which stream of the recorder this process writes

INTERVAL: Final = "mean over the tick that ended now"
NO_TARGET = (
    "angle between the attitude and the target of that tick, filled in from the flight software's log; NaN: none known"
)

# group -> (name, count, unit, meaning), in the order of the numbers of `Plant.flatten`
TRUTH_FIELDS: dict[str, tuple[tuple[str, int, str, str], ...]] = {
    "attitude": (
        ("q_ib", 4, "", "attitude, scalar first, v_i = R(q_ib) v_b"),
        ("omega_bi_b_rad_s", 3, "rad/s", "rate of the body with respect to inertial, body axes"),
        ("error_deg", 1, "deg", NO_TARGET),
        ("h_total_i_nms", 3, "N m s", "total angular momentum, body and wheels, inertial axes"),
    ),
    "wheels": (
        ("speed_rad_s", 4, "rad/s", "rotor speeds relative to the body"),
        ("tau_rw_true_nm", 4, "N m", f"torque of each wheel on the body about its true axis, {INTERVAL}"),
        ("tau_rw_cmd_nm", 4, "N m", "torque command that was in effect over the tick that ended now"),
        ("h_rw_b_nms", 3, "N m s", "spin momentum of the rotors, absolute, body axes"),
        ("tau_fault_b_nm", 3, "N m", f"D tau_rw_true - D0 tau_rw_cmd, body axes, {INTERVAL}"),
        ("tau_ext_b_nm", 3, "N m", f"external torque, body axes, {INTERVAL}"),
    ),
    "gyro": (
        ("bias_b_rad_s", 3, "rad/s", "turn-on bias, bias instability and rate random walk in the present sample"),
        ("fault_b_rad_s", 3, "rad/s", "what the faults add to the present sample; 0 while an axis is silent"),
    ),
}


class Truth(NamedTuple):
    """What is so at a tick; names, units and axes as in TRUTH_FIELDS."""

    q_ib: Vec4
    omega_bi_b_rad_s: Vec3
    error_deg: float
    h_total_i_nms: Vec3
    speed_rad_s: Vec4
    tau_rw_true_nm: Vec4
    tau_rw_cmd_nm: Vec4
    h_rw_b_nms: Vec3
    tau_fault_b_nm: Vec3
    tau_ext_b_nm: Vec3
    bias_b_rad_s: Vec3
    fault_b_rad_s: Vec3

    @classmethod
    def from_flat(cls, flat: tuple[float, ...]) -> Truth:
        """Return the record of numbers in the order of TRUTH_FIELDS."""
        values: dict[str, float | tuple[float, ...]] = {}
        at = 0
        for fields in TRUTH_FIELDS.values():
            for name, count, _, _ in fields:
                values[name] = flat[at : at + count] if count > 1 else flat[at]
                at += count
        return cls(**values)  # type: ignore[arg-type]


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
    """Packs one tick of truth with a single call; values in the order of `Plant.flatten`."""
    return TickPacker(make_topics(), FIRST_CHANNEL)
