"""The plant's clocks, driven by a clock and a bus that are the test's own: no waiting, no real time."""

from __future__ import annotations

import pytest

from bus.clock import PEER_TIMEOUT_S, QUIET_S
from bus.errors import DeadlineError, PeerLostError, UsageError
from bus.icd.codec import encode_CYCLE_DONE, encode_HEARTBEAT_FSW, encode_rw_cmds
from bus.native import COMPILED
from bus.settings import build
from bus.telemetry.link import Link, Row
from bus.telemetry.packing import FRAMES
from bus.wire.transport import TransportCounters
from plant_server.config import PlantConfig
from plant_server.handshake import meet_fsw
from plant_server.node import PlantNode
from plant_server.pacing import MAX_LATENESS_S, LockStep, RealTime
from plant_server.plant import Plant

TICK_NS = 100_000_000
DATA = {
    "body": {"inertia_kgm2": [[45, 3, 2], [3, 38, -1.5], [2, -1.5, 50]]},
    "wheels": [{"mount": mount} for mount in ("x", "y", "z", "skew")],
}


class FakeClock:
    """Time that passes only when somebody waits."""

    def __init__(self) -> None:
        self.ns = 5_000_000_000

    def now_ns(self) -> int:
        return self.ns

    def sleep_until(self, deadline_ns: int) -> None:
        self.ns = max(self.ns, deadline_ns)


class FakeBus:
    """A transport to which batches come at set times; a read that finds nothing takes its whole timeout."""

    def __init__(self, clock: FakeClock) -> None:
        self.address, self.node = "fake:", "plant"
        self.counters = TransportCounters()
        self.kernel_stamps_ns: list[int] = []
        self.departed: list[str] = []
        self.arrivals: list[tuple[int, bytes]] = []  # when, what
        self.sent: list[tuple[int, bytes]] = []
        self._clock = clock

    def send(self, batch: bytes) -> None:
        self.sent.append((self._clock.ns, batch))

    def recv(self, timeout_s: float | None = None) -> bytes:
        until = self._clock.ns + round((timeout_s or 0.0) * 1e9)
        if self.arrivals and self.arrivals[0][0] <= until:
            at, batch = self.arrivals.pop(0)
            self._clock.ns = max(self._clock.ns, at)
            return batch
        self._clock.ns = until
        return b""


class RowLink(Link):
    """Keeps rows, and counts how often it is told to let go of them."""

    def __init__(self) -> None:
        super().__init__(1)
        self.rows: list[Row] = []
        self.flushes = 0

    def write_row(self, row: Row) -> None:
        self.rows.append(row)

    def flush(self) -> None:
        self.flushes += 1

    def write_json(self, topic: str, t_ns: int, payload: bytes) -> None:
        pass


def make() -> tuple[FakeClock, FakeBus, PlantNode, RowLink]:
    clock, link = FakeClock(), RowLink()
    node = PlantNode(Plant(build(PlantConfig, DATA, "test"), (), 0.1, 1), link, TICK_NS, 42)
    return clock, FakeBus(clock), node, link


def answer(tick: int, torque_nm: float = 0.01) -> bytes:
    return encode_rw_cmds(tick % 15, (1,) * 4, (torque_nm,) * 4, tick & 0xFF) + encode_CYCLE_DONE(tick % 15, 2, tick, 0)


def frames_of(row: Row) -> bytes:
    """The frames in what a tick leaves for the log: the compiled build has made a record of them already."""
    data: bytes = row[2]
    if not COMPILED:
        return data
    return data[FRAMES.size : FRAMES.size + int.from_bytes(data[FRAMES.size - 4 : FRAMES.size], "little")]


def test_lock_step_takes_no_longer_than_the_answers() -> None:
    """Five answers, each 7 ms after the one before: five ticks in 35 ms, all of them logged with their frames."""
    clock, bus, node, link = make()
    start = clock.ns
    bus.arrivals = [(start + (tick + 1) * 7_000_000, answer(tick)) for tick in range(5)]
    pacing = LockStep(bus, clock, node.log)
    for _ in range(5):
        node.tick(pacing.exchange)
    assert clock.ns == start + 35_000_000
    assert node.tick_number == 5
    assert node.plant.truth().tau_rw_true_nm == pytest.approx((0.01,) * 4, abs=5e-8)
    assert [frames_of(row) for row in link.rows] == [sent + answer(tick) for tick, (_, sent) in enumerate(bus.sent)]
    assert link.flushes == 0


def test_lock_step_waits_for_the_end_of_the_cycle_through_what_comes_before_it() -> None:
    """Commands first and the end of the cycle a second later, junk between: one tick, everything logged in its order."""
    clock, bus, node, link = make()
    whole, stray = answer(0), encode_CYCLE_DONE(0, 2, 9, 0)
    pieces = [whole[:64], encode_HEARTBEAT_FSW(0, 0, 5, 42), whole[64:]]
    bus.arrivals = [(clock.ns + k * 500_000_000, piece) for k, piece in enumerate(pieces)]
    node.tick(LockStep(bus, clock, node.log).exchange)
    assert frames_of(link.rows[0]) == bus.sent[0][1] + b"".join(pieces)
    assert link.flushes == 1  # nothing is held back over a wait that may be long
    bus.arrivals = [(clock.ns, stray)]
    with pytest.raises(PeerLostError, match="has not ended its cycle of tick 0 for 4 s"):
        node.tick(LockStep(bus, clock, node.log).exchange)  # the end of another tick's cycle ends nothing


