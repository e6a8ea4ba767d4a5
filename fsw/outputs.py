"""Send: wheel commands, the end-of-cycle frame and the heartbeat, each with its own alive counter."""

from __future__ import annotations

from bus.icd.batches import encode_CYCLE_DONE, encode_rw_cmds
from bus.icd.codec import encode_HEARTBEAT_FSW
from bus.icd.e2e import COUNTER_MODULUS
from bus.icd.heartbeat import OPERATIONAL
from fsw.records import WheelCommands


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

    def heartbeat(self, state: int) -> bytes:
        """One heartbeat frame."""
        counter = self._heartbeat_counter
        self._heartbeat_counter = (counter + 1) % COUNTER_MODULUS
        return encode_HEARTBEAT_FSW(counter, 0, state, self._run_hash)

    def commands(self, tick: int, sync_cnt: int, wheels: WheelCommands, mode: int, slips: int) -> bytes:
        """The frames of one cycle: four wheel commands, a heartbeat when due, and CYCLE_DONE last.

        sync_cnt : tick counter of the sensor data the commands are based on, modulo 256
        """
        counter = self._cycle_counter
        self._cycle_counter = (counter + 1) % COUNTER_MODULUS
        batch = encode_rw_cmds(counter, wheels.modes, wheels.tau_rw_nm, sync_cnt)
        if tick % self._heartbeat_ticks == 0:
            batch += self.heartbeat(OPERATIONAL)
        return batch + encode_CYCLE_DONE(counter, mode, tick, slips)  # more slips than fit are sent as 0xFFFF
