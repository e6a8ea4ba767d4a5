"""When the flight software runs its next cycle: at the plant's word in lock-step, on absolute deadlines in real time."""

from __future__ import annotations

from typing import Final

from bus.clock import PEER_TIMEOUT_S, QUIET_S, MonotonicClock
from bus.errors import PeerLostError
from bus.icd.codec import decode_SYNC
from bus.wire.frames import FRAME_ID, FRAME_SIZE
from bus.wire.transport import Transport
from fsw.executive import Executive, Watchdog
from fsw.handshake import plant_stopped
from fsw.inputs import SYNC_ID
from fsw.node import FswNode

SYNC_TAIL = SYNC_ID.to_bytes(4, "little")
END_SLACK_TICKS: Final = 5  # real time: the plant's clock may be ahead of ours by as much when it ends
OVERRUN_WORDS_S: Final = 1.0  # a line about missed deadlines at most this often


class LockStep:
    """One cycle for every SYNC of the plant, as fast as the machine allows."""

    def __init__(self, node: FswNode, transport: Transport, clock: MonotonicClock, ticks: int) -> None:
        """ticks: of the whole run; the plant is expected to stop after them."""
        self._node = node
        self._transport = transport
        self._clock = clock
        self._ticks = ticks
        self._expected = 0
        self._pending = b""
        self._stopped = False  # the plant has said so

    def run(self) -> None:
        """Cycle until the plant stops after the last tick.

        Raises PeerLostError when it stops or falls silent before that, BusLostError when the bus goes away.
        """
        node, transport = self._node, self._transport
        send = transport.send
        while not (self._stopped and self._expected >= self._ticks):
            batch = self._take(transport.recv(QUIET_S) or self._wait_longer())
            if batch is not None:
                node.tick(self._expected, batch, send)
                self._expected += 1

    def _wait_longer(self) -> bytes:
        """The next frames after an empty read."""
        self._node.log.link.flush()
        if self._stopped:  # and nothing has come since: it meant it
            raise PeerLostError(
                f"the plant stopped before tick {self._expected} of {self._ticks}: look at its last output"
            )
        if "plant" in self._transport.departed:
            raise PeerLostError(
                f"the plant left the bus before SYNC of tick {self._expected}: its process ended or was killed"
            )
        until_ns = self._clock.now_ns() + int(PEER_TIMEOUT_S * 1e9)
        while (left_ns := until_ns - self._clock.now_ns()) > 0:
            if batch := self._transport.recv(left_ns * 1e-9):
                return batch
        raise PeerLostError(
            f"the plant has been silent for {PEER_TIMEOUT_S:g} s before SYNC of tick {self._expected}: it hangs or was "
            "stopped; look at its last output and start the run again"
        )

    def _take(self, batch: bytes) -> bytes | None:
        """All frames up to and with the expected SYNC, or None while it has not come.

        Whatever stands behind the SYNC waits for the next cycle. That the plant has stopped is noted at once, and forgotten
        when it goes on: one frame of anybody does not end a run.
        """
        pending = self._pending + batch if self._pending else batch
        if pending[-FRAME_SIZE : 4 - FRAME_SIZE] == SYNC_TAIL and self._is_expected(pending[-8:]):
            self._pending = b""
            self._stopped = False
            return pending
        for end in range(FRAME_SIZE, len(pending) + 1, FRAME_SIZE):
            if pending[end - FRAME_SIZE : end - FRAME_SIZE + 4] == SYNC_TAIL and self._is_expected(
                pending[end - 8 : end]
            ):
                self._pending = pending[end:]
                self._stopped = False
                return pending[:end]
        self._pending = pending
        if plant_stopped(pending, self._node.flight.run_hash):
            self._stopped = True
        return None

    def _is_expected(self, data: bytes) -> bool:
        values = decode_SYNC(data)
        return values is not None and values[2] == self._expected


