"""Heartbeats: what a peer says of itself, and when it is believed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from bus.icd.codec import DECODERS
from bus.icd.e2e import Link
from bus.wire.frames import FRAME

BOOT, STOPPED, OPERATIONAL, PRE_OPERATIONAL, FAILED = 0, 4, 5, 127, 128  # STATE of the frame


def find_heartbeats(batch: bytes, frame_id: int) -> Iterator[tuple[int, int]]:
    """Yield state and run hash of the heartbeats of that id in a batch; alive counters are not looked at.

    For the meeting only, where several peers of one kind may speak, each with a counter of its own.
    """
    decode = DECODERS[frame_id]
    for can_id, length, data in FRAME.iter_unpack(batch):
        if can_id == frame_id and length == 8:
            values = decode(data)
            if values is not None:
                yield values[2], values[3]


class PeerHeartbeat:
    """State of the peer during a run, from heartbeats that carry this run's hash and are in sequence.

    One frame alone does not end a run: STOPPED holds only while no frame of a later tick comes (`deny_stop`), so
    whoever waits for the end looks at `state` once the peer has fallen silent.
    """

    __slots__ = ("_run_hash", "false_stops", "foreign", "link", "state")

    def __init__(self, decode: Callable[[bytes], tuple[Any, ...] | None], run_hash: int) -> None:
        self.link = Link(decode)
        self.state = -1  # nothing heard yet
        self.foreign = 0  # heartbeats of another run; they do not move the sequence
        self.false_stops = 0  # times that the peer went on after STOPPED or FAILED was heard
        self._run_hash = run_hash

    def accept(self, data: bytes, tick: int) -> bool:
        """Take one heartbeat frame; return whether it was believed. What was not is counted here or in `link`."""
        values = self.link.decode(data)
        if values is not None and values[3] != self._run_hash:
            self.foreign += 1
            return False
        if self.link.accept(data, tick) is None or values is None:
            return False
        self.state = values[2]
        return True

    def deny_stop(self) -> None:
        """Note that the peer has sent a frame of a tick, so that it has not ended whatever a heartbeat said."""
        if self.state in (STOPPED, FAILED):
            self.state = OPERATIONAL
            self.false_stops += 1
