"""The flight software paced in lock-step and in real time, on a clock and a bus that the test makes up."""

from __future__ import annotations

import itertools
import os
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bus.commands import Command
from bus.errors import DeadlineError, PeerLostError
from bus.icd.codec import encode_fogs, encode_HEARTBEAT_PLANT, encode_rw_tlms, encode_STR_QA, encode_STR_QB, encode_SYNC
from bus.settings import build
from bus.units import Vec3
from fsw.config import FswConfig
from fsw.executive import DEGRADED_CYCLES, Executive, Watchdog
from fsw.families import Observer
from fsw.flight import Flight
from fsw.node import FswNode
from fsw.pacing import LockStep, RealTime
from fsw.telemetry import SOURCE
from tools.log.mcap_reader import Run, read_run
from tools.log.recorder import Recorder

TICK_NS = 100_000_000
TICK_S = 0.1
RUN_HASH = 77
OPERATIONAL, STOPPED = 5, 4
CONFIG = build(
    FswConfig,
    {
        "model": {"inertia_kgm2": [[45, 3, 2], [3, 38, -1.5], [2, -1.5, 50]]},
        "estimator": {"kind": "direct"},
        "observer": {"kind": "ilo"},
        "controller": {"kind": "smc"},
    },
    "test",
)


def make_sensors(tick: int) -> bytes:
    """What the plant sends at a tick, SYNC last."""
    counter = tick % 15
    return (
        encode_rw_tlms(counter, (0, 0, 0, 0), (10.0, -20.0, 30.0, 5.0), (0.0, 0.0, 0.0, 0.0), tick & 0xFF)
        + encode_fogs(counter, (0, 0, 0), (0.01, -0.005, 0.002), tick & 0xFF)
        + encode_STR_QA(counter, 0, 0.9, 0.3)
        + encode_STR_QB(counter, 0, -0.2, 0.2449489742783178)
        + encode_SYNC(counter, 0, tick)
    )


def say(state: int, run_hash: int = RUN_HASH) -> bytes:
    return encode_HEARTBEAT_PLANT(0, 0, state, run_hash)


class HandClock:
    """Time moves only when somebody sleeps or the test says so."""

    def __init__(self) -> None:
        self.now = 1_000

    def now_ns(self) -> int:
        return self.now

    def sleep_until(self, deadline_ns: int) -> None:
        self.now = max(self.now, deadline_ns)


class Wire:
    """One end of a bus: what is received comes from `batches`; an empty one is a wait for the whole timeout."""

    address = "test:"

    def __init__(self, clock: HandClock, batches: Iterator[bytes]) -> None:
        self.clock, self.batches = clock, batches
        self.departed: list[str] = []
        self.sent: list[bytes] = []
        self.cost_ns: dict[int, int] = {}  # what sending takes, by how much has been sent before

    def send(self, batch: bytes) -> None:
        self.clock.now += self.cost_ns.get(len(self.sent), 0)
        self.sent.append(batch)

    def recv(self, timeout_s: float | None = None) -> bytes:
        batch = next(self.batches, b"")
        if not batch:
            self.clock.now += round((timeout_s or 0.0) * 1e9)
        return batch


class Watched:
    """A node, and what its ticks were given."""

    def __init__(self, bed: Bed) -> None:
        self._bed = bed

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bed.node, name)

    def tick(self, number: int, frames: bytes, *rest: Any) -> None:
        self._bed.ticks.append(number)
        self._bed.frames.append(frames)
        self._bed.node.tick(number, frames, *rest)


class Bed:
    """A node with a log in memory."""

    def __init__(self, *commands: Command) -> None:
        self.clock = HandClock()
        fd = os.memfd_create("bed.mcap")
        weakref.finalize(self, os.close, fd)
        self.path = Path(f"/proc/self/fd/{fd}")
        self.recorder = Recorder(self.path, metadata={}, sources=[SOURCE])
        self.link = self.recorder.link(SOURCE)
        self.flight = Flight(CONFIG, TICK_S, RUN_HASH)
        self.node = FswNode(self.flight, self.link, TICK_NS, self.clock, commands)
        self.frames: list[bytes] = []
        self.ticks: list[int] = []
        self.watched: Any = Watched(self)  # in the place of the node

    def read_log(self) -> Run:
        self.link.close("done")
        self.recorder.close()
        return read_run(self.path)


# -- lock-step -----------------------------------------------------------------------------------------------------