class RealTime:
    """Cycles on absolute deadlines of the monotonic clock, on whatever has arrived. Nobody waits for anybody."""

    def __init__(
        self,
        node: FswNode,
        executive: Executive,
        watchdog: Watchdog,
        transport: Transport,
        clock: MonotonicClock,
        ticks: int,
    ) -> None:
        """ticks: of the whole run; the plant is expected to stop after them."""
        self._node = node
        self._executive = executive
        self._watchdog = watchdog
        self._transport = transport
        self._clock = clock
        self._ticks = ticks
        self._heard_ns = 0  # when the plant last sent something
        self._said_ns = 0  # when the last line about missed deadlines was written
        self._slips_said = 0
        node.flight.executive = executive.counters

    def run(self) -> None:
        """Cycle until the plant stops after the last tick.

        The first cycle comes half a period after the first frames of the plant, so that the two sides stay out of each
        other's way. Raises PeerLostError when the plant stops or falls silent before the end, DeadlineError when slips do
        not end or one cycle never does.
        """
        with self._watchdog.guard():
            self._cycle()

    def _cycle(self) -> None:
        executive, transport, clock = self._executive, self._transport, self._clock
        batch = transport.recv(PEER_TIMEOUT_S)
        if not batch:
            raise self._lost(0)
        self._heard_ns = clock.now_ns()
        executive.start(self._heard_ns + executive.period_ns // 2)
        stopped_ns = 0  # when the plant said that it has stopped, too early to be believed at once
        while True:
            tick = executive.wait()
            self._watchdog.feed()
            arrived = transport.recv(0.0)
            batch += arrived
            if plant_stopped(arrived, self._node.flight.run_hash):
                if tick + END_SLACK_TICKS >= self._ticks:
                    return
                stopped_ns = clock.now_ns()
            self._judge_silence(tick, arrived, stopped_ns)
            self._say_overrun(tick)
            safe_requested, executive.safe_requested = executive.safe_requested, False
            self._node.tick(tick, batch, transport.send, safe_requested, executive.degraded)
            batch = b""

    def _judge_silence(self, tick: int, arrived: bytes, stopped_ns: int) -> None:
        now_ns = self._clock.now_ns()
        if any(can_id == SYNC_ID for (can_id,) in FRAME_ID.iter_unpack(arrived)):
            self._heard_ns = now_ns
            return
        silence_s = (now_ns - self._heard_ns) * 1e-9
        if "plant" in self._transport.departed or (stopped_ns > self._heard_ns and silence_s > QUIET_S):
            raise PeerLostError(
                f"the plant stopped at tick {tick} of {self._ticks}: its process ended, was killed or interrupted; the "
                "wheels no longer obey anybody"
            )
        if silence_s > PEER_TIMEOUT_S:
            raise self._lost(tick)

    def _say_overrun(self, tick: int) -> None:
        """A line for missed deadlines, at most one in OVERRUN_WORDS_S; all are counted in the telemetry."""
        counters, now_ns = self._executive.counters, self._clock.now_ns()
        missed = counters.slips - self._slips_said
        if not missed or (self._slips_said and now_ns - self._said_ns < OVERRUN_WORDS_S * 1e9):
            return
        self._slips_said, self._said_ns = counters.slips, now_ns
        self._node.log.link.event(
            tick * self._executive.period_ns, "warning", "fsw",
            f"{missed} deadlines missed since the last line, the latest by {counters.last_lateness_ns / 1e6:.1f} ms at tick "
            f"{tick}; so far {counters.slips} missed, {counters.skipped} ticks not run (policy {self._executive.policy})",
        )  # fmt: skip

    def _lost(self, tick: int) -> PeerLostError:
        return PeerLostError(
            f"the plant has been silent for {PEER_TIMEOUT_S:g} s at tick {tick} on {self._transport.address}: it hangs or "
            "was stopped; the wheels were commanded to damp or rest (safe mode) meanwhile"
        )
