"""A frame on its way."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Parcel:
    """One frame, from whom to whom, and when."""

    frame: bytes  # struct can_frame
    can_id: int
    sender: str
    receiver: str
    way: int  # TO_FSW, TO_PLANT
    number: int  # in the order in which frames were given to the wire
    tick: int  # on which that was
    due: int = 0  # when it may go on: a tick, or a bit of the bus's time
    is_swapped: bool = False  # lets those of its id go first
    is_extra: bool = False  # of a babbling node: not kept beyond the tick
    is_broken: bool = False
    ended: int = 0  # bit of the bus's time at which it was through

    @property
    def place(self) -> tuple[int, bool, int]:
        """The order of arbitration: the lowest id first; of one id the first, but one that lets others go first."""
        return (self.can_id, self.is_swapped, self.number)