def lock(batches: list[bytes], ticks: int, departed: tuple[str, ...] = ()) -> tuple[Bed, Wire, LockStep]:
    bed = Bed()
    wire = Wire(bed.clock, iter(batches))
    wire.departed += departed
    return bed, wire, LockStep(bed.watched, wire, bed.clock, ticks)  # type: ignore[arg-type]


def test_one_cycle_for_every_sync_and_the_end() -> None:
    """Three ticks, three answers, and the plant's STOPPED behind them ends the run."""
    bed, wire, loop = lock([make_sensors(0), make_sensors(1), make_sensors(2), say(STOPPED)], 3)
    loop.run()
    assert bed.ticks == [0, 1, 2]
    assert len(wire.sent) == 3
    assert bed.flight.executive.cycles == 3


def test_only_the_expected_sync_starts_a_cycle() -> None:
    """A batch without its SYNC, and SYNC of another tick, wait; all that came before the right one is given with it."""
    first, wrong = make_sensors(0)[:-16], encode_SYNC(3, 0, 7)
    bed, wire, loop = lock([first, wrong, encode_SYNC(0, 0, 0), say(STOPPED)], 1)
    loop.run()
    assert bed.ticks == [0]
    assert bed.frames == [first + wrong + encode_SYNC(0, 0, 0)]
    assert len(wire.sent) == 1


def test_what_stands_behind_a_sync_waits_for_the_next_cycle() -> None:
    """One read with a tick and a half, and one with two ticks: no frame is lost and none is early."""
    one, two, three = make_sensors(0), make_sensors(1), make_sensors(2)
    bed, _, loop = lock([one + two[:48], two[48:] + three, say(OPERATIONAL), say(STOPPED)], 3)
    loop.run()
    assert bed.frames == [one, two, three]
    assert bed.ticks == [0, 1, 2]


def test_a_stop_before_the_end_is_not_believed_while_the_plant_goes_on() -> None:
    """One STOPPED in the middle of the run, the next SYNC, and then a quiet while: the run goes on to its end.

    So too where more frames stand behind that SYNC.
    """
    one, two = make_sensors(1), make_sensors(2)
    for batches in ([one, b"", two], [one + two[:48], b"", two[48:]]):
        bed, _, loop = lock([make_sensors(0), say(STOPPED), *batches, b"", say(STOPPED)], 3)
        loop.run()
        assert bed.ticks == [0, 1, 2]


def test_a_stop_before_the_end_and_then_silence_is_the_plants_end() -> None:
    """Said at once, with the tick; another run's STOPPED is no such thing."""
    _, _, loop = lock([make_sensors(0), say(STOPPED)], 3)
    with pytest.raises(PeerLostError, match="stopped before tick 1 of 3"):
        loop.run()
    bed, _, loop = lock([make_sensors(0), say(STOPPED, 5)], 3)
    began = bed.clock.now
    with pytest.raises(PeerLostError, match="silent for 4 s before SYNC of tick 1"):
        loop.run()
    assert 4.0e9 <= bed.clock.now - began < 6.0e9


def test_a_plant_that_left_is_named_at_once() -> None:
    """The bus says that it has gone: no wait for the peer's time limit."""
    bed, _, loop = lock([make_sensors(0)], 3, ("plant",))
    with pytest.raises(PeerLostError, match="left the bus before SYNC of tick 1"):
        loop.run()
    assert bed.clock.now < 1e9


# -- real time -----------------------------------------------------------------------------------------------------


def send_on_time(clock: HandClock, ticks: int) -> Iterator[bytes]:
    """A plant that keeps its own time: whatever has become due since the last read, STOPPED behind the last tick."""
    begin, tick = clock.now, 0
    while True:
        batch = b""
        while tick < ticks and begin + tick * TICK_NS <= clock.now:
            batch += make_sensors(tick)
            tick += 1
        yield batch + (say(STOPPED) if tick == ticks else b"")


class SpyObserver(Observer):
    """Notes how much time it is told has passed."""

    def __init__(self, observer: Any) -> None:
        self._observer = observer
        self.times_s: list[float] = []

    @property
    def internals(self) -> tuple[Any, ...]:
        found: tuple[Any, ...] = self._observer.internals
        return found

    def reset(self) -> None:
        self._observer.reset()

    def shift_rate(self, step_b_rad_s: Vec3) -> None:
        self._observer.shift_rate(step_b_rad_s)

    def step(self, dt_s: float, *rest: Any) -> Any:
        self.times_s.append(dt_s)
        return self._observer.step(dt_s, *rest)


