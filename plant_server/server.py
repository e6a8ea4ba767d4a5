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
from struct import Struct

from bus.e2e import Link
from bus.icd_codec import (
    DECODERS,
    encode_fogs,
    encode_HEARTBEAT_PLANT,
    encode_rw_tlms,
    encode_STR_QA,
    encode_STR_QB,
    encode_SYNC,
    encode_TIME,
)
from plant_server.plant import Plant, Samples

FRAME = Struct("=IB3x8s")
FRAME_SIZE = FRAME.size
COUNTER_PERIOD = 15
COMMAND_IDS = {0x110: 0, 0x111: 1, 0x112: 2, 0x113: 3}
CYCLE_DONE_ID, HEARTBEAT_FSW_ID = 0x081, 0x702
STATE_STOPPED, STATE_OPERATIONAL, STATE_PRE_OPERATIONAL, STATE_FAILED = 4, 5, 127, 128
STAR_NOT_VALID = 15
HEARTBEAT_S = 1.0
Torques = tuple[float | None, float | None, float | None, float | None]  # None: no command
NO_TORQUE: Torques = (0.0, 0.0, 0.0, 0.0)


@dataclass(slots=True)
class ServerCounters:
    """Frames from the bus, by what became of them."""

    accepted: int = 0
    refused: int = 0  # length, checksum or alive counter wrong
    foreign: int = 0  # not for the plant
    too_old: int = 0  # a command whose SYNC_CNT is older than allowed
    timeouts: int = 0  # wheel-ticks without a fresh enough command


@dataclass(slots=True)
class Command:
    """The last command that one wheel took."""

    torque_nm: float = 0.0
    tick: int = -(10**9)  # tick at which it was received


class PlantServer:
    """A `Plant` behind CAN frames. Holds no socket and reads no clock."""

    def __init__(self, plant: Plant, tick_s: float, run_hash: int) -> None:
        self.plant = plant
        self.tick = 0
        self.fsw_state = -1
        self.fsw_run_hash = -1
        self.done_tick = -1  # tick of the last CYCLE_DONE
        self.samples: Samples | None = None
        self.truth: tuple[float, ...] = ()  # at the time of the samples
        self._run_hash = run_hash
        self._heartbeat_ticks = max(1, round(HEARTBEAT_S / tick_s))
        self._tick_s = tick_s
        self._star_counter = 0
        config = plant.config
        self._timeout_ticks = config.command_timeout_ticks
        self._max_age_ticks = config.command_max_age_ticks
        self._commands = [Command() for _ in COMMAND_IDS]
        self._delay: deque[Torques] = deque([NO_TORQUE] * config.command_latency_ticks)
        self.begin()

    def begin(self) -> None:
        """Forget the frames of the meeting: the run's own count starts here."""
        self.counters = ServerCounters()
        self._slow_counter = 0
        self._links = {can_id: Link(DECODERS[can_id]) for can_id in (*COMMAND_IDS, CYCLE_DONE_ID, HEARTBEAT_FSW_ID)}

    def heartbeat(self, state: int) -> bytes:
        """One heartbeat frame of the plant."""
        counter = self._slow_counter
        self._slow_counter = (counter + 1) % COUNTER_PERIOD
        return encode_HEARTBEAT_PLANT(counter, 0, state, self._run_hash)

    def announce(self) -> bytes:
        """Sample every unit at this tick; return its frames with SYNC last."""
        tick = self.tick
        sync_cnt = tick & 0xFF
        counter = tick % COUNTER_PERIOD
        self.samples = samples = self.plant.sample()
        self.truth = self.plant.truth()
        a, b, c, d = samples.wheel_current_a
        current_ma = (a * 1e3, b * 1e3, c * 1e3, d * 1e3)
        wheels = encode_rw_tlms(counter, samples.wheel_status, samples.wheel_speed_rad_s, current_ma, sync_cnt)
        fogs = encode_fogs(counter, samples.gyro_status, samples.gyro_rate_rad_s, sync_cnt)
        if samples.any_silent:
            wheels = _leave_out(wheels, samples.wheel_silent)
            fogs = _leave_out(fogs, samples.gyro_silent)
        batch = wheels + fogs
        if samples.star is not None:
            batch += self._star_frames(samples)
        if tick % self._heartbeat_ticks == 0:
            batch += self._slow_frames(tick)
        return batch + encode_SYNC(counter, 0, tick)

    def _star_frames(self, samples: Samples) -> bytes:
        counter = self._star_counter
        self._star_counter = (counter + 1) % COUNTER_PERIOD
        assert samples.star is not None
        q, age_ticks = samples.star
        return encode_STR_QA(counter, age_ticks, q[0], q[1]) + encode_STR_QB(counter, age_ticks, q[2], q[3])

    def _slow_frames(self, tick: int) -> bytes:
        seconds, fraction = divmod(tick * self._tick_s, 1.0)
        counter = self._slow_counter
        return encode_TIME(counter, 0, int(seconds), fraction) + self.heartbeat(STATE_OPERATIONAL)

    def accept(self, batch: bytes) -> bool:
        """Take the frames that came in. True once CYCLE_DONE of the present tick is among them."""
        counters = self.counters
        for can_id, length, data in FRAME.iter_unpack(batch):
            link = self._links.get(can_id)
            if link is None:
                counters.foreign += 1
                continue
            values = link.accept(data if length == 8 else data[:length])
            if values is None:
                counters.refused += 1
                continue
            counters.accepted += 1
            if can_id == CYCLE_DONE_ID:
                self.done_tick = values[2]
            elif can_id == HEARTBEAT_FSW_ID:
                self.fsw_state, self.fsw_run_hash = values[2], values[3]
            else:
                self._take_command(COMMAND_IDS[can_id], values)
        return self.done_tick == self.tick

    def _take_command(self, wheel: int, values: tuple[int | float, ...]) -> None:
        _, mode, torque_nm, sync_cnt = values
        if (self.tick - int(sync_cnt)) & 0xFF > self._max_age_ticks:
            self.counters.too_old += 1
            return
        command = self._commands[wheel]
        command.torque_nm = torque_nm if mode == 1 else 0.0
        command.tick = self.tick

    def advance(self) -> None:
        """Let the wheels act on their commands for one tick and move the truth to the next."""
        oldest = self.tick - self._timeout_ticks
        a, b, c, d = self._commands
        torques: Torques = (
            a.torque_nm if a.tick > oldest else None,
            b.torque_nm if b.tick > oldest else None,
            c.torque_nm if c.tick > oldest else None,
            d.torque_nm if d.tick > oldest else None,
        )
        if None in torques:
            self.counters.timeouts += torques.count(None)
        if self._delay:
            self._delay.append(torques)
            torques = self._delay.popleft()
        self.plant.step(torques)
        self.tick += 1


def _leave_out(batch: bytes, silent: tuple[bool, ...]) -> bytes:
    return b"".join(batch[i * FRAME_SIZE : (i + 1) * FRAME_SIZE] for i, is_silent in enumerate(silent) if not is_silent)
