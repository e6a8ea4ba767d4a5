"""Receive and validate: turns the frames of one tick into a `Sensors` record, and counts everything it refuses.

A frame is used only if its length, checksum and alive counter are right. What does not arrive is held at its last good
value for `stale_after_ticks`, then marked not valid. Nothing that comes from the bus can raise out of here.

Two ways lead to the same result. `receive` takes the batch of a tick on which every unit spoke in its turn, all at once.
Whatever differs from that in one bit goes frame by frame through `_receive_each`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from bus.icd.codec import DECODERS, SENSORS_SIZE, decode_sensors
from bus.icd.e2e import Link, LinkGroup, part_group
from bus.units import Vec3, Vec4
from bus.wire.frames import FRAME
from fsw.config import FswConfig
from fsw.records import Sensors

Values = tuple[int | float, ...]  # (counter, high nibble, payload...) as the decoder returns them
Handler = Callable[[Values], None]
T = TypeVar("T", bound=tuple[Any, ...])

FOG_IDS = (0x1A0, 0x1A1, 0x1A2)
WHEEL_IDS = (0x190, 0x191, 0x192, 0x193)
STAR_A_ID, STAR_B_ID = 0x1B0, 0x1B1
SYNC_ID, TIME_ID, HEARTBEAT_PLANT_ID = 0x080, 0x100, 0x701
GROUP_IDS = (*WHEEL_IDS, *FOG_IDS, SYNC_ID)  # the frames of every tick, in the order in which the plant sends them

STATUS_OK = 0
STAR_NOT_VALID = 15
QUATERNION_NORM_TOLERANCE = 0.01  # a pair of halves further from unit norm than this is not an attitude
NEVER = -(10**9)  # tick of a unit that has not been heard yet
ALL_AXES = (True, True, True)
ALL_WHEELS = (True, True, True, True)


@dataclass(slots=True)
class InputCounters:
    """Frames refused, by reason; all units together. Per unit counts are in `Inputs.links`."""

    foreign: int = 0  # not an id that the flight software listens to, or not a classic data frame
    refused: int = 0  # length, checksum or alive counter wrong
    unit_fault: int = 0  # well formed, but the unit itself says that its value is not good
    implausible: int = 0  # well formed, but not a possible value


class Inputs:
    """State of what has been received: last good values and when."""

    def __init__(self, config: FswConfig, tick_s: float) -> None:
        self._tick_s = tick_s
        self._hold_ticks = config.modes.stale_after_ticks
        self._star_hold_s = config.modes.star_stale_after_s
        self._rotor_inertia_kgm2 = config.model.wheel_inertia_kgm2
        self._speed_limit_rad_s = 2.0 * config.model.wheel_max_speed_rad_s
        handlers: dict[int, Handler] = {
            SYNC_ID: self._on_sync,
            TIME_ID: self._on_time,
            HEARTBEAT_PLANT_ID: self._on_heartbeat,
        }
        handlers |= {can_id: self._make_fog(i) for i, can_id in enumerate(FOG_IDS)}
        handlers |= {can_id: self._make_wheel(i) for i, can_id in enumerate(WHEEL_IDS)}
        handlers |= {STAR_A_ID: self._on_star_a, STAR_B_ID: self._on_star_b}
        self._handlers = handlers
        self.reset()

    def reset(self) -> None:
        """Forget everything heard, as after boot."""
        self._links = {can_id: Link(DECODERS[can_id]) for can_id in self._handlers}
        self._slots = {can_id: (self._links[can_id].accept, handler) for can_id, handler in self._handlers.items()}
        self._group = LinkGroup([self._links[can_id] for can_id in GROUP_IDS])
        self.counters = InputCounters()
        self.plant_tick = -1
        self.plant_state = 0
        self.run_hash = 0
        self._tick = 0
        self._rate: Vec3 = (0.0, 0.0, 0.0)
        self._rate_tick = (NEVER, NEVER, NEVER)
        self._speed: Vec4 = (0.0, 0.0, 0.0, 0.0)
        self._speed_tick = (NEVER, NEVER, NEVER, NEVER)
        self._usual: tuple[int, Vec3, Vec4] | None = None  # tick, rate and speed of all units, ahead of those above
        self._star_a: tuple[int, int, float, float] | None = None
        self._q: Vec4 = (1.0, 0.0, 0.0, 0.0)
        self._q_tick = NEVER  # tick at which the attitude was measured
        self._q_new = False

    @property
    def links(self) -> dict[int, Link]:
        """What has been received, by frame id."""
        self._group.part()
        return self._links

    def receive(self, tick: int, batch: bytes) -> Sensors:
        """Everything that is known at this tick, after the given frames."""
        self._tick = tick
        self._q_new = False
        usual, between = batch, b""
        if len(batch) != SENSORS_SIZE:
            parts = part_group(batch, SENSORS_SIZE, GROUP_IDS)
            if parts is None:
                return self._receive_each(tick, batch)
            usual, between = parts
        values = decode_sensors(usual, self._group.expected)
        if values is None:
            return self._receive_each(tick, batch)
        s1, s2, s3, s4, _, _, _, _, x, y, z, plant_tick = values
        top = self._speed_limit_rad_s
        if not (-top <= s1 <= top and -top <= s2 <= top and -top <= s3 <= top and -top <= s4 <= top):
            return self._receive_each(tick, batch)
        self._group.accept(usual, tick)
        self.plant_tick = plant_tick
        rate, speed = (x, y, z), (s1, s2, s3, s4)
        self._usual = (tick, rate, speed)
        if between:
            self._take(between)
        tick_s = self._tick_s
        age_s = (tick - self._q_tick) * tick_s
        i = self._rotor_inertia_kgm2
        return tuple.__new__(
            Sensors,
            (tick, tick * tick_s, rate, ALL_AXES, self._q, self._q_new, age_s <= self._star_hold_s, age_s,
             speed, ALL_WHEELS, (s1 * i, s2 * i, s3 * i, s4 * i)),
        )  # fmt: skip

    def _receive_each(self, tick: int, batch: bytes) -> Sensors:
        """Take any frames, one by one."""
        if self._usual is not None:
            last, self._rate, self._speed = self._usual
            self._rate_tick, self._speed_tick = (last, last, last), (last, last, last, last)
            self._usual = None
        self._group.part()
        self._take(batch)
        self._group.join()
        oldest = tick - self._hold_ticks
        rx, ry, rz = self._rate_tick
        w1, w2, w3, w4 = self._speed_tick
        s1, s2, s3, s4 = self._speed
        age_s = (tick - self._q_tick) * self._tick_s
        inertia = self._rotor_inertia_kgm2
        return Sensors(
            tick,
            tick * self._tick_s,
            self._rate,
            (rx >= oldest, ry >= oldest, rz >= oldest),
            self._q,
            self._q_new,
            age_s <= self._star_hold_s,
            age_s,
            self._speed,
            (w1 >= oldest, w2 >= oldest, w3 >= oldest, w4 >= oldest),
            (s1 * inertia, s2 * inertia, s3 * inertia, s4 * inertia),
        )

    def _take(self, frames: bytes) -> None:
        slots = self._slots
        for can_id, length, data in FRAME.iter_unpack(frames):
            slot = slots.get(can_id)
            if slot is None:
                self.counters.foreign += 1
                continue
            values = slot[0](data if length == 8 else data[:length], self._tick)
            if values is None:
                self.counters.refused += 1
            else:
                slot[1](values)

    # -- one handler a message -------------------------------------------------------------------------------------

    def _on_sync(self, values: Values) -> None:
        self.plant_tick = int(values[2])

    def _on_time(self, values: Values) -> None:
        pass  # calendar time is for the ground; nothing in the cycle depends on it

    def _on_heartbeat(self, values: Values) -> None:
        run_hash = int(values[3])
        if self.run_hash not in (0, run_hash):  # of another bench on this bus
            self.counters.foreign += 1
            return
        self.plant_state = int(values[2])
        self.run_hash = run_hash

    def _make_fog(self, axis: int) -> Handler:
        def on_fog(values: Values) -> None:
            if values[1] != STATUS_OK:
                self.counters.unit_fault += 1
                return
            self._rate = _replace(self._rate, axis, values[2])
            self._rate_tick = _replace(self._rate_tick, axis, self._tick)

        return on_fog

    def _make_wheel(self, wheel: int) -> Handler:
        def on_wheel(values: Values) -> None:
            speed_rad_s = values[2]
            if not -self._speed_limit_rad_s <= speed_rad_s <= self._speed_limit_rad_s:
                self.counters.implausible += 1
                return
            self._speed = _replace(self._speed, wheel, speed_rad_s)
            self._speed_tick = _replace(self._speed_tick, wheel, self._tick)

        return on_wheel

    def _on_star_a(self, values: Values) -> None:
        self._star_a = values  # type: ignore[assignment]

    def _on_star_b(self, values: Values) -> None:
        first = self._star_a
        self._star_a = None
        if first is None or first[0] != values[0] or first[1] != values[1]:
            self.counters.implausible += 1
            return
        age_ticks = int(values[1])
        if age_ticks == STAR_NOT_VALID:
            self.counters.unit_fault += 1
            return
        q0, q1, q2, q3 = first[2], first[3], values[2], values[3]
        norm = math.sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
        if abs(norm - 1.0) > QUATERNION_NORM_TOLERANCE:
            self.counters.implausible += 1
            return
        self._q = (q0 / norm, q1 / norm, q2 / norm, q3 / norm)
        self._q_tick = self._tick - age_ticks
        self._q_new = True


def _replace(values: T, index: int, value: float) -> T:
    """Return the tuple with another value at that index."""
    return (*values[:index], value, *values[index + 1 :])  # type: ignore[return-value]
