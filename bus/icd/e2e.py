"""End-to-end protection of the data frames: checksum with data id, alive counter, and what a receiver counts.

After AUTOSAR E2E profile 11: CRC-8 SAE-J1850, a 16-bit data id that is part of the checksum but not of the frame,
and a 4-bit counter 0..14. Differs from the profile: the id of a frame is its data id (DataID in the DBC), sent whole
into the checksum; a frame that repeats a counter is thrown away.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from typing import Any

from fastcrc.crc8 import sae_j1850

from bus.wire.frames import FRAME_ID, FRAME_SIZE

COUNTER_MODULUS = 15  # 0..14; 15 on the wire is never valid
NEXT_COUNTER = (*range(1, COUNTER_MODULUS), 0, 0)  # by the counter just sent

OK, LOST, REPEATED, INVALID, CRC, LENGTH, UNKNOWN = OUTCOMES = (
    "ok",  # counter as expected
    "lost",  # accepted, but frames before it are missing: `missing` counts them
    "repeated",  # the counter of the last frame again: thrown away
    "invalid",  # counter 15: thrown away
    "crc",  # checksum does not fit data and id: thrown away
    "length",  # not 8 bytes: thrown away
    "unknown",  # an id that this receiver does not take: thrown away
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


class Link:
    """Receiver state of one id: the counter expected next and what has arrived so far."""

    __slots__ = ("accepted", "decode", "expected", "faults", "missing", "outcome")

    def __init__(self, decode: Callable[[bytes], tuple[Any, ...] | None]) -> None:
        self.decode = decode
        self.expected = -1  # no frame yet: any counter starts the sequence
        self.accepted = 0
        self.missing = 0  # frames that the counter says were sent and that did not arrive (modulo 15)
        self.faults = dict.fromkeys((LOST, REPEATED, INVALID, CRC, LENGTH), 0)
        self.outcome = OK  # of the last frame

    def accept(self, data: bytes) -> tuple[Any, ...] | None:
        """Values of one frame as its decoder gives them, or None where the frame was thrown away and counted."""
        values = self.decode(data)
        if values is None:
            self._count(CRC if len(data) == 8 else LENGTH)
            return None
        counter = values[0]
        if counter == self.expected:
            self.outcome = OK
        elif not self._follow(counter):
            return None
        self.accepted += 1
        self.expected = NEXT_COUNTER[counter]
        return values

    def _follow(self, counter: int) -> bool:
        """True where a frame with an unexpected counter is still good."""
        if counter >= COUNTER_MODULUS:
            self._count(INVALID)
            return False
        if self.expected < 0:
            self.outcome = OK
            return True
        gap = (counter - self.expected) % COUNTER_MODULUS
        if gap == COUNTER_MODULUS - 1:
            self._count(REPEATED)
            return False
        self._count(LOST)
        self.missing += gap
        return True

    def _count(self, outcome: str) -> None:
        self.faults[outcome] += 1
        self.outcome = outcome


class LinkGroup:
    """The links of frames that come together, with one alive counter: kept as one while all goes well.

    Whoever has checked a whole batch at once with the counter `expected` (`decode_sensors`, `decode_commands`) calls
    `accept`. Before anything touches the links themselves, `part` brings them up to date; after it, `join`.
    """

    __slots__ = ("_links", "_pending", "expected")

    def __init__(self, links: Sequence[Link]) -> None:
        self._links = tuple(links)
        self._pending = 0  # batches accepted that the links do not know of
        self.expected = -1
        self.join()

    def accept(self) -> None:
        """Take one frame on every link, each with the expected counter."""
        self._pending += 1
        self.expected = NEXT_COUNTER[self.expected]

    def part(self) -> None:
        """Bring the links to where `Link.accept` would have brought them frame by frame."""
        if self._pending:
            for link in self._links:
                link.accepted += self._pending
                link.expected = self.expected
                link.outcome = OK
            self._pending = 0

    def join(self) -> None:
        """Find the counter that all links expect next: -1 while they do not expect the same."""
        counters = {link.expected for link in self._links}
        self.expected = counters.pop() if len(counters) == 1 else -1


def part_group(batch: bytes, size: int, group_ids: Container[int]) -> tuple[bytes, bytes] | None:
    """Frames that come together, `size` bytes with the last of them at the end, and whatever stands ahead of that one.

    None where that is not whole frames of other ids, so that it would matter which are looked at first.
    """
    ahead = batch[size - FRAME_SIZE : -FRAME_SIZE]
    if not ahead or len(ahead) % FRAME_SIZE or any(can_id in group_ids for (can_id,) in FRAME_ID.iter_unpack(ahead)):
        return None
    return batch[: size - FRAME_SIZE] + batch[-FRAME_SIZE:], ahead


class Receiver:
    """Checks every frame that arrives and counts by name what was wrong with it. Never raises on any bytes."""

    __slots__ = ("links", "unknown")

    def __init__(self, decoders: Mapping[int, Callable[[bytes], tuple[Any, ...] | None]]) -> None:
        self.links = {frame_id: Link(decode) for frame_id, decode in decoders.items()}
        self.unknown = 0

    def accept(self, frame_id: int, data: bytes) -> tuple[Any, ...] | None:
        """Values of a good frame (counter, high nibble, signals), or None where it was thrown away and counted."""
        link = self.links.get(frame_id)
        if link is None:
            self.unknown += 1
            return None
        return link.accept(data)

    def counts(self) -> dict[str, int]:
        """Frames by outcome over all ids; 'ok' are those accepted in sequence, 'missing' those that never arrived."""
        links = self.links.values()
        totals = {outcome: sum(link.faults[outcome] for link in links) for outcome in (LOST, REPEATED, INVALID, CRC)}
        ok = sum(link.accepted for link in links) - totals[LOST]
        return {
            OK: ok,
            **totals,
            LENGTH: sum(link.faults[LENGTH] for link in links),
            UNKNOWN: self.unknown,
            "missing": sum(link.missing for link in links),
        }
