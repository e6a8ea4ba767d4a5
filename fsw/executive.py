"""The cyclic executive: releases one cycle per period on absolute deadlines and keeps the books on lateness.

| requirement | where | how it is checked |
|---|---|---|
| a cycle is released at epoch + k * period, never earlier | `Executive.wait` | fake clock |
| lateness does not accumulate | absolute deadlines | fake clock |
| a missed deadline is counted and handled by one stated policy | `Executive._slip` | one test a policy |
| endless overrun ends the run by name | `DeadlineError` | fake clock |
| a stuck cycle is noticed from outside | `Watchdog` | fake clock |

Names follow nasa/fprime's ActiveRateGroup (max cycle time, cycle slips) and cFS SCH (slots processed, skipped).
"""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from types import FrameType
from typing import Final

from bus.clock import MonotonicClock
from bus.errors import DeadlineError

DEGRADED_CYCLES: Final = 20  # cycles on time before shed rate groups come back


@dataclass(slots=True)
class ExecutiveCounters:
    """What the executive did so far."""

    cycles: int = 0  # slots processed
    slips: int = 0  # cycles that missed their deadline by a period or more
    consecutive_slips: int = 0
    skipped: int = 0  # ticks not run at all
    caught_up: int = 0  # ticks run late, back to back
    last_cycle_ns: int = 0
    max_cycle_ns: int = 0
    last_lateness_ns: int = 0
    max_lateness_ns: int = 0


class Executive:
    """Releases cycles at a fixed rate and applies one overrun policy.

    skip      run the next tick that is not yet due; the missed ones are counted and lost
    catch_up  run every missed tick at once, back to back
    degrade   as skip, and leave out what is not essential until the cycle has been on time for a while
    safe      as skip, and ask the mode manager for safe mode
    """

    def __init__(self, period_ns: int, policy: str, max_consecutive_slips: int, clock: MonotonicClock) -> None:
        self.period_ns = period_ns
        self.policy = policy
        self.max_consecutive_slips = max_consecutive_slips
        self.clock = clock
        self.counters = ExecutiveCounters()
        self.safe_requested = False
        self._epoch_ns = 0
        self._next_tick = 0
        self._degraded_left = 0

    @property
    def degraded(self) -> bool:
        """True while the groups that are not essential are shed."""
        return self._degraded_left > 0

    def start(self, epoch_ns: int) -> None:
        """Tick k is due at epoch_ns + k * period_ns from now on."""
        self._epoch_ns = epoch_ns
        self._next_tick = 0

    def deadline_ns(self) -> int:
        """When the next tick is due."""
        return self._epoch_ns + self._next_tick * self.period_ns

    def wait(self) -> int:
        """Sleep to the next release and return its tick.

        Raises DeadlineError after more than `max_consecutive_slips` slips in a row.
        """
        deadline_ns = self.deadline_ns()
        if self.clock.now_ns() < deadline_ns:
            self.clock.sleep_until(deadline_ns)
        now_ns = self.clock.now_ns()
        lateness_ns = now_ns - deadline_ns
        if lateness_ns >= self.period_ns:
            self._slip(lateness_ns)
        else:
            self.counters.consecutive_slips = 0
            self._degraded_left = max(0, self._degraded_left - 1)
        self.counters.last_lateness_ns = lateness_ns
        self.counters.max_lateness_ns = max(self.counters.max_lateness_ns, lateness_ns)
        tick = self._next_tick
        self._next_tick += 1
        return tick

    def _slip(self, lateness_ns: int) -> None:
        counters = self.counters
        counters.slips += 1
        counters.consecutive_slips += 1
        if counters.consecutive_slips > self.max_consecutive_slips:
            raise DeadlineError(
                f"tick {self._next_tick}: {counters.consecutive_slips} deadlines missed in a row, the last by "
                f"{lateness_ns / 1e6:.1f} ms at a period of {self.period_ns / 1e6:.1f} ms; the limit is "
                f"{self.max_consecutive_slips} (executive.max_consecutive_slips): lower the rate or free the machine"
            )
        if self.policy == "catch_up":
            counters.caught_up += 1
            return
        missed = lateness_ns // self.period_ns
        counters.skipped += missed
        self._next_tick += missed
        if self.policy == "degrade":
            self._degraded_left = DEGRADED_CYCLES
        elif self.policy == "safe":
            self.safe_requested = True


class Watchdog:
    """Bites when it has not been fed for `limit_ns`. Fed by the loop that does the real work, and by nothing else."""

    def __init__(self, limit_ns: int, clock: MonotonicClock) -> None:
        self.limit_ns = limit_ns
        self._clock = clock
        self._fed_ns = self._clock.now_ns()

    def feed(self) -> None:
        """The loop is alive."""
        self._fed_ns = self._clock.now_ns()

    def silent_ns(self) -> int:
        """How long the loop has not fed it."""
        return self._clock.now_ns() - self._fed_ns

    @contextlib.contextmanager
    def guard(self) -> Iterator[None]:
        """Watch over the body from a timer signal: raises DeadlineError inside it once it has not fed for the limit.

        Only in the main thread, and nested in nothing else that uses SIGALRM.
        """
        self.feed()
        previous = signal.signal(signal.SIGALRM, self._look)
        every_s = self.limit_ns * 0.5e-9
        signal.setitimer(signal.ITIMER_REAL, every_s, every_s)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, previous)

    def _look(self, number: int, frame: FrameType | None) -> None:
        if self.bitten:
            raise DeadlineError(
                f"the watchdog bit: the flight loop has not come round for {self.silent_ns() / 1e9:.1f} s (limit "
                f"{self.limit_ns / 1e9:g} s, executive.watchdog_s): a cycle hangs"
            )

    @property
    def bitten(self) -> bool:
        """True once the limit has passed without a feed."""
        return self.silent_ns() > self.limit_ns
