"""Receive and validate: turns the frames of one tick into a `Sensors` record, and counts everything it refuses.

A frame is used only if its length, checksum and alive counter are right. What does not arrive is held at its last good
value for `stale_after_ticks`, then marked not valid. Nothing that comes from the bus can raise out of here.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from bus.e2e import Link
from bus.icd_codec import DECODERS
from bus.units import Vec3, Vec4
from fsw.config import FswConfig
from fsw.interfaces import Sensors

Values = tuple[int | float, ...]  # (counter, high nibble, payload...) as the decoder returns them
Handler = Callable[[Values], None]

FOG_IDS = (0x1A0, 0x1A1, 0x1A2)
WHEEL_IDS = (0x190, 0x191, 0x192, 0x193)
STAR_A_ID, STAR_B_ID = 0x1B0, 0x1B1
SYNC_ID, TIME_ID, HEARTBEAT_PLANT_ID = 0x080, 0x100, 0x701

STATUS_OK = 0
STAR_NOT_VALID = 15
QUATERNION_NORM_TOLERANCE = 0.01  # a pair of halves further from unit norm than this is not an attitude
NEVER = -(10**9)  # tick of a unit that has not been heard yet


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
        self.links = {can_id: Link(DECODERS[can_id]) for can_id in self._handlers}
        self._slots = {can_id: (self.links[can_id].accept, handler) for can_id, handler in self._handlers.items()}
        self.counters = InputCounters()
        self.plant_tick = -1
        self.plant_state = 0
        self.run_hash = 0
        self._tick = 0
        self._rate = [0.0, 0.0, 0.0]
        self._rate_tick = [NEVER] * 3
        self._speed = [0.0, 0.0, 0.0, 0.0]
        self._speed_tick = [NEVER] * 4
        self._star_a: tuple[int, int, float, float] | None = None
        self._q: Vec4 = (1.0, 0.0, 0.0, 0.0)
        self._q_tick = NEVER  # tick at which the attitude was measured
        self._q_new = False

    def receive(self, tick: int, frames: list[tuple[int, int, bytes]]) -> Sensors:
        """Everything that is known at this tick, after the given frames (id, length, data)."""
        self._tick = tick
        self._q_new = False
        slots = self._slots
        for can_id, length, data in frames:
            slot = slots.get(can_id)
            if slot is None:
                self.counters.foreign += 1
                continue
            values = slot[0](data if length == 8 else data[:length])
            if values is None:
                self.counters.refused += 1
            else:
                slot[1](values)
        return self._sensors(tick)

    def _sensors(self, tick: int) -> Sensors:
        oldest = tick - self._hold_ticks
        rx, ry, rz = self._rate_tick
        w1, w2, w3, w4 = self._speed_tick
        rate: Vec3 = tuple(self._rate)  # type: ignore[assignment]
        s1, s2, s3, s4 = self._speed
        age_s = (tick - self._q_tick) * self._tick_s
        inertia = self._rotor_inertia_kgm2
        return Sensors(
            tick,
            tick * self._tick_s,
            rate,
            (rx >= oldest, ry >= oldest, rz >= oldest),
            self._q,
            self._q_new,
            age_s <= self._star_hold_s,
            age_s,
            (s1, s2, s3, s4),
            (w1 >= oldest, w2 >= oldest, w3 >= oldest, w4 >= oldest),
            (s1 * inertia, s2 * inertia, s3 * inertia, s4 * inertia),
        )

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
            self._rate[axis] = values[2]
            self._rate_tick[axis] = self._tick

        return on_fog

    def _make_wheel(self, wheel: int) -> Handler:
        def on_wheel(values: Values) -> None:
            speed_rad_s = values[2]
            if not -self._speed_limit_rad_s <= speed_rad_s <= self._speed_limit_rad_s:
                self.counters.implausible += 1
                return
            self._speed[wheel] = speed_rad_s
            self._speed_tick[wheel] = self._tick

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
