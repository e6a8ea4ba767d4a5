"""End-to-end protection of the data frames: checksum with data id, alive counter, and what a receiver counts.

After AUTOSAR E2E profile 11: CRC-8 SAE-J1850, a 16-bit data id that is part of the checksum but not of the frame, a
4-bit counter 0..14, and a largest jump of it that is accepted (MaxDeltaCounter). Differs from the profile: the id of a
frame is its data id (DataID in the DBC), sent whole into the checksum; a frame that repeats a counter is thrown away;
a receiver that has lost the sequence finds the new one by itself, and notices two senders of one id.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from typing import Any, Final

from fastcrc.crc8 import sae_j1850

from bus.wire.frames import FRAME, FRAME_ID, FRAME_SIZE

COUNTER_MODULUS: Final = 15  # 0..14; 15 on the wire is never valid
NEXT_COUNTER = (*range(1, COUNTER_MODULUS), 0, 0)  # by the counter just sent

MAX_JUMP: Final = 3  # of the counter between two frames that are taken: two frames may be lost in a row
RESYNC_FRAMES: Final = 2  # in a row that a new sequence needs once the old one has fallen silent
ELDER_FRAMES: Final = 4  # taken since a jump, in which the sequence before it may prove to be alive
SUSPECT: Final = 10.0  # counts ahead of the sender's rate, from which there is a second sender
CERTAIN: Final = 30.0
FORGET_PER_TICK: Final = 0.01  # counts ahead that are forgotten per count of that rate, for a sender that started again

OK, LOST, REPEATED, INVALID, JUMP, CRC, LENGTH = OUTCOMES = (
    "ok",  # counter as expected
    "lost",  # accepted, but frames before it are missing: `missing` counts them
    "repeated",  # the counter of the last frame again: thrown away
    "invalid",  # counter 15: thrown away
    "jump",  # further ahead than MAX_JUMP: thrown away
    "crc",  # checksum does not fit data and id: thrown away
    "length",  # not 8 bytes: thrown away
)


def checksum(data_id: int, payload: bytes) -> int:
    """Checksum byte of a frame: CRC-8 SAE-J1850 over the data id, low byte first, then the payload (bytes 1..7)."""
    return sae_j1850(payload, checksum_start(data_id))


def checksum_start(data_id: int) -> int:
    """Start value that makes `sae_j1850(payload, start)` the checksum with this data id included."""
    return sae_j1850(data_id.to_bytes(2, "little"))


def residue_start(data_id: int) -> int:
    """Start value that makes `sae_j1850(frame, start)` equal `RESIDUES[frame[0]]` exactly for frames of this data id.

    The CRC is linear, so the checksum byte itself may run through it first, which spares a receiver the copy
    `frame[1:]`. The start value is the one from which a leading zero byte arrives at `checksum_start`.
    """
    return next(start for start in range(256) if sae_j1850(b"\0", start) == checksum_start(data_id))


# What a CRC over checksum byte and payload leaves, by checksum byte. 0xFF as start value is register 0.
RESIDUES = tuple(byte ^ 0xFF ^ sae_j1850(bytes((byte, 0, 0, 0, 0, 0, 0, 0)), 0xFF) for byte in range(256))


class Pace:
    """How far the counter of one id, in order of arrival, is ahead of its sender's rate, which no sender exceeds for long.

    Lost frames do not change that: the counter goes on without them. Two senders that take turns make it go round once
    for every frame of either.
    """

    __slots__ = ("_counter", "_every", "_frames", "_tick", "ahead")

    def __init__(self, every_ticks: int) -> None:
        self.ahead = 0.0  # counts
        self._every = every_ticks
        self._counter = 0  # of the last frame that was looked at,
        self._frames = 0  # how many had been accepted up to and with it,
        self._tick = 0  # and when that was

    def look(self, counter: int, tick: int, expected: int, accepted: int) -> None:
        """Look at a frame that is not in sequence.

        expected, accepted : of the link before this frame; those accepted since the last look came in sequence
        """
        since = accepted - self._frames
        if not since and counter == self._counter:
            advance = 0  # it stands: a sender that is stuck, where two would have moved it
        elif since:
            advance = _step(self._counter, expected - since) + since - 1 + _step(expected - 1, counter)
        else:
            advance = _step(self._counter, counter)
        forgotten = (1.0 + FORGET_PER_TICK) * (tick - self._tick) / self._every
        self.ahead = max(-COUNTER_MODULUS, self.ahead + advance - forgotten)
        self.note(counter, tick, accepted)

    def note(self, counter: int, tick: int, accepted: int) -> None:
        """Take this frame as the one to count from."""
        self._counter, self._tick, self._frames = counter, tick, accepted


def _step(before: int, counter: int) -> int:
    """Counts from one frame to the next: 1..15, for the same counter again comes a whole turn later."""
    return (counter - before - 1) % COUNTER_MODULUS + 1


class Link:
    """Receiver state of one id: the counter expected next and what has arrived so far.

    A frame that is neither the next nor nearly the next is thrown away. It may be the first after an outage, or of a
    second sender; so what would continue it is kept as the other sequence:

    - While the old sequence goes on, frames of the other one are thrown away.
    - Once the old one is silent, the other is taken from its second frame in a row on; but where a second sender is
      suspected, only when its counter comes by the expected one.
    - A sequence that was left for another one, by such a change or by a small jump, is gone back to when it turns out
      to be alive: who came first stays.

    Two senders make the counter run too fast: then `rivals` counts the frames that are out of sequence.
    """

    __slots__ = (
        "_elder", "_every", "_other", "_other_at", "_pace", "_row", "accepted", "decode", "expected", "faults", "last",
        "missing", "outcome", "rivals", "tick",
    )  # fmt: skip

    def __init__(self, decode: Callable[[bytes], tuple[Any, ...] | None], every_ticks: int = 1) -> None:
        """Listen to an id that is sent once in so many ticks of the receiver, or less often."""
        self.decode = decode
        self._every = every_ticks
        self.expected = -1  # no frame yet: any counter starts the sequence
        self.accepted = 0
        self.missing = 0  # frames that the counter says were sent and that were not taken (modulo 15)
        self.rivals = 0  # frames that show a second sender of this id
        self.faults = dict.fromkeys((LOST, REPEATED, INVALID, JUMP, CRC, LENGTH), 0)
        self.outcome = OK  # of the last frame
        self.last = b""  # frame that was taken
        self.tick = 0  # at which that was
        self._pace = Pace(every_ticks)
        self._other = -1  # counter that would continue the other sequence; -1: there is none
        self._other_at = 0  # value of `accepted` when it was last heard
        self._row = 0  # its frames since the own sequence went on
        self._elder = False  # it was there before the own one

    def accept(self, data: bytes, tick: int) -> tuple[Any, ...] | None:
        """Values of one frame as its decoder gives them, or None where the frame was thrown away and counted.

        tick : of the receiver, in which it takes this frame
        """
        values = self.decode(data)
        if values is None:
            self._count(CRC if len(data) == 8 else LENGTH)
            return None
        counter = values[0]
        if counter == self.expected:
            self.outcome = OK
        elif not self._follow(counter, data, tick):
            return None
        self.accepted += 1
        self.expected = NEXT_COUNTER[counter]
        self.last = data
        self.tick = tick
        return values

    def _follow(self, counter: int, data: bytes, tick: int) -> bool:
        """True where a frame with an unexpected counter is still good."""
        if counter >= COUNTER_MODULUS:
            self._count(INVALID)
            return False
        if self.expected < 0:
            self._pace.note(counter, tick, 1)
            self.outcome = OK
            return True
        if data == self.last:
            self._count(REPEATED)
            return False
        self._pace.look(counter, tick, self.expected, self.accepted)
        if self._pace.ahead >= CERTAIN:
            self.rivals += 1
        is_good = self._judge(counter, tick)
        self._pace.note(counter, tick, self.accepted + is_good)
        return is_good

    def _judge(self, counter: int, tick: int) -> bool:
        gap = (counter - self.expected) % COUNTER_MODULUS
        if self._other >= 0 and (counter - self._other) % COUNTER_MODULUS < min(gap, MAX_JUMP):
            if not self._elder:
                return self._hear_other(counter, tick)
            if self.accepted - self._other_at <= ELDER_FRAMES:
                self._leave()
                self._elder = False
                self.outcome = OK
                return True
        if gap < MAX_JUMP:
            if self._pace.ahead < SUSPECT:  # else the other sequence is known and stays so
                self._leave()
            self._skip(gap)
            return True
        if gap == COUNTER_MODULUS - 1:  # the counter of the last frame, but not that frame
            self._count(REPEATED)
            return False
        self._count(JUMP)
        self._other, self._other_at, self._row, self._elder = NEXT_COUNTER[counter], self.accepted, 1, False
        return False

    def _hear_other(self, counter: int, tick: int) -> bool:
        """True where the frame that continues the other sequence is taken."""
        self._row = self._row + 1 if self.accepted == self._other_at else 1
        is_silent = tick - self.tick > MAX_JUMP * self._every  # an outage with this jump has taken as long
        if self._row >= RESYNC_FRAMES and is_silent and self._pace.ahead < SUSPECT:
            gap = (counter - self.expected) % COUNTER_MODULUS
            self._leave()
            self._skip(gap)
            return True
        self._count(JUMP)
        self._other, self._other_at = NEXT_COUNTER[counter], self.accepted
        return False

    def _leave(self) -> None:
        """Let the own sequence be the other one."""
        self._other, self._other_at, self._row, self._elder = self.expected, self.accepted, 0, True

    def _skip(self, gap: int) -> None:
        self.missing += gap
        self._count(LOST)

    def _count(self, outcome: str) -> None:
        self.faults[outcome] += 1
        self.outcome = outcome


class LinkGroup:
    """The links of frames that come together, with one alive counter: kept as one while all goes well.

    Whoever has checked a whole batch at once with the counter `expected` (`decode_sensors`, `decode_commands`) calls
    `accept`. Before anything touches the links themselves, `part` brings them up to date; after it, `join`.
    """

    __slots__ = ("_batch", "_links", "_pending", "_tick", "expected")

    def __init__(self, links: Sequence[Link]) -> None:
        """Keep these links, in the order of the frames in a batch."""
        self._links = tuple(links)
        self._pending = 0  # batches accepted that the links do not know of,
        self._batch = b""  # the last of them,
        self._tick = 0  # and when that was
        self.expected = -1
        self.join()

    def accept(self, batch: bytes, tick: int) -> None:
        """Take one frame on every link, each with the expected counter. `batch` is those frames and no others."""
        self._pending += 1
        self._batch = batch
        self._tick = tick
        self.expected = NEXT_COUNTER[self.expected]

    def part(self) -> None:
        """Bring the links to where `Link.accept` would have brought them frame by frame."""
        if self._pending:
            for link, (_, _, data) in zip(self._links, FRAME.iter_unpack(self._batch), strict=True):
                link.accepted += self._pending
                link.expected = self.expected
                link.outcome = OK
                link.last = data
                link.tick = self._tick
            self._pending = 0

    def stay_apart(self) -> None:
        """Let the next frames be looked at one by one, whatever the links expect."""
        self.expected = -1

    def join(self) -> None:
        """Find the counter that all links expect next: -1 while they do not expect the same."""
        counters = {link.expected for link in self._links}
        self.expected = counters.pop() if len(counters) == 1 else -1


def part_group(batch: bytes, size: int, group_ids: Container[int]) -> tuple[bytes, bytes] | None:
    """Frames that come together, `size` bytes with the last of them at the end, and whatever stands ahead of that one.

    None where that is not whole frames of other ids, so that it would matter which are looked at first.
    """
    if len(batch) <= size:
        return None
    ahead = batch[size - FRAME_SIZE : -FRAME_SIZE]
    if len(ahead) % FRAME_SIZE or any(can_id in group_ids for (can_id,) in FRAME_ID.iter_unpack(ahead)):
        return None
    return batch[: size - FRAME_SIZE] + batch[-FRAME_SIZE:], ahead
