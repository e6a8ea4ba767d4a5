"""What kinds of fault are made of: the records that they change, what they are told, and the register of them all.

A kind is one frozen dataclass in a module under `kinds`: its magnitudes are its fields, with unit and range, its docstring
says what happens, and `disturb` does it. `register` puts it into KINDS; nothing else has to name it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import ClassVar, Final, TypeVar

from bus.units import Vec3
from plant_server.config import PlantConfig
from plant_server.faults.bus_nodes import ALL, PACING_IDS, ROUTES, Node
from plant_server.faults.profiles import STEP, Profile
from plant_server.faults.units import FAMILIES, WHEELS


class Acting:
    """What an effect is told: how far its fault has come on at this moment, and what fell by chance."""

    __slots__ = (
        "count", "drawn", "elapsed_s", "fast_s", "held_rad_s", "level", "past_rad_s", "past_s", "speed_rad_s", "start_s",
        "t_s",
    )  # fmt: skip

    def __init__(self, start_s: float) -> None:
        self.start_s = start_s
        self.t_s = start_s  # middle of the integration step (wheels), or the sample (sensors)
        self.elapsed_s = 0.0  # since the onset
        self.level = 0.0  # 0 not there .. 1 fully there
        self.drawn: tuple[float, ...] = ()  # uniform on [0, 1), anew for every sample, as many as the kind asks for
        self.speed_rad_s = 0.0  # wheel: of the rotor, relative to the body, at the start of the integration step
        self.held_rad_s: float | None = None  # gyro: the output that was held at the onset
        self.count = 0  # of steps or samples since the onset, for kinds that remember
        self.past_rad_s: list[float] = []  # gyro: its last rates, for kinds that delay them,
        self.past_s = -1.0  # and when the latest was taken
        self.fast_s = 0.0  # wheel: for how long it has run fast since the onset, for kinds that heal by that


class WheelDisturbance:
    """What the faults of a wheel make of it: of the motor, the bearing, the supply, the telemetry and the node.

    An ideal wheel has gain, offset, friction, seizure and telemetry; a wheel with a motor has all. Torques are those on the
    body about the wheel's axis [N m] but for friction and seizure, which oppose the rotor's motion.
    """

    __slots__ = (
        "bus_v", "coulomb_gain", "counter_frozen", "current_frozen", "current_gain", "current_lsb_a", "current_offset_a",
        "driver_gain", "friction_nm", "gain", "has_bus", "is_stuck", "late_ticks", "motor_on", "offset_nm", "seize_nm",
        "silent", "speed_frozen", "speed_gain", "speed_lsb_rad_s", "speed_offset_rad_s", "static_nm", "stuck_current_a",
        "torque_gain", "viscous_gain",
    )  # fmt: skip

    def __init__(self) -> None:
        # the torque of the whole motor, as papers without a motor model have it: gain tau + offset
        self.gain = 1.0
        self.offset_nm = 0.0
        # the motor: driver gain C_d, torque constant C_t, whether it has current at all, a current it cannot leave
        self.driver_gain = 1.0
        self.torque_gain = 1.0
        self.motor_on = True
        self.is_stuck = False
        self.stuck_current_a = 0.0
        # the bearing: factors on dry and viscous friction, more dry friction, more at rest (Stribeck), seizure
        self.coulomb_gain = 1.0
        self.viscous_gain = 1.0
        self.friction_nm = 0.0
        self.static_nm = 0.0
        self.seize_nm = 0.0
        # the supply: what the bus has in place of its own voltage
        self.has_bus = False
        self.bus_v = 0.0
        # telemetry: value gain + offset in steps of lsb (0: none), or as it was
        self.speed_gain = 1.0
        self.speed_offset_rad_s = 0.0
        self.speed_lsb_rad_s = 0.0
        self.speed_frozen = False
        self.current_gain = 1.0
        self.current_offset_a = 0.0
        self.current_lsb_a = 0.0
        self.current_frozen = False
        # the node: no frames, frames of so many ticks ago, an alive counter that stands
        self.silent = False
        self.late_ticks = 0
        self.counter_frozen = False


class GyroSample:
    """One sample of a gyro axis on its way through the faults."""

    __slots__ = ("frozen", "last_rad_s", "noise_gain", "rate_rad_s", "silent", "white_rad_s")

    def __init__(self, rate_rad_s: float, white_rad_s: float, last_rad_s: float) -> None:
        self.rate_rad_s = rate_rad_s
        self.white_rad_s = white_rad_s  # the white noise in it
        self.last_rad_s = last_rad_s  # what the axis gave out last
        self.noise_gain = 1.0  # of the white noise
        self.frozen = False  # the output stands still: it is not quantised again
        self.silent = False  # no frame

    def shift_to(self, rate_rad_s: float) -> None:
        """Change the rate; a frozen output that moves is no longer frozen."""
        self.frozen = self.frozen and rate_rad_s == self.rate_rad_s
        self.rate_rad_s = rate_rad_s


class StarSample:
    """One message of the star tracker on its way through the faults."""

    __slots__ = ("frozen", "late_ticks", "lost", "random", "turn_b_rad")

    def __init__(self) -> None:
        self.lost = False
        self.frozen = False  # it carries the attitude of the last one
        self.random: tuple[float, float, float] | None = (
            None  # it carries any attitude: three numbers on [0, 1) say which
        )
        self.turn_b_rad: Vec3 = (0.0, 0.0, 0.0)  # by which its attitude is turned, about axes of the body
        self.late_ticks = 0

    def turn(self, axis: str, angle_rad: float) -> None:
        """Turn the attitude about an axis of the body; several turns add up as rotation vectors."""
        x, y, z = self.turn_b_rad
        more = {"x": (angle_rad, 0.0, 0.0), "y": (0.0, angle_rad, 0.0), "z": (0.0, 0.0, angle_rad)}[axis]
        self.turn_b_rad = (x + more[0], y + more[1], z + more[2])


class BusFrame:
    """One frame on its way from one node of the bus to another, as its faults leave it."""

    __slots__ = (
        "broken_bits",
        "copies",
        "delay_s",
        "dlc",
        "extra_hz",
        "forged",
        "is_blocked",
        "is_off",
        "lost",
        "swapped",
    )

    def __init__(self) -> None:
        self.lost = ""  # why it does not arrive; empty: it does
        self.delay_s = 0.0
        self.copies = 0  # how often it arrives besides
        self.swapped = False  # arrives behind the next of its id
        self.broken_bits: tuple[int, ...] = ()  # of the 64 of its data
        self.dlc = -1  # the number of data bytes in place of its own; -1: its own
        self.is_off = False  # every attempt of its sender fails
        self.is_blocked = False  # no attempt of anybody begins
        self.extra_hz = 0.0  # frames of a babbling node beside it
        self.forged = False  # another node sends one of its id as well


class Effect:
    """What all kinds share: settings of the kind itself, and what to say of one that can do nothing."""

    __slots__ = ()
    family: ClassVar[str]  # set by `register`,
    kind: ClassVar[str]  # as the name of the kind in scenarios
    rises: ClassVar[bool] = True  # whether a level between 0 and 1 means anything: any profile will do
    switches: ClassVar[bool] = False  # does not rise, but can come and go: profiles without a slope
    usual: ClassVar[Profile] = STEP  # profile of a fault that gives none, and of keys that one of its sort leaves out
    draws: ClassVar[int] = 0  # random numbers a sample, from a stream of the fault's own
    draws_each: ClassVar[int] = 0  # random numbers a frame, for kinds of the bus
    steady: ClassVar[bool] = (
        True  # changes only as its level does (a wheel's faults are looked at only when they change)
    )
    early: ClassVar[bool] = False  # acts ahead of all others of its unit, whenever its onset is
    last: ClassVar[bool] = False  # acts behind all others of its unit
    remembers: ClassVar[bool] = False  # has `follow` called once a step
    brings_rivals: ClassVar[bool] = False  # looks like a second sender of an id: that is no failure of the run then
    resettable: ClassVar[bool] = False  # a reset or a power cycle of its unit heals it, where it has no latch
    # for the catalogue: where it is in the model's equations, where it was seen, MAVLink (FAILURE_UNIT, FAILURE_TYPE)
    equation: ClassVar[str] = ""
    seen_in: ClassVar[str] = ""
    failures: ClassVar[tuple[tuple[int, int], ...]] = ()

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why it can have no effect on this unit of this plant (None: of any), whatever happens; None when it can."""
        return None

    def explain_short(self, tick_s: float) -> str | None:
        """Return why it can have no effect at this period of the loop [s]; None when it can."""
        return None

    def follow(self, now: Acting, passed_s: float) -> str | None:
        """Keep in `now` what it remembers of the time passed; return why it has healed by itself, None: it has not."""
        return None


