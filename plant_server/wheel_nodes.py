"""The electronics of the four wheels as nodes on the bus: slow telemetry, requests, and frames that go out oddly."""

from __future__ import annotations

from collections import deque
from typing import Final

from bus.icd.codec import DECODERS, ENCODERS
from bus.icd.e2e import COUNTER_MODULUS, NEXT_COUNTER
from bus.wheels import ALL_BITS, CLEAR_LATCH, COMMAND_STALE, POWER_CYCLE, POWER_OFF, POWER_ON, RESET
from bus.wire.frames import FRAME_SIZE
from plant_server.plant import Plant
from plant_server.wheels.bank import NO_WHEEL, ON_TIME, Flags4

TLM_IDS = (0x190, 0x191, 0x192, 0x193)
TEMP_IDS = (0x290, 0x291, 0x292, 0x293)
POWER_IDS = (0x390, 0x391, 0x392, 0x393)
WHEEL_COUNT: Final = 4
SLOTS: Final = 2 * WHEEL_COUNT  # of the frames of slow telemetry, spread over their period
MOST_UPTIME_S: Final = 0xFFFF
AT_NO_TICK: Final = 1 << 62
Torques = tuple[float | None, float | None, float | None, float | None]  # None: no command


class WheelNodes:
    """What the nodes of the wheels do beside fast telemetry and commands, tick by tick."""

    __slots__ = (
        "_bank", "_counters", "_frozen", "_off", "_period_ticks", "_plant", "_queues", "_slots", "_stale", "_started",
        "_tick_s", "are_odd", "next_tick", "some_are_off",
    )  # fmt: skip

    def __init__(self, plant: Plant, period_ticks: int, tick_s: float) -> None:
        """period_ticks : of slow telemetry"""
        self._plant = plant
        self._bank = plant.wheels
        self._period_ticks = period_ticks
        self._tick_s = tick_s
        self._slots = [  # phase in the period, wheel, kind (0 RWi_TEMP, 1 RWi_POWER)
            ((2 * wheel + kind) * period_ticks // SLOTS, wheel, kind)
            for wheel in range(WHEEL_COUNT)
            if self._bank.has_slow_telemetry[wheel]
            for kind in (0, 1)
        ]
        self._counters = [0] * SLOTS  # alive counters of the frames of slow telemetry
        self._started = [0] * WHEEL_COUNT  # tick of the last reset or switching on
        self._stale = [0] * WHEEL_COUNT  # COMMAND_STALE, where latched
        self._off = [False] * WHEEL_COUNT
        self._queues: list[deque[bytes]] = [deque() for _ in range(WHEEL_COUNT)]  # frames that are late
        self._frozen = [-1] * WHEEL_COUNT  # the alive counter that stands
        self.some_are_off = False
        self.are_odd = False  # frames are kept back or counters stand
        self.next_tick = 0 if self._slots else AT_NO_TICK  # of slow telemetry

    # -- slow telemetry ------------------------------------------------------------------------------------------------

    def report(self, tick: int, silent: Flags4) -> bytes:
        """Return the frames of slow telemetry that are due on this tick; a wheel that is silent or off sends none."""
        batch, period = b"", self._period_ticks
        for phase, wheel, kind in self._slots:
            if (tick - phase) % period == 0 and not (silent[wheel] or self._off[wheel]):
                batch += self._encode(tick, wheel, kind)
        self.next_tick = min([tick + 1 + (phase - tick - 1) % period for phase, _, _ in self._slots])
        return batch

    def _encode(self, tick: int, wheel: int, kind: int) -> bytes:
        bank, slot = self._bank, 2 * wheel + kind
        counter = self._counters[slot]
        if bank.counter_frozen[wheel]:
            counter = (counter - 1) % COUNTER_MODULUS
        else:
            self._counters[slot] = NEXT_COUNTER[counter]
        if kind == 0:
            return ENCODERS[TEMP_IDS[wheel]](counter, 0, bank.temperature_c[wheel], bank.ambient_c, bank.bus_v * 1e3)
        latch = (bank.latch[wheel] | self._stale[wheel]) & ALL_BITS
        uptime_s = min(MOST_UPTIME_S, int((tick - self._started[wheel]) * self._tick_s))
        return ENCODERS[POWER_IDS[wheel]](counter, 0, bank.bus_current_a[wheel] * 1e3, latch, uptime_s)

    # -- requests ------------------------------------------------------------------------------------------------------

    def obey(self, wheel: int, action: int, mask: int, tick: int) -> None:
        """Do what a request asks of a wheel; a number that stands for nothing does nothing."""
        if action == CLEAR_LATCH:
            self._stale[wheel] &= ~mask
            self._plant.clear_latch(wheel, mask)
            return
        if action == RESET:
            self._plant.reset_wheel(wheel)
        elif action in (POWER_OFF, POWER_ON):
            if action == POWER_ON and not self._off[wheel]:
                return
            self._off[wheel] = action == POWER_OFF
            self._plant.set_wheel_power(wheel, action == POWER_ON)
        elif action == POWER_CYCLE:
            self._off[wheel] = False
            self._plant.power_cycle_wheel(wheel)
        else:
            return
        self.some_are_off = True in self._off
        self._stale[wheel] = 0
        self._started[wheel] = tick

    def drop_commands(self, commands: Torques) -> Torques:
        """Return these commands without those of wheels that are off."""
        a, b, c, d = commands
        p, q, r, s = self._off
        return (None if p else a, None if q else b, None if r else c, None if s else d)

    def latch_stale(self, wheel: int) -> None:
        """Note that a wheel has no fresh command."""
        if not self._off[wheel]:
            self._stale[wheel] = COMMAND_STALE

    # -- fast telemetry that goes out oddly ----------------------------------------------------------------------------

    def send_oddly(self, batch: bytes, tick: int, silent: Flags4) -> bytes:
        """Return the frames that go out in place of the four that are due: none of a silent wheel, late ones, and ones with
        a counter that stands.

        A wheel that becomes late by n ticks sends nothing for n ticks, and then what was due n ticks ago; one that is no
        longer late drops what it has kept back.
        """
        bank, sent = self._bank, b""
        late_ticks, frozen = bank.late_ticks, bank.counter_frozen
        for wheel in range(WHEEL_COUNT):
            at = wheel * FRAME_SIZE
            end = at + FRAME_SIZE
            frame = batch[at:end]
            if frozen[wheel]:
                frame = self._freeze(wheel, frame, tick)
            else:
                self._frozen[wheel] = -1
            if silent[wheel]:
                frame = b""
            late, queue = late_ticks[wheel], self._queues[wheel]
            if late > 0:
                queue.append(frame)
                frame = queue.popleft() if len(queue) > late else b""
                while len(queue) > late:
                    queue.popleft()
            else:
                queue.clear()
            if not silent[wheel]:
                sent += frame
        self.are_odd = late_ticks != ON_TIME or frozen != NO_WHEEL
        return sent

    def _freeze(self, wheel: int, frame: bytes, tick: int) -> bytes:
        """Return the frame with the counter of the last one that was sent before it stood."""
        if self._frozen[wheel] < 0:
            self._frozen[wheel] = (tick - 1) % COUNTER_MODULUS
        can_id = TLM_IDS[wheel]
        values = DECODERS[can_id](frame[8:])
        if values is None:  # cannot be: it was encoded just now
            return frame
        return ENCODERS[can_id](self._frozen[wheel], *values[1:])
