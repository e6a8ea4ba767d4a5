"""Clocks: the monotonic clock behind absolute deadlines, and what the machine grants a real-time process."""

from __future__ import annotations

import gc
import os
import time
from typing import Protocol

QUIET_S = 0.5  # a peer that has been silent for so long may be gone: nothing is held back while waiting on
PEER_TIMEOUT_S = 4.0  # wall time without a sign of life after which a peer is declared dead
FIFO_PRIORITY = 50
ARENA_BYTES = 1 << 20  # of CPython's allocator
RESERVED_ARENAS = 2
_reserve: list[bytes] = []


class MonotonicClock(Protocol):
    """What pacing needs of a clock. Time is CLOCK_MONOTONIC nanoseconds."""

    def now_ns(self) -> int: ...
    def sleep_until(self, deadline_ns: int) -> None: ...


class SystemClock:
    """CLOCK_MONOTONIC of this machine."""

    now_ns = staticmethod(time.monotonic_ns)  # nanoseconds since an arbitrary start

    def sleep_until(self, deadline_ns: int) -> None:
        """Return at or after the deadline. Sleeps and never spins, so that it also works in virtual time."""
        while (left_ns := deadline_ns - time.monotonic_ns()) > 0:
            time.sleep(left_ns * 1e-9)


def claim_realtime() -> str:
    """Ask for SCHED_FIFO, settle the garbage collector and the allocator; say in words what was granted."""
    gc.collect()
    gc.freeze()
    reserve_memory()
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
    except OSError as error:
        return f"SCHED_OTHER ({error.strerror}; grant CAP_SYS_NICE or an rtprio limit for SCHED_FIFO)"
    return f"SCHED_FIFO {FIFO_PRIORITY}"


def reserve_memory() -> None:
    """Keep a few arenas of CPython's allocator for good, with room in them.

    It gives an arena back as soon as it is empty. A cycle that starts with the arenas full maps one and unmaps it again,
    every time, and takes the page faults: measured, 2 mappings a tick.
    """
    if not _reserve:
        block = 512  # the largest that comes out of an arena
        blocks = [bytes(block - 64) for _ in range(RESERVED_ARENAS * ARENA_BYTES // block)]
        _reserve.extend(blocks[:: ARENA_BYTES // block // 4])
