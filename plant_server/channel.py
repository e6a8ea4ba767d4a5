"""The plant on the bus: encodes what the units measure, takes the wheel commands, and advances the truth.

One tick k, on every clock:

    sample    the units measure at t_k
    announce  their frames, then SYNC(k), go out
    accept    frames that came in; a wheel takes a command only if length, checksum, counter and age are right
    advance   the truth moves to t_(k+1)
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

from bus.icd.batches import (
    decode_commands,
    encode_fogs,
    encode_rw_tlms,
    encode_STR_QA,
    encode_STR_QB,
    encode_SYNC,
)
from bus.icd.codec import COMMANDS_SIZE, DECODERS, decode_CYCLE_DONE, encode_HEARTBEAT_PLANT, encode_TIME
from bus.icd.e2e import COUNTER_MODULUS, JUMP, REPEATED, Link, LinkGroup, part_group
from bus.icd.heartbeat import OPERATIONAL, count_heartbeat_ticks
from bus.linear import ZERO4
from bus.units import Vec4
from bus.wheels import CURRENT, SPEED, TORQUE
from bus.wire.frames import FRAME, FRAME_SIZE
from plant_server.plant import FaultEvent, Plant, Snapshot
from plant_server.star_tracker import StarFrame
from plant_server.wheel_nodes import Torques, WheelNodes
from plant_server.wheels.bank import NO_WHEEL, ON_TIME, Status4

COMMAND_IDS = {0x110: 0, 0x111: 1, 0x112: 2, 0x113: 3}
CURRENT_IDS = {0x120: 0, 0x121: 1, 0x122: 2, 0x123: 3}
SPEED_IDS = {0x130: 0, 0x131: 1, 0x132: 2, 0x133: 3}
CONTROL_IDS = {0x300: 0, 0x301: 1, 0x302: 2, 0x303: 3}
CYCLE_DONE_ID: Final = 0x081
HEARTBEAT_FSW_ID: Final = 0x702
GROUP_IDS = (*COMMAND_IDS, CYCLE_DONE_ID)  # the frames of every tick, in the order in which they come
GROUP_SIZE: Final = len(GROUP_IDS)
NO_TORQUE: Torques = ZERO4
ALL_TORQUE: Status4 = (TORQUE, TORQUE, TORQUE, TORQUE)
NEVER: Final = -(10**9)  # tick of a command that has not come yet


@dataclass(slots=True)
class ChannelCounters:
    """Frames from the bus, by what became of them."""

    accepted: int = 0
    refused: int = 0  # length, checksum or alive counter wrong
    foreign: int = 0  # not for the plant
    too_old: int = 0  # a command whose SYNC_CNT is older than allowed
    timeouts: int = 0  # wheel-ticks without a fresh enough command
    stray: int = 0  # CYCLE_DONE of another tick than the present one; in real time the sides count ticks apart


class Channel:
    """A `Plant` behind CAN frames. Holds no socket and reads no clock."""

    def __init__(self, plant: Plant, tick_s: float, run_hash: int) -> None:
        self.plant = plant
        self._bank = plant.wheels
        self.tick = 0
        self.fsw_state = -1
        self.fsw_run_hash = -1
        self.done_tick = -1  # last tick of which CYCLE_DONE came while it was the present one
        self.events: tuple[FaultEvent, ...] = ()  # faults that took effect or ended since the last samples
        self.snapshot: Snapshot = plant.snapshot()  # of the truth, at the time of the samples
        self._run_hash = run_hash
        self.heartbeat_ticks = count_heartbeat_ticks(tick_s)
        self._tick_s = tick_s
        self._star_counter = 0
        config = plant.config
        self._timeout_ticks = config.command_timeout_ticks
        self._max_age_ticks = config.command_max_age_ticks
        self._torques_nm: Vec4 = ZERO4  # of the last command that each wheel took
        self._torque_ticks = (NEVER, NEVER, NEVER, NEVER)  # ticks at which they were received,
        self._torques_tick = NEVER  # and that at which all four came at once
        # a wheel that follows a current or a speed has that in place of its torque
        self._modes = ALL_TORQUE
        self._has_modes = False  # one that is not TORQUE among them
        # the last setpoint by mode and wheel
        self._setpoints = {CURRENT: [0.0, 0.0, 0.0, 0.0], SPEED: [0.0, 0.0, 0.0, 0.0]}
        self._setpoint_ticks = {CURRENT: [NEVER] * 4, SPEED: [NEVER] * 4}  # and when it came
        self._delay: deque[tuple[Status4, Torques]] = deque([(ALL_TORQUE, NO_TORQUE)] * config.command_latency_ticks)
        self._nodes = WheelNodes(plant, self.heartbeat_ticks, tick_s)
        self.begin()

    def begin(self) -> None:
        """Forget the frames of the meeting: the run's own count starts here."""
        self.counters = ChannelCounters()
        self._slow_counter = 0
        self._links = {can_id: Link(DECODERS[can_id]) for can_id in GROUP_IDS}
        self._links[HEARTBEAT_FSW_ID] = Link(DECODERS[HEARTBEAT_FSW_ID], self.heartbeat_ticks)
        for can_id in (*CURRENT_IDS, *SPEED_IDS, *CONTROL_IDS):
            self._links[can_id] = Link(DECODERS[can_id])
        self._group = LinkGroup([self._links[can_id] for can_id in GROUP_IDS])

    def count_rivals(self) -> int:
        """Frames so far that show a second sender of an id, over all ids."""
        return sum([link.rivals for link in self._links.values()])

    def list_rivals(self) -> list[int]:
        """The ids that more than one node sends."""
        return [can_id for can_id, link in self._links.items() if link.rivals]

    def heartbeat(self, state: int) -> bytes:
        """One heartbeat frame of the plant."""
        counter = self._slow_counter
        self._slow_counter = (counter + 1) % COUNTER_MODULUS
        return encode_HEARTBEAT_PLANT(counter, 0, state, self._run_hash)

    def announce(self) -> bytes:
        """Sample every unit at this tick; return its frames with SYNC last."""
        tick = self.tick
        sync_cnt = tick & 0xFF
        counter = tick % COUNTER_MODULUS
        samples = self.plant.sample()
        self.snapshot = self.plant.snapshot()
        self.events = samples.events
        a, b, c, d = samples.wheel_current_a
        current_ma = (a * 1e3, b * 1e3, c * 1e3, d * 1e3)
        wheels = encode_rw_tlms(counter, samples.wheel_status, samples.wheel_speed_rad_s, current_ma, sync_cnt)
        bank, nodes = self._bank, self._nodes
        if nodes.are_odd or bank.late_ticks != ON_TIME or bank.counter_frozen != NO_WHEEL:
            wheels = nodes.send_oddly(wheels, tick, samples.wheel_silent)
        elif True in samples.wheel_silent:
            wheels = _leave_out(wheels, samples.wheel_silent)
        fogs = encode_fogs(counter, samples.gyro_status, samples.gyro_rate_rad_s, sync_cnt)
        if True in samples.gyro_silent:
            fogs = _leave_out(fogs, samples.gyro_silent)
        extra = b"" if samples.star is None else self._star_frames(samples.star)
        if tick % self.heartbeat_ticks == 0:
            extra += self._slow_frames(tick)
        if tick >= nodes.next_tick:
            extra += nodes.report(tick, samples.wheel_silent)
        return wheels + fogs + extra + encode_SYNC(counter, 0, tick)

    def _star_frames(self, star: StarFrame) -> bytes:
        counter = self._star_counter
        self._star_counter = (counter + 1) % COUNTER_MODULUS
        q0, q1, q2, q3 = star.q_ib
        age_ticks = star.age_ticks
        return encode_STR_QA(counter, age_ticks, q0, q1) + encode_STR_QB(counter, age_ticks, q2, q3)

    def _slow_frames(self, tick: int) -> bytes:
        seconds, fraction = divmod(tick * self._tick_s, 1.0)
        counter = self._slow_counter
        return encode_TIME(counter, 0, int(seconds), fraction) + self.heartbeat(OPERATIONAL)

    def accept(self, batch: bytes) -> bool:
        """Take the frames that came in. True once CYCLE_DONE of the present tick is among them.

        A batch that is just what a cycle sends is taken at once; whatever differs from that in one bit, frame by frame.
        """
        usual, between = batch, b""
        if len(batch) != COMMANDS_SIZE:
            parts = part_group(batch, COMMANDS_SIZE, GROUP_IDS)
            if parts is None:
                return self._accept_each(batch)
            usual, between = parts
        a, b, c, d, sync_cnt, sync_b, sync_c, sync_d, done_tick = decode_commands(usual, self._group.expected)
        if done_tick < 0:
            return self._accept_each(batch)
        tick = self.tick
        if (tick - sync_cnt) & 0xFF > self._max_age_ticks or not sync_cnt == sync_b == sync_c == sync_d:
            return self._accept_each(batch)
        self._group.accept(usual, tick)
        self.counters.accepted += GROUP_SIZE
        self._torques_nm = (a, b, c, d)
        self._torques_tick = tick
        if self._has_modes:
            self._modes, self._has_modes = ALL_TORQUE, False
        self._end_cycle(done_tick)
        if between:
            self._take(between)
        return self.done_tick == tick

    def _accept_each(self, batch: bytes) -> bool:
        self._group.part()
        self._take(batch)
        self._group.join()
        return self.done_tick == self.tick

    def _take(self, batch: bytes) -> None:
        counters = self.counters
        for can_id, length, data in FRAME.iter_unpack(batch):
            link = self._links.get(can_id)
            if link is None:
                counters.foreign += 1
                continue
            values = link.accept(data if length == 8 else data[:length], self.tick)
            if values is None:
                counters.refused += 1
                if can_id == CYCLE_DONE_ID and link.outcome in (REPEATED, JUMP):
                    self._end_cycle_again(data)
                continue
            counters.accepted += 1
            if can_id == CYCLE_DONE_ID:
                self._end_cycle(values[2])
            elif can_id == HEARTBEAT_FSW_ID:
                self.fsw_state, self.fsw_run_hash = values[2], values[3]
            elif can_id in COMMAND_IDS:
                self._take_command(COMMAND_IDS[can_id], values)
            elif can_id in CONTROL_IDS:
                self._take_request(CONTROL_IDS[can_id], values)
            elif can_id in CURRENT_IDS:
                self._take_setpoint(CURRENT, CURRENT_IDS[can_id], values)
            else:
                self._take_setpoint(SPEED, SPEED_IDS[can_id], values)

    def _end_cycle(self, tick: int) -> None:
        if tick == self.tick:
            self.done_tick = tick
        else:
            self.counters.stray += 1

    def _end_cycle_again(self, data: bytes) -> None:
        """End the cycle with a frame that a stray one has put out of sequence: the tick in it is counter enough."""
        values = decode_CYCLE_DONE(data)
        if values is not None and values[2] == self.tick:
            self.done_tick = self.tick

    def _take_command(self, wheel: int, values: tuple[int | float, ...]) -> None:
        _, mode, torque_nm, sync_cnt = values
        if self._is_too_old(sync_cnt):
            return
        torques, ticks, modes = list(self._torques_nm), list(self._torque_ticks), list(self._modes)
        torques[wheel] = torque_nm if mode == TORQUE else 0.0
        ticks[wheel] = self.tick
        modes[wheel] = int(mode) if mode in (CURRENT, SPEED) else TORQUE
        self._torques_nm = (torques[0], torques[1], torques[2], torques[3])
        self._torque_ticks = (ticks[0], ticks[1], ticks[2], ticks[3])
        self._modes = (modes[0], modes[1], modes[2], modes[3])
        self._has_modes = self._modes != ALL_TORQUE

    def _take_setpoint(self, mode: int, wheel: int, values: tuple[int | float, ...]) -> None:
        _, _, setpoint, sync_cnt = values
        if not self._is_too_old(sync_cnt):
            self._setpoints[mode][wheel] = setpoint
            self._setpoint_ticks[mode][wheel] = self.tick

    def _take_request(self, wheel: int, values: tuple[int | float, ...]) -> None:
        _, action, mask, sync_cnt = values
        if not self._is_too_old(sync_cnt):
            self._nodes.obey(wheel, int(action), int(mask), self.tick)

    def _is_too_old(self, sync_cnt: int | float) -> bool:
        """Whether a command answers a tick too long ago, which is counted."""
        if (self.tick - int(sync_cnt)) & 0xFF <= self._max_age_ticks:
            return False
        self.counters.too_old += 1
        return True

    def advance(self) -> None:
        """Let the wheels act on their commands for one tick and move the truth to the next."""
        is_fresh = self._torques_tick == self.tick and not self._has_modes
        torques: Torques = self._torques_nm if is_fresh else self._hold_torques()
        if self._delay or self._has_modes or self._nodes.some_are_off:
            self._step_otherwise(torques)
        else:
            self.plant.step(torques)
        self.tick += 1

    def _step_otherwise(self, torques: Torques) -> None:
        """Step the plant where commands are late, of other modes, or for wheels without power."""
        modes = self._modes
        if self._delay:
            self._delay.append((modes, torques))
            modes, torques = self._delay.popleft()
        if self._nodes.some_are_off:
            torques = self._nodes.drop_commands(torques)
        self.plant.step(torques, None if modes == ALL_TORQUE else modes)

    def _hold_torques(self) -> Torques:
        """Return the last commands of the wheels, None for a wheel whose last one is too long ago."""
        oldest = self.tick - self._timeout_ticks
        a, b, c, d = (max(tick, self._torques_tick) for tick in self._torque_ticks)
        t1, t2, t3, t4 = self._torques_nm
        torques: Torques = (
            t1 if a > oldest else None,
            t2 if b > oldest else None,
            t3 if c > oldest else None,
            t4 if d > oldest else None,
        )
        if self._has_modes:
            torques = self._put_setpoints(torques, oldest)
        if None in torques:
            self.counters.timeouts += torques.count(None)
            for wheel, last in enumerate((a, b, c, d)):
                if torques[wheel] is None and last != NEVER:
                    self._nodes.latch_stale(wheel)
        return torques

    def _put_setpoints(self, torques: Torques, oldest: int) -> Torques:
        """Return these with the setpoint of each wheel that follows a current or a speed, None where it is too old."""
        found: list[float | None] = list(torques)
        for wheel, mode in enumerate(self._modes):
            if mode != TORQUE and found[wheel] is not None:
                is_fresh = self._setpoint_ticks[mode][wheel] > oldest
                found[wheel] = self._setpoints[mode][wheel] if is_fresh else None
        return (found[0], found[1], found[2], found[3])


def _leave_out(batch: bytes, silent: tuple[bool, ...]) -> bytes:
    return b"".join(batch[i * FRAME_SIZE : (i + 1) * FRAME_SIZE] for i, is_silent in enumerate(silent) if not is_silent)
