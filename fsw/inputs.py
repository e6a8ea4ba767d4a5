"""Receive and validate: brings the `Sensors` record up to date with the frames of a tick, and counts what it refuses.

A frame is used only if its length, checksum and alive counter are right. What does not arrive is held at its last good
value for `stale_after_ticks`, then marked not valid. Nothing that comes from the bus can raise out of here.

Two ways lead to the same result. `_take_usual` takes the batch of a tick on which every unit spoke in its turn, all at once.
Whatever differs from that in one bit goes frame by frame through `_take`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from bus.attitude import IDENTITY
from bus.icd.batches import DECODERS, decode_sensors
from bus.icd.codec import SENSORS_SIZE
from bus.icd.e2e import Link, LinkGroup, part_group
from bus.icd.heartbeat import count_heartbeat_ticks
from bus.units import Vec4
from bus.wire.frames import ERR_FLAG, FRAME
from fsw.link_watch import MANY_BYTES, LinkWatch
from fsw.records import ALL_AXES, NOT_HEARD, Sensors
from fsw.settings import ModesConfig
from fsw.vehicle import Vehicle

Values = tuple[int | float, ...]  # (counter, high nibble, payload...) as the decoder returns them
Handler = Callable[[Values], None]

FOG_IDS = (0x1A0, 0x1A1, 0x1A2)
WHEEL_IDS = (0x190, 0x191, 0x192, 0x193)
STAR_A_ID: Final = 0x1B0
STAR_B_ID: Final = 0x1B1
SYNC_ID: Final = 0x080
TIME_ID: Final = 0x100
HEARTBEAT_PLANT_ID: Final = 0x701
TEMP_IDS = (0x290, 0x291, 0x292, 0x293)
POWER_IDS = (0x390, 0x391, 0x392, 0x393)
SLOW_IDS = (TIME_ID, HEARTBEAT_PLANT_ID, *TEMP_IDS, *POWER_IDS)
GROUP_IDS = (*WHEEL_IDS, *FOG_IDS, SYNC_ID)  # the frames of every tick, in the order in which the plant sends them

WATCHED_IDS = (*WHEEL_IDS, *FOG_IDS, STAR_A_ID)  # one for each of fsw.link_watch.UNITS

STATUS_OK: Final = 0
AGE_WRAPS: Final = 128  # an age from here on is that of a frame ahead of its tick
STAR_NOT_VALID: Final = 15
SLOW_HOLD_PERIODS: Final = 3  # slow telemetry of a wheel is stale when the third frame in a row is missing
QUATERNION_NORM_TOLERANCE: Final = 0.01  # a pair of halves further from unit norm than this is not an attitude
NEVER: Final = NOT_HEARD
AT_NO_TICK: Final = 1 << 62


@dataclass(slots=True)
class InputCounters:
    """Frames refused, by reason; all units together. Per unit counts are in `Inputs.links`."""

    foreign: int = 0  # not an id that the flight software listens to, or not a classic data frame
    refused: int = 0  # length, checksum or alive counter wrong
    unit_fault: int = 0  # well formed, but the unit itself says that its value is not good
    implausible: int = 0  # well formed, but not a possible value
    too_old: int = 0  # telemetry of a wheel whose SYNC_CNT is older than a value may be held


class Inputs:
    """State of what has been received: last good values and when."""

    def __init__(self, modes: ModesConfig, vehicle: Vehicle, tick_s: float, run_hash: int) -> None:
        self._run_hash = run_hash
        self._tick_s = tick_s
        self.hold_ticks = modes.stale_after_ticks
        self.star_hold_s = modes.star_stale_after_s
        self._slow_hold_ticks = SLOW_HOLD_PERIODS * count_heartbeat_ticks(tick_s)
        self._fitted = vehicle.fitted
        self._rotor_inertia_kgm2 = vehicle.wheel_inertia_kgm2
        a, b, c, d = vehicle.wheel_max_speed_rad_s
        self._top_speed_rad_s: Vec4 = (2.0 * a, 2.0 * b, 2.0 * c, 2.0 * d)
        handlers: dict[int, Handler] = {
            SYNC_ID: self._on_sync,
            TIME_ID: self._on_time,
            HEARTBEAT_PLANT_ID: self._on_heartbeat,
        }
        handlers |= {can_id: self._make_fog(i) for i, can_id in enumerate(FOG_IDS)}
        handlers |= {can_id: self._make_wheel(i) for i, can_id in enumerate(WHEEL_IDS)}
        handlers |= {STAR_A_ID: self._on_star_a, STAR_B_ID: self._on_star_b}
        handlers |= {can_id: self._make_temp(i) for i, can_id in enumerate(TEMP_IDS)}
        handlers |= {can_id: self._make_power(i) for i, can_id in enumerate(POWER_IDS)}
        self._handlers = handlers
        self.watch = LinkWatch(modes.stale_after_ticks, math.ceil(modes.star_stale_after_s / tick_s), vehicle.fitted)
        self.reset()

    def reset(self) -> None:
        """Forget everything heard, as after boot."""
        slow_ticks = count_heartbeat_ticks(self._tick_s)
        self._links = {
            can_id: Link(DECODERS[can_id], slow_ticks if can_id in SLOW_IDS else 1) for can_id in self._handlers
        }
        self._slots = {can_id: (self._links[can_id].accept, handler) for can_id, handler in self._handlers.items()}
        self._group = LinkGroup([self._links[can_id] for can_id in GROUP_IDS])
        self._watched = tuple([self._links[can_id] for can_id in WATCHED_IDS])
        self.watch.reset()
        self.counters = InputCounters()
        self.sensors = Sensors()
        self.plant_tick = -1
        self.plant_state = 0
        self._tick = 0
        self._all_tick = NEVER  # on which every gyro axis and wheel spoke
        self._rate_tick = [NEVER, NEVER, NEVER]  # on which each spoke by itself
        # one that is not fitted has nothing to say, and is not missed
        self._wheel_tick = [NEVER if fitted else -NEVER for fitted in self._fitted]
        self._slow_due = AT_NO_TICK  # tick on which some wheel's slow telemetry may have become stale
        self._star_a: tuple[int, int, float, float] | None = None
        self._q_ib = IDENTITY
        self._q_tick = NEVER  # tick at which the attitude was measured
        self._q_new = False

    @property
    def links(self) -> dict[int, Link]:
        """What has been received, by frame id."""
        self._group.part()
        return self._links

    def count_rivals(self) -> int:
        """Frames so far that show a second sender of an id, over all ids."""
        return sum([link.rivals for link in self._links.values()])

    def list_rivals(self) -> list[int]:
        """The ids that more than one node sends."""
        return [can_id for can_id, link in self._links.items() if link.rivals]

    def receive(self, tick: int, batch: bytes) -> Sensors:
        """Everything that is known at this tick, after the given frames. The record is the same one every time."""
        self._tick = tick
        self._q_new = False
        sensors = self.sensors
        sync_tick = self.plant_tick + 1  # which this batch's SYNC says if the plant goes on by one
        if self._take_usual(tick, batch):
            sensors.gyro_valid = ALL_AXES
        else:
            self._group.part()
            a, b, c, d = sensors.wheels
            a.new = b.new = c.new = d.new = False
            self._take(batch)
            if self._is_in_step(tick) and self.plant_tick == sync_tick:
                self._group.join()
            else:
                self._group.stay_apart()
            self._judge_age(tick)
            self.watch.look(tick, self._watched)
        if tick >= self.watch.next_look:
            self._group.part()
            self.watch.look_ahead(tick, self._watched)
        if tick >= self._slow_due:
            self._judge_slow(tick)
        sensors.tick = tick
        sensors.t_s = tick * self._tick_s
        sensors.star_new = self._q_new
        age_s = sensors.star_age_s = (tick - self._q_tick) * self._tick_s
        sensors.star_valid = age_s <= self.star_hold_s
        sensors.q_ib_meas = self._q_ib
        return sensors

    def _take_usual(self, tick: int, batch: bytes) -> bool:
        """Take a batch in which every unit speaks in its turn, all at once; False where it is anything else."""
        usual, between = batch, b""
        if len(batch) != SENSORS_SIZE:
            parts = part_group(batch, SENSORS_SIZE, GROUP_IDS)
            if parts is None:
                return False
            usual, between = parts
        s1, s2, s3, s4, i1, i2, i3, i4, x, y, z, plant_tick = decode_sensors(usual, self._group.expected)
        if plant_tick != self.plant_tick + 1:  # -1 where the batch is not as usual
            return False
        t1, t2, t3, t4 = self._top_speed_rad_s
        if not (-t1 <= s1 <= t1 and -t2 <= s2 <= t2 and -t3 <= s3 <= t3 and -t4 <= s4 <= t4):
            return False
        self._group.accept(usual, tick)
        self.plant_tick = plant_tick
        self._all_tick = tick
        self.sensors.omega_meas_b_rad_s = (x, y, z)
        a, b, c, d = self.sensors.wheels
        r1, r2, r3, r4 = self._rotor_inertia_kgm2
        a.speed_rad_s, b.speed_rad_s, c.speed_rad_s, d.speed_rad_s = s1, s2, s3, s4
        a.h_nms, b.h_nms, c.h_nms, d.h_nms = s1 * r1, s2 * r2, s3 * r3, s4 * r4
        a.current_a, b.current_a, c.current_a, d.current_a = i1 * 1e-3, i2 * 1e-3, i3 * 1e-3, i4 * 1e-3
        a.status = b.status = c.status = d.status = STATUS_OK
        a.valid = b.valid = c.valid = d.valid = True
        a.new = b.new = c.new = d.new = True
        if between:
            self._take(between)
        return True

    def _is_in_step(self, tick: int) -> bool:
        """Whether all that speak on every tick have said something of this one.

        A wheel whose frames are late by a whole turn of the alive counter has the counter of the others: only its SYNC_CNT
        tells, which `_take_usual` does not look at. That it is as good as looked at there needs a SYNC that went on by one
        as well: after one of another tick (a second sender's, say) the age of every wheel is another.
        """
        return min(self._wheel_tick) == tick and min(self._rate_tick) == tick

    def _judge_slow(self, tick: int) -> None:
        """Mark slow telemetry that has become stale, and find when the next can be."""
        self._slow_due = AT_NO_TICK
        for power in self.sensors.powers:
            if power.valid:
                stale_tick = min(power.temp_tick, power.power_tick) + self._slow_hold_ticks
                power.valid = tick < stale_tick
                if power.valid:
                    self._slow_due = min(self._slow_due, stale_tick)

    def _judge_age(self, tick: int) -> None:
        """Mark what has not been heard for too long."""
        oldest = tick - self.hold_ticks
        if self._all_tick >= oldest:
            self.sensors.gyro_valid = ALL_AXES
            for wheel in self.sensors.wheels:
                wheel.valid = True
            return
        x, y, z = self._rate_tick
        self.sensors.gyro_valid = (x >= oldest, y >= oldest, z >= oldest)
        for wheel, last in zip(self.sensors.wheels, self._wheel_tick, strict=True):
            wheel.valid = last >= oldest

    def _take(self, frames: bytes) -> None:
        slots = self._slots
        if len(frames) > MANY_BYTES:
            frames = self.watch.thin(self._tick, frames, self._links)
        for can_id, length, data in FRAME.iter_unpack(frames):
            slot = slots.get(can_id)
            if slot is None:
                if can_id & ERR_FLAG:
                    self.watch.note_error_frame(self._tick, can_id, data)
                else:
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
        if values[3] != self._run_hash:  # of another bench on this bus
            self.counters.foreign += 1
            return
        self.plant_state = int(values[2])

    def _make_fog(self, axis: int) -> Handler:
        def on_fog(values: Values) -> None:
            if values[1] != STATUS_OK:
                self.counters.unit_fault += 1
                return
            rate = list(self.sensors.omega_meas_b_rad_s)
            rate[axis] = values[2]
            self.sensors.omega_meas_b_rad_s = (rate[0], rate[1], rate[2])
            self._rate_tick[axis] = self._tick

        return on_fog

    def _make_wheel(self, wheel: int) -> Handler:
        def on_wheel(values: Values) -> None:
            speed_rad_s, top = values[2], self._top_speed_rad_s[wheel]
            if not -top <= speed_rad_s <= top:
                self.counters.implausible += 1
                return
            age_ticks = self._find_age(int(values[4]))
            if age_ticks > self.hold_ticks:
                self.counters.too_old += 1
                return
            reading = self.sensors.wheels[wheel]
            reading.speed_rad_s = speed_rad_s
            reading.h_nms = speed_rad_s * self._rotor_inertia_kgm2[wheel]
            reading.current_a = values[3] * 1e-3
            reading.status = int(values[1])
            reading.valid = reading.new = True
            self._wheel_tick[wheel] = self._tick - age_ticks

        return on_wheel

    def _find_age(self, sync_cnt: int) -> int:
        """Return how many ticks ago a frame was due, by its SYNC_CNT; 0 before the first SYNC.

        The frames of a tick come ahead of its SYNC: those of the next one are the newest that there can be.
        """
        age_ticks = (self.plant_tick + 1 - sync_cnt) & 0xFF
        return age_ticks if self.plant_tick >= 0 and age_ticks < AGE_WRAPS else 0

    def _make_temp(self, wheel: int) -> Handler:
        def on_temp(values: Values) -> None:
            power = self.sensors.powers[wheel]
            power.motor_c, power.driver_c, power.bus_v = values[2], values[3], values[4] * 1e-3
            power.temp_tick = self._tick
            self._note_slow(wheel)

        return on_temp

    def _make_power(self, wheel: int) -> Handler:
        def on_power(values: Values) -> None:
            power = self.sensors.powers[wheel]
            power.bus_current_a, power.latch, power.uptime_s = values[2] * 1e-3, int(values[3]), float(values[4])
            power.power_tick = self._tick
            self._note_slow(wheel)

        return on_power

    def _note_slow(self, wheel: int) -> None:
        """Mark a wheel's slow telemetry valid where both halves are fresh."""
        power = self.sensors.powers[wheel]
        power.valid = power.count_age_ticks(self._tick) < self._slow_hold_ticks
        if power.valid:
            self._slow_due = min(self._slow_due, self._tick + 1)

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
        self._q_ib = (q0 / norm, q1 / norm, q2 / norm, q3 / norm)
        self._q_tick = self._tick - age_ticks
        self._q_new = True
