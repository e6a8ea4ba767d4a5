"""Real time: the plant advances on absolute deadlines, whatever the flight software does.

The truth never skips a tick: a late plant runs the missed ticks back to back and counts them as slips.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from bus.errors import DeadlineError
from bus.wire.transport import Transport
from plant_server.channel import PlantServer
from plant_server.plant_log import PlantLog

MAX_LATENESS_S = 2.0  # past this, physics and wall clock have parted and the run is void


class RealTime:
    """Runs the plant on the monotonic clock."""

    def __init__(
        self, server: PlantServer, transport: Transport, log: PlantLog, progress: Callable[[int], None], period_ns: int
    ) -> None:
        self._server = server
        self._transport = transport
        self._log = log
        self._progress = progress
        self._period_ns = period_ns
        self.slips = 0
        self.max_lateness_ns = 0

    def run(self, ticks: int) -> None:
        """Run that many ticks, one a period. Raises DeadlineError when it falls MAX_LATENESS_S behind."""
        server, transport, log = self._server, self._transport, self._log
        epoch_ns = time.monotonic_ns()
        for tick in range(ticks):
            sent = server.announce()
            transport.send(sent)
            received = self._serve_until(epoch_ns + (tick + 1) * self._period_ns)
            server.accept(received)
            log.write(sent + received)
            server.advance()
            self._progress(tick)

    def _serve_until(self, deadline_ns: int) -> bytes:
        """Collect frames until the deadline; waiting on the bus also lets an embedded hub do its work."""
        received = b""
        while (left_ns := deadline_ns - time.monotonic_ns()) > 0:
            received += self._receive(left_ns * 1e-9)
        received += self._receive(0.0)
        lateness_ns = -left_ns
        if lateness_ns > self.max_lateness_ns:
            self.max_lateness_ns = lateness_ns
        if lateness_ns >= self._period_ns:
            self.slips += 1
            if lateness_ns > MAX_LATENESS_S * 1e9:
                raise DeadlineError(
                    f"the plant is {lateness_ns / 1e9:.1f} s behind real time at tick {self._server.tick} (limit "
                    f"{MAX_LATENESS_S:g} s): lower clock.tick_hz or free the machine"
                )
        return received

    def _receive(self, timeout_s: float) -> bytes:
        batch = self._transport.recv(timeout_s)
        self._log.note_arrival(batch, self._transport)
        return batch
