"""Lock-step: the plant is the master of the tick. It samples, says SYNC, and waits for the flight software's answer."""

from __future__ import annotations

import time
from collections.abc import Callable

from bus.clock import PEER_TIMEOUT_S, QUIET_S
from bus.errors import PeerLostError
from bus.wire.transport import Transport
from plant_server.channel import PlantServer
from plant_server.plant_log import PlantLog


class LockStep:
    """Runs the plant as fast as the flight software answers."""

    def __init__(
        self, server: PlantServer, transport: Transport, log: PlantLog, progress: Callable[[int], None]
    ) -> None:
        self._server = server
        self._transport = transport
        self._log = log
        self._progress = progress

    def run(self, ticks: int) -> None:
        """Run that many ticks.

        Raises PeerLostError when the flight software leaves the bus or is silent for PEER_TIMEOUT_S.
        """
        server, transport, log = self._server, self._transport, self._log
        for tick in range(ticks):
            frames = server.announce()
            transport.send(frames)
            frames += self._wait_for_answer(tick)
            log.write(frames)
            server.advance()
            self._progress(tick)

    def _wait_for_answer(self, tick: int) -> bytes:
        server, transport = self._server, self._transport
        received = transport.recv(QUIET_S)
        self._log.note_arrival(received, transport)
        if received and server.accept(received):
            return received
        self._log.link.flush()
        until = time.monotonic() + PEER_TIMEOUT_S
        while True:
            if "fsw" in transport.departed:
                raise PeerLostError(f"the flight software left the bus at tick {tick}: its process ended or was killed")
            left_s = until - time.monotonic()
            if left_s <= 0:
                raise PeerLostError(
                    f"the flight software has not ended its cycle of tick {tick} for {PEER_TIMEOUT_S:g} s: it hangs or "
                    "was stopped"
                )
            batch = transport.recv(left_s)
            self._log.note_arrival(batch, transport)
            received += batch
            if batch and server.accept(batch):
                return received
