"""The frames that wait for one node of a bus inside this process: what passed its filters, as far as there was room."""

from __future__ import annotations

from collections.abc import Sequence

from bus.wire.frames import FRAME_SIZE, Filter, FrameFilter, count_error_frames
from bus.wire.transport import TransportCounters


class Inbox:
    """A bounded queue of batches. Counts what it takes, gives and has no room for; waking a reader is the owner's work."""

    __slots__ = ("_batches", "_counters", "_filter", "_frames", "_limit")

    def __init__(self, filters: Sequence[Filter] | None, limit_frames: int, counters: TransportCounters) -> None:
        self._filter = FrameFilter(filters)
        self._limit = limit_frames
        self._counters = counters
        self._batches: list[bytes] = []
        self._frames = 0

    def __bool__(self) -> bool:
        return bool(self._batches)

    def set_filters(self, filters: Sequence[Filter] | None) -> None:
        """Take only what passes one of the (id, mask) pairs from now on; None: everything."""
        self._filter = FrameFilter(filters)

    def put(self, batch: bytes, count: int) -> bool:
        """Queue a batch of so many frames; False when nothing of it is wanted or has room."""
        if not self._filter.passes_all:
            batch = self._filter.select(batch)
            count = len(batch) // FRAME_SIZE
            if not count:
                return False
        room = self._limit - self._frames
        if count > room:
            self._counters.dropped += count - room
            if not room:
                return False
            batch = batch[: room * FRAME_SIZE]
            count = room
        self._batches.append(batch)
        self._frames += count
        return True

    def take(self) -> bytes:
        """Return all that waits as one batch, b"" when nothing does."""
        batches = self._batches
        if not batches:
            return b""
        batch = batches[0] if len(batches) == 1 else b"".join(batches)
        self._counters.rx += self._frames
        self._counters.error_frames += count_error_frames(batch)
        self._batches = []
        self._frames = 0
        return batch
