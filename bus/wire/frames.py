"""Classic CAN frames as every transport carries them: Linux `struct can_frame`, 16 bytes, and batches of them.

Layout and flag bits: linux/can.h. A batch is any number of frames laid end to end in one `bytes`. CAN FD frames do
not fit this form; transports that meet them count them and leave them out.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterator, Sequence
from typing import Final

FRAME_SIZE: Final = 16
READS_AT_ONCE: Final = 4096  # so that a bus that never falls silent does not hold a reader for ever
FRAME = struct.Struct("=IB3x8s")  # can_id with flag bits, dlc, data
FRAME_ID = struct.Struct("=I12x")

EFF_FLAG: Final = 0x80000000  # 29-bit id
RTR_FLAG: Final = 0x40000000  # remote frame
ERR_FLAG: Final = 0x20000000  # error frame; in a filter's id: the filter is inverted
SFF_MASK: Final = 0x000007FF
EFF_MASK: Final = 0x1FFFFFFF

Filter = tuple[int, int]  # (id, mask), as CAN_RAW_FILTER: a frame passes when frame_id & mask == id & mask

_FLAG_BYTE: Final = 3 if sys.byteorder == "little" else 0
_VALID_DLCS = bytes(range(9))


def unpack_batch(batch: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Yield (can_id with flag bits, dlc, 8 data bytes) per frame. The batch is whole frames."""
    return FRAME.iter_unpack(batch)


def check_batch(batch: bytes) -> int:
    """Return the number of frames. Raises ValueError unless the batch is whole frames."""
    count, rest = divmod(len(batch), FRAME_SIZE)
    if rest:
        raise ValueError(f"a batch is whole frames of {FRAME_SIZE} bytes; {len(batch)} bytes is not")
    return count


def count_error_frames(batch: bytes) -> int:
    """Return how many frames of the batch are error frames [1]."""
    flags = batch[_FLAG_BYTE::FRAME_SIZE]
    if not flags.strip(b"\0"):
        return 0
    return sum(1 for flag in flags if flag & (ERR_FLAG >> 24))


def drop_malformed(batch: bytes) -> bytes:
    """Return the batch without the frames whose dlc is over 8, which a CAN controller could not send."""
    if not batch[4::FRAME_SIZE].strip(_VALID_DLCS):
        return batch
    return b"".join(batch[at : at + FRAME_SIZE] for at in range(0, len(batch), FRAME_SIZE) if batch[at + 4] <= 8)


class FrameFilter:
    """The frames that one receiver asked for, by the rules of CAN_RAW_FILTER.

    No filters (None): everything passes. An empty list: nothing but error frames. Error frames always pass: they tell
    of the bus, not of an id. Answers are remembered per id, so that a repeating schedule costs one look-up a frame.
    """

    __slots__ = ("_known", "_rules")

    def __init__(self, filters: Sequence[Filter] | None) -> None:
        self._rules = None if filters is None else tuple(filters)
        self._known: dict[int, bool] = {}

    @property
    def passes_all(self) -> bool:
        return self._rules is None

    def select(self, batch: bytes) -> bytes:
        """Return the frames of the batch that pass, in their order."""
        if self._rules is None:
            return batch
        known = self._known
        picked = []
        at = 0
        whole = True
        for (can_id,) in FRAME_ID.iter_unpack(batch):
            passes = known.get(can_id)
            if passes is None:
                passes = self._learn(can_id)
            if passes:
                picked.append(batch[at : at + FRAME_SIZE])
            else:
                whole = False
            at += FRAME_SIZE
        return batch if whole else b"".join(picked)

    def _learn(self, can_id: int) -> bool:
        passes = self._match(can_id)
        if len(self._known) >= 4096:  # random 29-bit ids must not fill the memory
            self._known.clear()
        self._known[can_id] = passes
        return passes

    def _match(self, can_id: int) -> bool:
        if can_id & ERR_FLAG:
            return True
        for wanted, mask in self._rules or ():
            equal = can_id & mask & ~ERR_FLAG == wanted & mask & ~ERR_FLAG
            if equal != bool(wanted & ERR_FLAG):
                return True
        return False
