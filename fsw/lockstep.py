"""Lock-step: one cycle for every SYNC of the plant, as fast as the machine allows."""

from __future__ import annotations

import time
from struct import Struct

from bus.clock import PEER_TIMEOUT_S, QUIET_S
from bus.errors import PeerLostError
from bus.icd.codec import decode_SYNC
from bus.wire.frames import FRAME_SIZE
from bus.wire.transport import Transport
from fsw.flight import Flight
from fsw.flight_log import FlightLog
from fsw.handshake import plant_stopped
from fsw.inputs import SYNC_ID
from fsw.outputs import STATE_STOPPED

ID = Struct("=I")
SYNC_TAIL = ID.pack(SYNC_ID)


class LockStep:
    """Runs the flight software as the plant's SYNC frames ask for it."""

    def __init__(self, flight: Flight, transport: Transport, log: FlightLog) -> None:
        self._flight = flight
        self._transport = transport
        self._log = log
        self._expected = 0
        self._pending = b""

    def run(self) -> None:
        """Cycle until the plant says that it has stopped.

        Raises PeerLostError when the plant is silent for PEER_TIMEOUT_S, BusLostError when the bus goes away.
        """
        flight, transport = self._flight, self._transport
        counters = flight.executive
        while flight.inputs.plant_state != STATE_STOPPED:
            batch = self._take(transport.recv(QUIET_S) or self._wait_longer())
            if batch is None:
                continue
            started_ns = time.perf_counter_ns()
            tick = self._expected
            answer = flight.cycle(tick, batch)
            # Not including the sending: on one processor the plant does its work before it returns.
            cycle_ns = time.perf_counter_ns() - started_ns
            transport.send(answer)
            counters.last_cycle_ns = cycle_ns
            if cycle_ns > counters.max_cycle_ns:
                counters.max_cycle_ns = cycle_ns
            counters.cycles += 1
            self._log.write(tick)
            self._expected = tick + 1

    def _wait_longer(self) -> bytes:
        """The next frames after an empty read."""
        self._log.link.flush()
        until = time.monotonic() + PEER_TIMEOUT_S
        while (left_s := until - time.monotonic()) > 0:
            if batch := self._transport.recv(left_s):
                return batch
        raise PeerLostError(
            f"the plant has been silent for {PEER_TIMEOUT_S:g} s before SYNC of tick {self._expected}: it hangs or was "
            "stopped; look at its last output and start the run again"
        )

    def _take(self, batch: bytes) -> bytes | None:
        """All frames up to and with the expected SYNC, or None while it has not come.

        Whatever stands behind the SYNC waits for the next cycle. A stop of the plant is taken at once.
        """
        pending = self._pending + batch if self._pending else batch
        if pending[-FRAME_SIZE : 4 - FRAME_SIZE] == SYNC_TAIL and self._is_expected(pending[-8:]):
            self._pending = b""
            return pending
        for end in range(FRAME_SIZE, len(pending) + 1, FRAME_SIZE):
            if pending[end - FRAME_SIZE : end - FRAME_SIZE + 4] == SYNC_TAIL and self._is_expected(
                pending[end - 8 : end]
            ):
                self._pending = pending[end:]
                return pending[:end]
        self._pending = pending
        if plant_stopped(pending, self._flight.inputs.run_hash):
            self._flight.inputs.plant_state = STATE_STOPPED
        return None

    def _is_expected(self, data: bytes) -> bool:
        values = decode_SYNC(data)
        return values is not None and values[2] == self._expected
