"""Plays the frames of a log onto a bus: with their own timing, faster or slower, or as fast as the bus takes them."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from bus.errors import BusLostError, RecordError
from bus.icd.messages import MESSAGES
from bus.wire.frames import FRAME_SIZE
from bus.wire.transport import Transport
from tools.log.mcap_reader import WIRE_DTYPE, Run

NANO: Final = 1_000_000_000
KERNEL_STAMPS: Final = "_kernel_stamps"  # topic with a second record of frames that are on the bus's own already
LONGEST_SLEEP_S: Final = 0.5  # after which a bus that went away is looked for
FULL_S: Final = 5.0  # for which a bus may take nothing, before it is said to be stuck
RETRY_S: Final = 0.002
SENT_BY_FSW: Final = np.array(sorted(i for i, message in MESSAGES.items() if message.sender == "FSW"), np.uint32)
SENT_BY_PLANT: Final = np.array(sorted(i for i, message in MESSAGES.items() if message.sender != "FSW"), np.uint32)

Side = Literal["plant", "fsw"]


@dataclass(frozen=True, slots=True)
class Selection:
    """Which frames, and how often and how fast."""

    speed: float = 1.0  # times as fast as they were; 0: no waiting
    passes: int = 1  # 0: until it is stopped
    from_s: float = 0.0  # after the first frame of the log
    until_s: float | None = None
    only: Side | None = None  # the frames of one side alone, by their ids
    channel: str | None = None  # name of the bus in the log


@dataclass(slots=True)
class Played:
    """What was played so far."""

    frames: int = 0
    left_out: int = 0  # of the other side, or of nobody that the ICD knows
    passes: int = 0  # whole ones
    wall_s: float = 0.0
    latest_ms: float = 0.0  # that a frame was late
    address: str = field(default="")

    def describe(self) -> str:
        """One line for people."""
        words = f"{self.frames} frames sent to {self.address} in {self.wall_s:.3g} s"
        return (
            words
            + (f", {self.left_out} left out" if self.left_out else "")
            + (f", the latest by {self.latest_ms:.3g} ms" if self.latest_ms else "")
        )

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def play(run: Run, transport: Transport, selection: Selection, played: Played) -> None:
    """Play until the log, the passes or the bus come to an end; `played` says how far it is, also when this is broken off.

    Raises RecordError when there is nothing to play, BusLostError when the bus goes away or takes nothing any more.
    """
    channel = choose_channel(run, selection.channel)
    started_s = time.monotonic()
    played.address = transport.address
    pacer = _Pacer(selection.speed, played)
    try:
        while not selection.passes or played.passes < selection.passes:
            before = played.frames
            for t_ns, batch, left_out in _iterate_batches(run, channel, selection):
                played.left_out += left_out
                if batch:
                    pacer.wait(t_ns)
                    _send(transport, batch, played)
            if played.frames == before:
                raise RecordError(f"{run.path}: no frame of {channel} is to be played{_describe(selection)}")
            played.passes += 1
            pacer.begin_pass()
    finally:
        played.wall_s = time.monotonic() - started_s


def choose_channel(run: Run, wanted: str | None) -> str:
    """The bus in the log whose frames are played. Raises RecordError where there is none, or more than one."""
    buses = [name for name in run.buses() if not name.endswith(KERNEL_STAMPS)]
    if wanted is not None and wanted in run.buses():
        return wanted
    if wanted is None and len(buses) == 1:
        return buses[0]
    listed = ", ".join(run.buses()) or "none"
    what = f"no bus {wanted} in it" if wanted is not None else "several buses in it" if buses else "no frames in it"
    raise RecordError(
        f"{run.path}: there is {what}; there are: {listed}{'' if wanted or not buses else ' (--channel)'}"
    )


class _Pacer:
    """Waits for the moment of each batch."""

    def __init__(self, speed: float, played: Played) -> None:
        self._speed = speed
        self._played = played
        self._origin_ns = 0  # on the monotonic clock, of the first batch of this pass
        self._first_ns = -1  # its log time; -1: none yet
        self._last_ns = 0
        self._gap_ns = 0  # between the last two batches: what a pass keeps to the next one

    def wait(self, t_ns: int) -> None:
        """Return when a batch of that log time is due, or at once where it is late."""
        if not self._speed:
            return
        if self._first_ns < 0:
            self._first_ns = self._last_ns = t_ns
            self._origin_ns = self._origin_ns or time.monotonic_ns()
        if t_ns > self._last_ns:
            self._gap_ns, self._last_ns = t_ns - self._last_ns, t_ns
        due_ns = self._origin_ns + round((t_ns - self._first_ns) / self._speed)
        while (left_ns := due_ns - time.monotonic_ns()) > 0:
            time.sleep(min(left_ns / NANO, LONGEST_SLEEP_S))
        self._played.latest_ms = max(self._played.latest_ms, -left_ns / 1e6)

    def begin_pass(self) -> None:
        """The log begins again, one tick after its end."""
        self._origin_ns += round((self._last_ns - self._first_ns + self._gap_ns) / (self._speed or 1.0))
        self._first_ns = -1


def _send(transport: Transport, batch: bytes, played: Played) -> None:
    """Put a batch on the bus, again and again where it is full."""
    until_s = time.monotonic() + FULL_S
    counters = transport.counters
    while batch:
        before, lost = counters.tx, counters.tx_failed
        transport.send(batch)
        sent = counters.tx - before
        played.frames += sent
        if counters.tx_failed == lost:
            return
        if sent:
            until_s = time.monotonic() + FULL_S
        elif time.monotonic() > until_s:
            raise BusLostError(f"{transport.address} took no frame for {FULL_S:g} s: {counters.describe()}")
        batch = batch[sent * FRAME_SIZE :]
        time.sleep(RETRY_S)


def _iterate_batches(run: Run, channel: str, selection: Selection) -> Iterator[tuple[int, bytes, int]]:
    """Log time [ns], frames and how many were left out, for all frames of one time in a row."""
    first_ns = None
    ids = {"plant": SENT_BY_PLANT, "fsw": SENT_BY_FSW}.get(selection.only or "")
    for frames in run.iterate_frames(channel):
        if first_ns is None:
            first_ns = int(frames["t_ns"][0])
        since_s = (frames["t_ns"] - first_ns) / NANO
        inside = since_s >= selection.from_s
        if selection.until_s is not None:
            inside &= since_s < selection.until_s
        frames = frames[inside]
        wanted = np.ones(len(frames), bool) if ids is None else np.isin(frames["id"], ids)
        yield from _cut(frames, wanted)


def _cut(frames: NDArray[Any], wanted: NDArray[np.bool_]) -> Iterator[tuple[int, bytes, int]]:
    """The same, of frames in memory."""
    if not len(frames):
        return
    wire = np.zeros(len(frames), WIRE_DTYPE)
    for name in ("id", "dlc", "data"):
        wire[name] = frames[name]
    starts = [0, *(np.flatnonzero(np.diff(frames["t_ns"])) + 1).tolist(), len(frames)]
    for start, end in itertools.pairwise(starts):
        chosen = wire[start:end][wanted[start:end]]
        yield int(frames["t_ns"][start]), chosen.tobytes(), end - start - len(chosen)


def _describe(selection: Selection) -> str:
    """The words of a selection that may have left nothing."""
    words = f" from {selection.from_s:g} s on" if selection.from_s else ""
    words += f" until {selection.until_s:g} s" if selection.until_s is not None else ""
    return words + (f" that {selection.only} sends" if selection.only else "")
