"""Heartbeats: what a peer says of itself."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from bus.icd.codec import DECODERS
from bus.wire.frames import FRAME

HEARTBEAT_S: Final = 1.0  # between two of a node, and between two TIME frames
BOOT: Final = 0  # STATE of the frame
STOPPED: Final = 4
OPERATIONAL: Final = 5
PRE_OPERATIONAL: Final = 127
FAILED: Final = 128


def count_heartbeat_ticks(tick_s: float) -> int:
    """Ticks between two heartbeats."""
    return max(1, round(HEARTBEAT_S / tick_s))


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