LEAST: Final = 1e-9  # in SI units: a magnitude that is nearer than this to the one that changes nothing changes nothing
SPEED_STEP_RAD_S: Final = 1e-3  # of a wheel's telemetry frame: what is less does not leave the unit
CURRENT_STEP_A: Final = 1e-3


def is_neutral(value: float, neutral: float) -> bool:
    """Return whether a magnitude is the one that changes nothing, as nearly as matters."""
    return abs(value - neutral) < LEAST


class WheelEffect(Effect):
    """A kind of wheel fault."""

    __slots__ = ()
    needs_motor: ClassVar[bool] = False  # changes what an ideal wheel has not: driver, current, supply, lubricant
    reports: ClassVar[bool] = False  # changes what the wheel reports alone, and so nothing between two samples

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when it needs a motor and the wheel is an ideal one."""
        return explain_without_motor(self, plant, unit)

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Change the record as the fault does, after those with an earlier onset."""
        raise NotImplementedError


def explain_without_motor(effect: WheelEffect, plant: PlantConfig | None, unit: str) -> str | None:
    """Return why a kind that needs a motor can do nothing on this wheel, None when it can."""
    if not effect.needs_motor or plant is None or unit not in WHEELS:
        return None
    index = WHEELS.index(unit)
    if getattr(plant.wheels[index], "model", "ideal") != "ideal":
        return None
    return f"{effect.kind} has no effect: {unit} is an ideal wheel; give plant.wheels[{index}] a model with a motor"