def test_a_flight_software_that_is_silent_is_lost_after_the_timeout() -> None:
    """At the limit, not before and not much after; the tick is named."""
    clock, bus, node, _ = make()
    pacing = LockStep(bus, clock, node.log)
    bus.arrivals = [(clock.ns, answer(0))]
    node.tick(pacing.exchange)
    start = clock.ns
    with pytest.raises(PeerLostError, match="has not ended its cycle of tick 1"):
        node.tick(pacing.exchange)
    assert PEER_TIMEOUT_S <= (clock.ns - start) * 1e-9 <= PEER_TIMEOUT_S + QUIET_S + 1e-6


def test_a_flight_software_that_left_is_lost_at_once() -> None:
    """The bus says who has left: no need to wait for the timeout."""
    clock, bus, node, _ = make()
    bus.departed.append("fsw")
    start = clock.ns
    with pytest.raises(PeerLostError, match="left the bus at tick 0"):
        node.tick(LockStep(bus, clock, node.log).exchange)
    assert (clock.ns - start) * 1e-9 <= QUIET_S


def test_real_time_ticks_stand_on_absolute_deadlines() -> None:
    """Whenever frames come, every tick ends a period after the one before; what came until then is in it."""
    clock, bus, node, link = make()
    start = clock.ns
    bus.arrivals = [
        (start + 30_000_000, answer(0)),
        (start + 130_000_000, answer(1)[:16]),
        (start + 190_000_000, answer(1)[16:]),
    ]
    pacing = RealTime(bus, clock, TICK_NS, node.log)
    for _ in range(4):
        node.tick(pacing.exchange)
    assert [at - start for at, _ in bus.sent] == [0, TICK_NS, 2 * TICK_NS, 3 * TICK_NS]
    assert clock.ns == start + 4 * TICK_NS
    assert [frames_of(row).removeprefix(sent) for row, (_, sent) in zip(link.rows, bus.sent, strict=True)] == [
        answer(0), answer(1), b"", b"",
    ]  # fmt: skip
    assert (pacing.slips, pacing.max_lateness_ns) == (0, 0)
    assert node.channel.counters.accepted == 10
    assert node.plant.truth().tau_rw_true_nm == pytest.approx((0.01,) * 4, abs=5e-8)


def test_a_late_plant_runs_the_missed_ticks_back_to_back_and_counts_them() -> None:
    """Stopped for 3.5 periods: the ticks that end late by a period or more are slips, and then it is in time again."""
    clock, bus, node, _ = make()
    pacing = RealTime(bus, clock, TICK_NS, node.log)
    node.tick(pacing.exchange)
    start = clock.ns
    clock.ns += 350_000_000
    sent_at = []
    for _ in range(5):
        node.tick(pacing.exchange)
        sent_at.append(bus.sent[-1][0] - start)
    assert sent_at == [350_000_000] * 4 + [400_000_000]
    assert pacing.slips == 2  # 250 and 150 ms late; the third, 50 ms, is within a period
    assert pacing.max_lateness_ns == 250_000_000
    assert node.tick_number == 6


def test_a_plant_too_late_for_good_ends_the_run() -> None:
    """Past the limit truth and wall clock have parted; the message names the tick and the limit."""
    clock, bus, node, _ = make()
    pacing = RealTime(bus, clock, TICK_NS, node.log)
    node.tick(pacing.exchange)
    clock.ns += round((MAX_LATENESS_S + 0.2) * 1e9)
    with pytest.raises(DeadlineError, match=r"2\.1 s behind real time at tick 1 \(limit 2 s\)"):
        node.tick(pacing.exchange)


def test_meeting_ends_after_its_patience_or_with_the_right_peer() -> None:
    """Nobody, somebody with another scenario, and the right one, heard before and after it was answered."""
    clock, bus, node, _ = make()
    start = clock.ns
    with pytest.raises(PeerLostError, match="within 10 s"):
        meet_fsw(bus, node.channel, 42, 10.0, clock)
    assert clock.ns == start + 10_000_000_000
    bus.arrivals = [(clock.ns, encode_HEARTBEAT_FSW(0, 0, 127, 43))]
    with pytest.raises(UsageError, match="runs another scenario"):
        meet_fsw(bus, node.channel, 42, 10.0, clock)
    node.channel.fsw_state = -1
    bus.arrivals = [(clock.ns + k, encode_HEARTBEAT_FSW(k, 0, state, 42)) for k, state in ((1, 5), (2, 5))]
    bus.sent.clear()
    meet_fsw(bus, node.channel, 42, 10.0, clock)
    assert len(bus.sent) == 1
