"""Real time: cycles on absolute deadlines of the monotonic clock. Nobody waits for anybody."""

from __future__ import annotations

from bus.clock import PEER_TIMEOUT_S, SystemClock
from bus.errors import PeerLostError
from bus.wire.transport import Transport
from fsw.executive import Executive, Watchdog
from fsw.flight import Flight
from fsw.flight_log import FlightLog
from fsw.handshake import plant_stopped
from fsw.outputs import STATE_STOPPED


class RealTime:
    """Runs the flight software at its own fixed rate on whatever has arrived."""

    def __init__(
        self, flight: Flight, executive: Executive, watchdog: Watchdog, transport: Transport, log: FlightLog
    ) -> None:
        self._flight = flight
        self._executive = executive
        self._watchdog = watchdog
        self._transport = transport
        self._log = log
        flight.executive = executive.counters

    def run(self) -> None:
        """Cycle until the plant says that it has stopped.

        The first cycle comes half a period after the first frames of the plant, so that the two sides stay out of each
        other's way. Raises PeerLostError after PEER_TIMEOUT_S of silence, DeadlineError when slips do not end or one cycle
        never does.
        """
        with self._watchdog.guard():
            self._cycle()

    def _cycle(self) -> None:
        flight, executive, transport = self._flight, self._executive, self._transport
        clock = SystemClock()
        batch = transport.recv(PEER_TIMEOUT_S)
        if not batch:
            raise self._lost(0)
        executive.start(clock.now_ns() + executive.period_ns // 2)
        last_heard_ns = clock.now_ns()
        while flight.inputs.plant_state != STATE_STOPPED:
            tick = executive.wait()
            self._watchdog.feed()
            arrived = transport.recv(0.0)
            batch += arrived
            if arrived:
                last_heard_ns = clock.now_ns()
                if plant_stopped(arrived, flight.inputs.run_hash):
                    break
            elif clock.now_ns() - last_heard_ns > PEER_TIMEOUT_S * 1e9:
                raise self._lost(tick)
            flight.safe_requested = executive.safe_requested
            executive.safe_requested = False
            transport.send(flight.cycle(tick, batch))
            batch = b""
            if not executive.degraded:
                self._log.write(tick)
            executive.done()

    def _lost(self, tick: int) -> PeerLostError:
        return PeerLostError(
            f"the plant has been silent for {PEER_TIMEOUT_S:g} s at tick {tick} on {self._transport.address}: it hangs or "
            "was stopped; the wheels were commanded to damp or rest (safe mode) meanwhile"
        )
