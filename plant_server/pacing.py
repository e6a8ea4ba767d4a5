"""When a tick of the plant ends: the clocks, each as one function that exchanges frames for the node.

Lock-step waits for the flight software, real time for its deadline; in process, whoever holds both sides passes a function
of his own.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from bus.clock import PEER_TIMEOUT_S, QUIET_S, MonotonicClock
from bus.errors import DeadlineError, PeerLostError
from bus.wire.frames import FRAME_ID
from bus.wire.transport import Transport
from plant_server.channel import CYCLE_DONE_ID
from plant_server.plant_log import PlantLog

Accept = Callable[[bytes], bool]  # hands frames to the plant; True once CYCLE_DONE of the present tick is among them
Exchange = Callable[[bytes, Accept], bytes]  # sends the announced frames, hands in what comes until the tick may end,
# and returns all of that in order

MAX_LATENESS_S: Final = 2.0  # past this, physics and wall clock have parted and a real-time run is void


class LockStep:
    """The plant goes on as soon as the flight software has ended its cycle."""

    def __init__(self, transport: Transport, clock: MonotonicClock, log: PlantLog) -> None:
        """log : is told of arrivals, and lets go of what it holds back before a wait that may be long."""
        self._transport = transport
        self._clock = clock
        self._log = log
        self._tick = 0

    def exchange(self, frames: bytes, accept: Accept) -> bytes:
        """Send the frames and wait for the end of the cycle.

        Raises PeerLostError when the flight software leaves the bus or does not end its cycle for PEER_TIMEOUT_S.
        """
        transport = self._transport
        transport.send(frames)
        received = transport.recv(QUIET_S)
        self._log.note_arrival(received, transport)
        if not (received and accept(received)):
            received += self._wait_longer(accept)
        self._tick += 1
        return received

    def _wait_longer(self, accept: Accept) -> bytes:
        transport, clock = self._transport, self._clock
        self._log.link.flush()
        received = b""
        until_ns = clock.now_ns() + round(PEER_TIMEOUT_S * 1e9)
        while True:
            if "fsw" in transport.departed:
                raise PeerLostError(
                    f"the flight software left the bus at tick {self._tick}: its process ended or was killed"
                )
            left_ns = until_ns - clock.now_ns()
            if left_ns <= 0:
                raise PeerLostError(
                    f"the flight software has not ended its cycle of tick {self._tick} for {PEER_TIMEOUT_S:g} s: it hangs "
                    "or was stopped"
                )
            batch = transport.recv(left_ns * 1e-9)
            self._log.note_arrival(batch, transport)
            received += batch
            if batch and accept(batch):
                return received


class RealTime:
    """The plant goes on at absolute deadlines, whatever the flight software does.

    The truth never skips a tick: a late plant runs the missed ticks back to back and counts them as slips.
    """

    def __init__(self, transport: Transport, clock: MonotonicClock, period_ns: int, log: PlantLog) -> None:
        self._transport = transport
        self._clock = clock
        self._period_ns = period_ns
        self._log = log
        self._tick = 0
        self._deadline_ns = -1  # of the present tick; the first one sets it
        self._heard_ns = 0  # when the flight software last ended a cycle
        self.slips = 0
        self.max_lateness_ns = 0

    def exchange(self, frames: bytes, accept: Accept) -> bytes:
        """Send the frames and collect what comes until the deadline; waiting also lets an embedded hub do its work.

        Raises DeadlineError when it is MAX_LATENESS_S behind, PeerLostError when the flight software leaves the bus or
        ends no cycle for PEER_TIMEOUT_S.
        """
        clock = self._clock
        if self._deadline_ns < 0:
            self._deadline_ns = self._heard_ns = clock.now_ns()
        self._deadline_ns += self._period_ns
        self._transport.send(frames)
        received = b""
        while (left_ns := self._deadline_ns - clock.now_ns()) > 0:
            received += self._receive(left_ns * 1e-9)
        received += self._receive(0.0)
        self._count_lateness(-left_ns)
        self._judge_silence(received)
        accept(received)
        self._tick += 1
        return received

    def _count_lateness(self, lateness_ns: int) -> None:
        self.max_lateness_ns = max(self.max_lateness_ns, lateness_ns)
        if lateness_ns < self._period_ns:
            return
        self.slips += 1
        if lateness_ns > MAX_LATENESS_S * 1e9:
            raise DeadlineError(
                f"the plant is {lateness_ns / 1e9:.1f} s behind real time at tick {self._tick} (limit "
                f"{MAX_LATENESS_S:g} s): lower clock.tick_hz or free the machine"
            )

    def _judge_silence(self, received: bytes) -> None:
        now_ns = self._clock.now_ns()
        if any(can_id == CYCLE_DONE_ID for (can_id,) in FRAME_ID.iter_unpack(received)):
            self._heard_ns = now_ns
        elif "fsw" in self._transport.departed:
            raise PeerLostError(
                f"the flight software left the bus at tick {self._tick}: its process ended or was killed"
            )
        elif now_ns - self._heard_ns > PEER_TIMEOUT_S * 1e9:
            raise PeerLostError(
                f"the flight software has not ended a cycle for {PEER_TIMEOUT_S:g} s at tick {self._tick}: it hangs or was "
                "stopped; the wheels went to rest meanwhile"
            )

    def _receive(self, timeout_s: float) -> bytes:
        batch = self._transport.recv(timeout_s)
        self._log.note_arrival(batch, self._transport)
        return batch
