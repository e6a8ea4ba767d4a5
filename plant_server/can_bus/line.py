"""The bus between the nodes: without times of its own, or with frames that take as long as on a real one.

Both ask whoever owns them whether an attempt fails by chance (`strikes`), keep the controllers' counters, and count.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from plant_server.can_bus.counts import WireCounts
from plant_server.can_bus.frame_time import ERROR_BITS, count_frame_bits
from plant_server.can_bus.parcel import Parcel
from plant_server.can_bus.stations import Stations

QUEUE_LIMIT: Final = 64  # frames that a node keeps to be sent; the newest is dropped
Strikes = Callable[[Parcel], bool]


class Line:
    """A bus on which a frame is there at once; what is counted in bits is the load alone."""

    unit_is_tick: Final = True

    def __init__(self, stations: Stations, counts: WireCounts, bits_per_tick: int) -> None:
        self._stations = stations
        self._counts = counts
        self._bits_per_tick = bits_per_tick
        self._waiting: list[Parcel] = []
        self.busy = 0  # bits of this tick
        self.frames = 0  # that went through on this tick

    def waiting(self) -> tuple[int, int]:
        """Return the number of frames on their way, by direction."""
        on_way = sum(parcel.way for parcel in self._waiting)
        return len(self._waiting) - on_way, on_way

    def charge(self, bits: int) -> None:
        """Take the bus for a frame that no fault touches."""
        self.busy += bits
        self.frames += 1

    def put(self, parcel: Parcel) -> None:
        """Send a frame."""
        reason = self._find_obstacle(parcel)
        if reason:
            self._counts.lost[reason][parcel.way] += 1
            return
        self.charge(count_frame_bits(parcel.frame))
        self._stations.note_success(parcel.sender)
        self._waiting.append(parcel)

    def take(self, way: int, tick: int) -> list[Parcel]:
        """Return the frames of a direction that arrive by this tick, in their order."""
        due = [parcel for parcel in self._waiting if parcel.way == way and parcel.due <= tick]
        if due:
            self._waiting = [parcel for parcel in self._waiting if parcel.way != way or parcel.due > tick]
        due.sort(key=lambda parcel: (parcel.is_swapped, parcel.number))
        return due

    def run(self, until: int) -> None:
        """Nothing takes time here."""

    def end_tick(self) -> tuple[int, int]:
        """Return the busy bits and the frames of the tick, and begin the next."""
        done = self._bits_per_tick if self._stations.is_blocked else min(self.busy, self._bits_per_tick)
        frames, self.busy, self.frames = self.frames, 0, 0
        return done, frames

    def _find_obstacle(self, parcel: Parcel) -> str:
        """Return why a frame cannot be sent at all; empty when it can."""
        stations, sender = self._stations, parcel.sender
        if stations.is_off(sender):
            return "bus_off"
        if stations.is_blocked:
            return "dominant"
        if sender in stations.failing:
            cost = count_frame_bits(parcel.frame) + ERROR_BITS
            while not stations.is_off(sender) and self.busy < self._bits_per_tick:
                self.busy += cost
                self._counts.attempts_failed += 1
                stations.note_failure(sender)
            return "bus_off"
        if not stations.has_listener(sender):
            stations.note_unacknowledged(sender)
            return "unacknowledged"
        return ""


class TimedLine:
    """A bus with a bit rate: the lowest id that waits anywhere goes first, and a frame that has begun goes to its end.

    A node keeps its frames in the order of their ids, so that the lowest of the bus is the lowest of all that wait. Times
    are whole bits since the start of the run.
    """

    unit_is_tick: Final = False

    def __init__(self, stations: Stations, counts: WireCounts, strikes: Strikes) -> None:
        self._stations = stations
        self._counts = counts
        self._strikes = strikes
        self._pending: list[Parcel] = []  # to be sent
        self._arrived: list[Parcel] = []  # sent, not yet taken
        self._now = 0  # from when on the bus is free
        self._begun = 0  # bits of frames and errors since the run began
        self._covered = 0  # of them up to the end of the last tick
        self._until = 0  # where the last run ended
        self._frames = 0
        self._blocked = 0  # bits of this tick in which it was held

    def waiting(self) -> tuple[int, int]:
        """Return the number of frames on their way, by direction."""
        every = self._pending + self._arrived
        on_way = sum(parcel.way for parcel in every)
        return len(every) - on_way, on_way

    def charge(self, bits: int) -> None:
        """Take the bus for a frame that no fault touches: it goes first."""
        self._now += bits
        self._begun += bits
        self._frames += 1

    def put(self, parcel: Parcel) -> None:
        """Queue a frame at its node."""
        stations, counts = self._stations, self._counts
        kept = sum(1 for other in self._pending if other.sender == parcel.sender and not other.is_extra)
        if stations.is_off(parcel.sender):
            counts.lost["bus_off"][parcel.way] += 1
        elif not parcel.is_extra and kept >= QUEUE_LIMIT:
            counts.lost["overflow"][parcel.way] += 1
        else:
            self._pending.append(parcel)

    def run(self, until: int) -> None:
        """Send what can begin before this bit."""
        self._until = until
        if self._stations.is_blocked:
            self._blocked += max(0, until - self._now)
            self._now = max(self._now, until)
            return
        while self._now < until:
            ready = [parcel for parcel in self._pending if parcel.due <= self._now]
            if ready:
                self._attempt(min(ready, key=lambda parcel: parcel.place))
                continue
            self._now = min((until, *(parcel.due for parcel in self._pending)))

    def take(self, way: int, until: int) -> list[Parcel]:
        """Return the frames of a direction that were through by this bit, in their order."""
        due = [parcel for parcel in self._arrived if parcel.way == way and parcel.ended <= until]
        if due:
            self._arrived = [parcel for parcel in self._arrived if parcel.way != way or parcel.ended > until]
        return due

    def end_tick(self) -> tuple[int, int]:
        """Return the busy bits and the frames of the tick that ends where the last `run` did, and begin the next."""
        covered = self._begun - max(0, self._now - self._until)
        done = covered - self._covered + self._blocked, self._frames
        self._covered, self._frames, self._blocked = covered, 0, 0
        for parcel in self._pending:
            if parcel.is_extra:
                self._counts.lost["overflow"][parcel.way] += 1
        self._pending = [parcel for parcel in self._pending if not parcel.is_extra]
        return done

    def _attempt(self, parcel: Parcel) -> None:
        stations, counts, sender = self._stations, self._counts, parcel.sender
        bits = count_frame_bits(parcel.frame)
        fails = sender in stations.failing or self._strikes(parcel)
        if fails:
            bits += ERROR_BITS
        self._now += bits
        self._begun += bits
        if fails:
            counts.attempts_failed += 1
            stations.note_failure(sender)
            if stations.is_off(sender):
                self._drop(sender)
        elif not stations.has_listener(sender):
            counts.attempts_failed += 1
            stations.note_unacknowledged(sender)
        else:
            self._pending.remove(parcel)
            parcel.ended = self._now
            self._arrived.append(parcel)
            self._frames += 1
            stations.note_success(sender)

    def _drop(self, sender: str) -> None:
        """Lose what a node that has gone off had queued."""
        for parcel in self._pending:
            if parcel.sender == sender:
                self._counts.lost["bus_off"][parcel.way] += 1
        self._pending = [parcel for parcel in self._pending if parcel.sender != sender]
