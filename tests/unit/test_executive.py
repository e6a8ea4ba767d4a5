"""The cyclic executive against a clock that the test moves by hand."""

from __future__ import annotations

import signal
import time

import pytest

from bus.clock import SystemClock
from bus.errors import ConfigError, DeadlineError
from fsw.executive import DEGRADED_CYCLES, Executive, Watchdog
from fsw.schedule import RateGroup, Schedule, Slot, flight_schedule

PERIOD_NS = 10_000_000


class HandClock:
    """Time moves only when somebody sleeps or the test says so."""

    def __init__(self) -> None:
        self.now = 1_000
        self.slept: list[int] = []

    def now_ns(self) -> int:
        return self.now

    def sleep_until(self, deadline_ns: int) -> None:
        self.slept.append(deadline_ns)
        self.now = max(self.now, deadline_ns)


def hang(watchdog: Watchdog) -> None:
    with watchdog.guard():
        while True:
            pass


def make(policy: str = "skip", limit: int = 3) -> tuple[Executive, HandClock]:
    clock = HandClock()
    executive = Executive(PERIOD_NS, policy, limit, clock)
    executive.start(clock.now)
    return executive, clock


def test_releases_on_absolute_deadlines_whatever_the_cycles_take() -> None:
    """Deadlines are epoch + k * period: cycle times do not add up to drift."""
    executive, clock = make()
    epoch = clock.now
    for tick in range(5):
        assert executive.wait() == tick
        assert clock.now == epoch + tick * PERIOD_NS
        clock.now += 3_333_333
    assert executive.counters.slips == 0


def test_lateness_below_a_period_is_measured_and_is_no_slip() -> None:
    """A cycle released late but within its period keeps its tick and counts no slip."""
    executive, clock = make()
    executive.wait()
    clock.now += PERIOD_NS + 4_000_000
    assert executive.wait() == 1
    assert executive.counters.last_lateness_ns == executive.counters.max_lateness_ns == 4_000_000
    assert executive.counters.slips == 0


def test_skip_drops_the_missed_ticks() -> None:
    """After 2.5 missed periods the executive goes on with the tick that is due now."""
    executive, clock = make("skip")
    executive.wait()
    clock.now += PERIOD_NS + 5 * PERIOD_NS // 2
    assert executive.wait() == 3
    assert executive.counters.skipped == 2
    assert executive.counters.slips == 1
    assert executive.wait() == 4


def test_catch_up_runs_every_tick() -> None:
    """Ticks 1 and 2 run late, back to back, without sleeping; tick 4 is on time again."""
    executive, clock = make("catch_up", limit=10)
    executive.wait()
    clock.now += PERIOD_NS + 5 * PERIOD_NS // 2
    slept = len(clock.slept)
    assert [executive.wait(), executive.wait(), executive.wait()] == [1, 2, 3]
    assert len(clock.slept) == slept
    assert executive.counters.caught_up == 2
    assert executive.counters.skipped == 0
    assert executive.wait() == 4
    assert len(clock.slept) == slept + 1


def test_degrade_sheds_for_a_while_and_comes_back() -> None:
    """What is not essential is left out for DEGRADED_CYCLES cycles on time."""
    executive, clock = make("degrade")
    executive.wait()
    clock.now += 2 * PERIOD_NS
    executive.wait()
    assert executive.degraded
    for _ in range(DEGRADED_CYCLES):
        assert executive.degraded
        executive.wait()
    assert not executive.degraded


def test_safe_asks_for_safe_mode_once() -> None:
    """The safe policy raises the request; whoever acts on it clears it."""
    executive, clock = make("safe")
    executive.wait()
    assert not executive.safe_requested
    clock.now += 2 * PERIOD_NS
    executive.wait()
    assert executive.safe_requested


def test_endless_slips_end_the_run_by_name() -> None:
    """More than the limit in a row raises; a cycle on time in between starts the count again."""
    executive, clock = make("skip", limit=2)
    executive.wait()
    for _ in range(2):
        clock.now += 2 * PERIOD_NS
        executive.wait()
    executive.wait()
    assert executive.counters.consecutive_slips == 0
    for _ in range(2):
        clock.now += 2 * PERIOD_NS
        executive.wait()
    clock.now += 2 * PERIOD_NS
    with pytest.raises(DeadlineError, match="3 deadlines missed in a row"):
        executive.wait()


def test_watchdog_bites_only_when_it_is_not_fed() -> None:
    """Silence longer than the limit is a bite; a feed starts the silence anew."""
    clock = HandClock()
    watchdog = Watchdog(100, clock)
    clock.now += 100
    assert not watchdog.bitten
    clock.now += 1
    assert watchdog.bitten
    assert watchdog.silent_ns() == 101
    watchdog.feed()
    assert not watchdog.bitten


def test_a_hanging_cycle_is_bitten() -> None:
    """A loop that never feeds is ended from the timer by name; one that feeds is left alone, and the timer goes."""
    watchdog = Watchdog(50_000_000, SystemClock())
    with watchdog.guard():
        until = time.monotonic() + 0.2
        while time.monotonic() < until:
            watchdog.feed()
    with pytest.raises(DeadlineError, match="watchdog bit"):
        hang(watchdog)
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_rate_groups_run_on_their_ticks() -> None:
    """A divider of 10 with phase 0 runs on ticks 0, 10, 20, each time told that 10 have passed; phase 3 on 3, 13, 23."""
    control, _ = flight_schedule(10).open_slots()
    shifted = Slot(RateGroup("shifted", 10, 3))
    assert [(tick, ticks) for tick in range(25) if (ticks := control.take(tick))] == [(0, 10), (10, 10), (20, 10)]
    assert [(tick, ticks) for tick in range(25) if (ticks := shifted.take(tick))] == [(3, 10), (13, 10), (23, 10)]


def test_a_slot_that_was_skipped_runs_on_the_first_tick_after_it() -> None:
    """Ticks 8 to 12 are lost: control runs on 13, is told that 13 ticks have passed, and later slots stay on the grid."""
    control, _ = flight_schedule(10).open_slots()
    ticks = [*range(8), *range(13, 35)]
    assert [(tick, passed) for tick in ticks if (passed := control.take(tick))] == [
        (0, 10),
        (13, 13),
        (20, 7),
        (30, 10),
    ]
    assert control.next_tick == 40


def test_what_is_not_essential_is_shed_and_counted_and_comes_back() -> None:
    """Diagnostics are left out only on the ticks on which they are due and shedding is on; control never is."""
    control, diagnostics = flight_schedule(2).open_slots()
    ran = [[tick for tick in range(12) if slot.take(tick, 4 <= tick < 8)] for slot in (control, diagnostics)]
    assert ran == [[0, 2, 4, 6, 8, 10], [0, 2, 8, 10]]
    assert (control.shed, diagnostics.shed) == (0, 2)


def test_impossible_schedules_are_refused() -> None:
    """Every wrong row is named."""
    with pytest.raises(ConfigError, match=r"(?s)'a'.*'b'"):
        Schedule((RateGroup("a", 0), RateGroup("b", 2, 2)))