def pace(policy: str, late: dict[int, float], ticks: int = 60, limit: int = 10) -> tuple[Bed, SpyObserver, RealTime]:
    """A real-time loop in which the n-th answer takes late[n] periods."""
    bed = Bed()
    bed.flight.observer = spy = SpyObserver(bed.flight.observer)
    wire = Wire(bed.clock, send_on_time(bed.clock, ticks))
    wire.cost_ns = {number: round(periods * TICK_NS) for number, periods in late.items()}
    executive = Executive(TICK_NS, policy, limit, bed.clock)
    watchdog = Watchdog(10**15, bed.clock)
    return bed, spy, RealTime(bed.watched, executive, watchdog, wire, bed.clock, ticks)  # type: ignore[arg-type]


def test_on_time_every_tick_runs_once() -> None:
    """No slip, no word about one, and the run ends with the plant."""
    bed, spy, loop = pace("skip", {})
    loop.run()
    assert bed.ticks == list(range(len(bed.ticks)))
    assert len(bed.ticks) >= 55
    assert set(spy.times_s) == {TICK_S}
    log = bed.read_log()
    assert log.signals("/fsw/executive")["slips"].max() == 0
    assert not any("deadlines missed" in event["message"] for event in log.events)


def test_skip_loses_ticks_and_tells_control_the_time_that_passed() -> None:
    """The sixth answer takes 3.5 periods: ticks 6 and 7 are not run, counted, and control on tick 8 is told 0.3 s."""
    bed, spy, loop = pace("skip", {5: 3.5})
    loop.run()
    assert bed.ticks[4:9] == [4, 5, 8, 9, 10]
    assert spy.times_s[bed.ticks.index(8)] == pytest.approx(0.3)
    assert spy.times_s[bed.ticks.index(9)] == pytest.approx(0.1)
    log = bed.read_log()
    executive = log.signals("/fsw/executive")
    at = executive["tick"].tolist().index(8)
    assert [executive[key][at] for key in ("slips", "skipped", "caught_up", "shed")] == [1, 2, 0, 0]
    assert executive["skipped"][at - 1] == 0
    words = [event["message"] for event in log.events if "deadlines missed" in event["message"]]
    assert words == [
        "1 deadlines missed since the last line, the latest by 250.0 ms at tick 8; so far 1 missed, 2 ticks not run (policy "
        "skip)"
    ]


def test_catch_up_runs_every_tick() -> None:
    """Ticks 6 and 7 run late, back to back, and are counted; none is lost."""
    bed, spy, loop = pace("catch_up", {5: 3.5})
    loop.run()
    assert bed.ticks == list(range(len(bed.ticks)))
    assert set(spy.times_s) == {TICK_S}
    executive = bed.read_log().signals("/fsw/executive")
    assert [executive[key][-1] for key in ("slips", "skipped", "caught_up")] == [2, 0, 2]


