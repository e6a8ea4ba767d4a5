"""The error states of a CAN controller, ISO 11898-1, fault confinement: two counters, three states.

    active --a counter reaches 128--> passive --both below 128--> active
    any --the transmit counter reaches 256--> off --128 times 11 recessive bits--> active, counters 0

The warning from 96 on is the one that controllers report; the standard does not name it. Not modelled: the exceptions for
stuff errors during arbitration, and the eight bits more that a passive node waits between two frames of its own.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

WARNING_AT: Final = 96
PASSIVE_AT: Final = 128
OFF_AT: Final = 256
TRANSMIT_STEP: Final = 8
DOMINANT_STEP: Final = 8  # for each eight dominant bits beyond an error flag
RECOVERY_SEQUENCES: Final = 128  # of 11 recessive bits
SEQUENCE_BITS: Final = 11
AFTER_PASSIVE: Final = 127  # the standard: between 119 and 127
REC_CAP: Final = 255  # beyond it nothing changes: the register of real controllers has 8 bits


class State(IntEnum):
    """What a controller may still do."""

    ACTIVE = 0
    PASSIVE = 1
    OFF = 2


class Controller:
    """One node's controller."""

    __slots__ = ("_sequences", "rec", "state", "tec")

    def __init__(self) -> None:
        self.tec = 0  # transmit error counter; stays where it was while the bus is off
        self.rec = 0  # receive error counter
        self.state = State.ACTIVE
        self._sequences = 0  # of 11 recessive bits, seen since the bus is off

    @property
    def warns(self) -> bool:
        """Whether a counter has reached the warning limit."""
        return max(self.tec, self.rec) >= WARNING_AT

    @property
    def is_off(self) -> bool:
        """Whether it neither sends nor hears."""
        return self.state is State.OFF

    def note_sent(self) -> None:
        """A frame of its own went through."""
        if self.state is not State.OFF:
            self.tec = max(0, self.tec - 1)
            self._judge()

    def note_heard(self) -> None:
        """A frame of another node was received without an error."""
        if self.state is not State.OFF:
            self.rec = AFTER_PASSIVE if self.rec > AFTER_PASSIVE else max(0, self.rec - 1)
            self._judge()

    def note_send_error(self, *, only_unacknowledged: bool = False) -> None:
        """An attempt of its own failed; one that merely nobody acknowledged no longer counts once it is passive."""
        if self.state is State.OFF or (only_unacknowledged and self.state is State.PASSIVE):
            return
        self.tec += TRANSMIT_STEP
        self._judge()

    def note_hear_error(self) -> None:
        """A frame of another node had an error."""
        if self.state is not State.OFF:
            self.rec = min(REC_CAP, self.rec + 1)
            self._judge()

    def note_dominant(self, times_eight_bits: int) -> None:
        """After its error flag as a receiver the bus stayed dominant for so many times eight bits."""
        if self.state is not State.OFF:
            self.rec = min(REC_CAP, self.rec + DOMINANT_STEP * times_eight_bits)
            self._judge()

    def note_recessive(self, sequences: int) -> bool:
        """So many sequences of 11 recessive bits went by; return whether it is back on the bus with that."""
        if self.state is not State.OFF:
            return False
        self._sequences += sequences
        if self._sequences < RECOVERY_SEQUENCES:
            return False
        self.tec = self.rec = 0
        self.state = State.ACTIVE
        return True

    def _judge(self) -> None:
        if self.tec >= OFF_AT:
            self.state = State.OFF
            self._sequences = 0
        elif self.tec >= PASSIVE_AT or self.rec >= PASSIVE_AT:
            self.state = State.PASSIVE
        else:
            self.state = State.ACTIVE
