"""Send: wheel commands, the end-of-cycle frame and the heartbeat, each with its own alive counter."""

from __future__ import annotations

from typing import Final

from bus.icd.batches import encode_CYCLE_DONE, encode_rw_cmds
from bus.icd.codec import ENCODERS, encode_HEARTBEAT_FSW
from bus.icd.e2e import COUNTER_MODULUS, NEXT_COUNTER
from bus.icd.heartbeat import OPERATIONAL
from bus.wheels import ACTIONS, ALL_BITS, CURRENT, SPEED
from fsw.records import WheelCommands

CONTROL_IDS = (0x300, 0x301, 0x302, 0x303)
SETPOINT_IDS = {CURRENT: (0x120, 0x121, 0x122, 0x123), SPEED: (0x130, 0x131, 0x132, 0x133)}
NO_SETPOINT: Final = 0


class Outputs:
    """Encodes what the flight software says on the bus."""

    def __init__(self, run_hash: int, heartbeat_ticks: int) -> None:
        self._run_hash = run_hash
        self._heartbeat_ticks = heartbeat_ticks
        self.reset()

    def reset(self) -> None:
        """Counters back to where they are after boot."""
        self._cycle_counter = 0
        self._heartbeat_counter = 0
        self._counters = {can_id: 0 for ids in (CONTROL_IDS, *SETPOINT_IDS.values()) for can_id in ids}
        self._requests: dict[tuple[int, int], int] = {}  # that wait: wheel and action, in the order asked for -> mask
        self.last_request = (0, 0, 0)  # that was sent: wheel, action, mask
        self.requests_sent = 0
        self._modes = [NO_SETPOINT] * 4  # CURRENT or SPEED, of the wheels that follow one
        self._setpoints = [0.0] * 4
        self._has_setpoints = False

    def heartbeat(self, state: int) -> bytes:
        """One heartbeat frame."""
        counter = self._heartbeat_counter
        self._heartbeat_counter = (counter + 1) % COUNTER_MODULUS
        return encode_HEARTBEAT_FSW(counter, 0, state, self._run_hash)

    def control_wheel(self, wheel: int, action: int, mask: int = 0) -> None:
        """Ask a wheel for something beside its commands: goes out with the next cycle that has no other request to send.

        wheel  : 0 .. 3
        action : one of bus/wheels.py: CLEAR_LATCH, RESET, POWER_OFF, POWER_ON, POWER_CYCLE
        mask   : bits of the latch that CLEAR_LATCH clears
        What waits already is not asked for twice; the masks of two CLEAR_LATCH are joined.
        Raises ValueError for a wheel or an action that there is not.
        """
        if not 0 <= wheel <= 3 or action not in ACTIONS:
            raise ValueError(
                f"wheel {wheel} (0..3), action {action} ({', '.join(map(str, ACTIONS))}) cannot be asked for"
            )
        self._requests[wheel, action] = (self._requests.get((wheel, action), 0) | mask) & ALL_BITS

    def follow_current(self, wheel: int, current_a: float) -> None:
        """Let a wheel (0 .. 3) follow a motor current [A], positive with the torque on the body, until told otherwise.

        Its torque command is not looked at meanwhile: whoever asks for this keeps the allocator off the wheel.
        """
        self._follow(wheel, CURRENT, current_a)

    def follow_speed(self, wheel: int, speed_rad_s: float) -> None:
        """Let a wheel (0 .. 3) hold a rotor speed relative to the body [rad/s]; else as `follow_current`."""
        self._follow(wheel, SPEED, speed_rad_s)

    def follow_torque(self, wheel: int) -> None:
        """Let a wheel follow its torque command again."""
        self._follow(wheel, NO_SETPOINT, 0.0)

    def _follow(self, wheel: int, mode: int, setpoint: float) -> None:
        self._modes[wheel], self._setpoints[wheel] = mode, setpoint
        self._has_setpoints = self._modes != [NO_SETPOINT] * 4

    def _encode_setpoints(self, counter: int, wheels: WheelCommands, sync_cnt: int) -> bytes:
        """The commands with the modes of the wheels that follow a setpoint, and those setpoints."""
        a, b, c, d = [own or mode for own, mode in zip(self._modes, wheels.modes, strict=True)]
        batch = encode_rw_cmds(counter, (a, b, c, d), wheels.tau_rw_nm, sync_cnt)
        for wheel, mode in enumerate(self._modes):
            if mode != NO_SETPOINT:
                can_id = SETPOINT_IDS[mode][wheel]
                batch += ENCODERS[can_id](self._count(can_id), 0, self._setpoints[wheel], sync_cnt)
        return batch

    def _encode_request(self, sync_cnt: int) -> bytes:
        """The frame of the request that has waited longest."""
        wheel, action = next(iter(self._requests))
        mask = self._requests.pop((wheel, action))
        self.last_request = (wheel, action, mask)
        self.requests_sent += 1
        can_id = CONTROL_IDS[wheel]
        return ENCODERS[can_id](self._count(can_id), action, mask, sync_cnt)

    def _count(self, can_id: int) -> int:
        """The alive counter of the next frame of an id."""
        counter = self._counters[can_id]
        self._counters[can_id] = NEXT_COUNTER[counter]
        return counter

    def commands(self, tick: int, sync_cnt: int, wheels: WheelCommands, mode: int, slips: int) -> bytes:
        """The frames of one cycle: four wheel commands, setpoints and a request where there are any, a heartbeat when due,
        and CYCLE_DONE last.

        sync_cnt : tick counter of the sensor data the commands are based on, modulo 256
        """
        counter = self._cycle_counter
        self._cycle_counter = (counter + 1) % COUNTER_MODULUS
        if self._has_setpoints:
            batch = self._encode_setpoints(counter, wheels, sync_cnt)
        else:
            batch = encode_rw_cmds(counter, wheels.modes, wheels.tau_rw_nm, sync_cnt)
        if self._requests:
            batch += self._encode_request(sync_cnt)
        if tick % self._heartbeat_ticks == 0:
            batch += self.heartbeat(OPERATIONAL)
        return batch + encode_CYCLE_DONE(counter, mode, tick, slips)  # more slips than fit are sent as 0xFFFF