def test_degrade_sheds_what_is_not_essential_and_brings_it_back() -> None:
    """From the late tick on /fsw/law is left out for 20 cycles on time, is counted, and comes back; control goes on."""
    bed, _, loop = pace("degrade", {5: 3.5})
    loop.run()
    log = bed.read_log()
    law = [t_ns // TICK_NS for t_ns in log.t_ns("/fsw/law").tolist()]
    assert law == [tick for tick in bed.ticks if not 8 <= tick < 8 + DEGRADED_CYCLES]
    assert [t_ns // TICK_NS for t_ns in log.t_ns("/fsw/control").tolist()] == bed.ticks
    assert log.signals("/fsw/executive")["shed"][-1] == DEGRADED_CYCLES


def test_safe_leads_to_safe_mode_and_back() -> None:
    """The late tick is flown in safe mode; once the sensors were good for a while it points again."""
    bed, _, loop = pace("safe", {5: 3.5})
    loop.run()
    log = bed.read_log()
    modes = dict(zip(bed.ticks, log.signals("/fsw/executive")["mode"].astype(int).tolist(), strict=True))
    assert (modes[5], modes[8], modes[20], modes[max(bed.ticks)]) == (2, 3, 3, 2)
    assert "mode safe: safe mode requested" in [event["message"] for event in log.events]


def test_words_about_missed_deadlines_come_once_a_second() -> None:
    """A slip on every third cycle: at most one line a second, and their numbers add up to what was missed till then."""
    bed, _, loop = pace("skip", dict.fromkeys(range(0, 40, 3), 2.2), 90)
    loop.run()
    log = bed.read_log()
    told = [event for event in log.events if "deadlines missed" in event["message"]]
    times = [event["timestamp"]["sec"] + event["timestamp"]["nsec"] * 1e-9 for event in told]
    assert len(told) >= 4
    assert min(b - a for a, b in itertools.pairwise(times)) > 0.9
    missed = [int(event["message"].split()[0]) for event in told]
    assert sum(missed) == int(told[-1]["message"].split("so far ")[1].split()[0])
    assert max(missed) > 1


def test_endless_slips_end_the_run() -> None:
    """More than the limit in a row is an error by name."""
    _, _, loop = pace("skip", dict.fromkeys(range(60), 2.2), limit=10)
    with pytest.raises(DeadlineError, match="11 deadlines missed in a row"):
        loop.run()


def test_a_silent_plant_is_noticed() -> None:
    """No frame for 4 s: named with the tick; the cycles went on until then."""
    bed, _, loop = pace("skip", {})
    loop._transport.batches = iter([make_sensors(0), *[make_sensors(tick) for tick in range(1, 10)]])  # type: ignore[attr-defined]
    with pytest.raises(PeerLostError, match=r"silent for 4 s at tick (49|50) "):
        loop.run()
    assert len(bed.ticks) >= 49


def test_a_plant_that_stopped_early_and_is_silent_is_named() -> None:
    """STOPPED long before the end is believed after half a second of silence, and not while SYNC still comes."""
    sensors = [make_sensors(tick) for tick in range(30)]
    batches = [*sensors[:10], say(STOPPED) + sensors[10], *sensors[11:20], say(STOPPED)]
    bed, _, loop = pace("skip", {})
    loop._transport.batches = iter(batches)  # type: ignore[attr-defined]
    with pytest.raises(PeerLostError, match=r"the plant stopped at tick 2\d of 60"):
        loop.run()
    assert 23 <= max(bed.ticks) <= 26


def test_nobody_there_at_all() -> None:
    """The first frames never come."""
    _, _, loop = pace("skip", {})
    loop._transport.batches = iter([])  # type: ignore[attr-defined]
    with pytest.raises(PeerLostError, match="silent for 4 s at tick 0"):
        loop.run()


# -- commands ------------------------------------------------------------------------------------------------------


def test_refused_commands_are_announced_and_have_no_effect() -> None:
    """An unknown verb and wrong settings: a warning with the reason, no trace in the cycle's input, the target as before."""
    unknown = Command(2, "target.spin", {}, "ground")
    wrong = Command(3, "target.slew", {"target_q": [1, 0, 0, 0], "max_rate_deg_s": -1.0}, "ground")
    bed = Bed(unknown, wrong)
    for tick in range(6):
        bed.watched.tick(tick, make_sensors(tick), lambda _: None)
    assert bed.flight.guidance.target.q_it == (1.0, 0.0, 0.0, 0.0)
    assert not bed.flight.guidance.follows
    log = bed.read_log()
    said = {e["message"].split(": ")[0]: e for e in log.events if e["message"].startswith("command")}
    assert set(said) == {"command target.spin (ground) refused", "command target.slew (ground) refused"}
    assert all(event["level"] == 3 for event in said.values())
    assert "there are: target.hold" in said["command target.spin (ground) refused"]["message"]
    assert "max_rate_deg_s" in said["command target.slew (ground) refused"]["message"]
    assert not any(b"target." in payload for payload in log.payloads("/fsw/input"))


def test_obeyed_commands_act_on_their_tick_and_are_logged_with_it() -> None:
    """The target moves at tick 3, not before; one of the past acts at once; the record of the tick carries the command."""
    late = Command(3, "target.hold", {"target_q": [0.0, 1.0, 0.0, 0.0]}, "ground")
    bed = Bed(late)
    targets = []
    for tick in range(7):
        if tick == 5:
            bed.node.commands.add(Command(1, "target.hold", {"target_q": [0.0, 0.0, 1.0, 0.0]}, "ground"))
        bed.watched.tick(tick, make_sensors(tick), lambda _: None)
        targets.append(bed.flight.guidance.target.q_it.index(1.0))
    assert targets == [0, 0, 0, 1, 1, 2, 2]
    log = bed.read_log()
    carrying = [tick for tick, data in enumerate(log.payloads("/fsw/input")) if b"target.hold" in data]
    assert carrying == [3, 5]
    assert late.to_json().encode() + b"\0" in log.payloads("/fsw/input")[3]
    words = [event["message"] for event in log.events if event["message"].startswith("command")]
    assert words == ["command target.hold (ground) obeyed at tick 3", "command target.hold (ground) obeyed at tick 5"]