class GyroEffect(Effect):
    """A kind of gyro fault."""

    __slots__ = ()

    def disturb(self, sample: GyroSample, now: Acting) -> None:
        """Change the record as the fault does, after those with an earlier onset."""
        raise NotImplementedError


class StarEffect(Effect):
    """A kind of star tracker fault."""

    __slots__ = ()

    def disturb(self, sample: StarSample, now: Acting) -> None:
        """Change the record as the fault does, after those with an earlier onset."""
        raise NotImplementedError


class BusEffect(Effect):
    """A kind of fault of the bus: concerns the frames that a node sends or that are meant for it."""

    __slots__ = ()
    sends_only: ClassVar[bool] = False  # concerns what the node sends, and not what it is sent
    delays: ClassVar[bool] = False  # makes a difference only where that is more than the bus lets pass
    on_wire: ClassVar[bool] = False  # strikes each attempt to send a frame, where the bus takes its time

    @property
    def node(self) -> Node:
        """Whose frames; of kinds that do not choose, everybody's."""
        return "all"

    @property
    def can_id(self) -> int | None:
        """Of these alone the frames with this id; None: any."""
        return None

    def concerns(self, can_id: int, sender: str, receiver: str) -> bool:
        """Return whether a frame is one of those that it strikes."""
        is_its = self.node in (ALL, sender) or (self.node == receiver and not self.sends_only)
        return is_its and (self.can_id is None or self.can_id == can_id)

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when no frame that is sent is one of those that it strikes."""
        if self.can_id is None:
            return None
        if self.can_id in PACING_IDS:
            return f"0x{self.can_id:03X} paces the run and is left alone by faults of the bus; give another can_id"
        route = ROUTES.get(self.can_id)
        if route is None or not self.concerns(self.can_id, *route):
            words = f"is sent by {route[0]} to {route[1]}" if route else "is sent by no node"
            return f"has no effect: 0x{self.can_id:03X} {words}; give node or can_id another value"
        return None

    def disturb(self, frame: BusFrame, now: Acting) -> bool:
        """Change the record as the fault does; return whether that made a difference."""
        raise NotImplementedError


KINDS: dict[str, dict[str, type[Effect]]] = {family: {} for family in FAMILIES}
E = TypeVar("E", bound=Effect)


def register(family: str, kind: str) -> Callable[[type[E]], type[E]]:
    """Return a class decorator that makes an effect known as `kind` of a family: wheel, gyro, star_tracker or bus."""

    def enter(cls: type[E]) -> type[E]:
        if not dataclasses.is_dataclass(cls) or kind in KINDS[family]:
            raise TypeError(f"{cls.__name__}: a kind of fault is a dataclass under a name of its own, not {kind} again")
        cls.family, cls.kind = family, kind
        KINDS[family][kind] = cls
        return cls

    return enter
