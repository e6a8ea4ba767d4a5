"""How long a classic CAN frame is on the wire: exact stuffing, after ISO 11898-1 (Bosch CAN 2.0, part A, sections 3 and 5).

From start of frame to the end of the checksum a complementary bit follows five equal ones; the ten bits behind that and the
three of the interframe space are never stuffed. 11-bit ids, data frames.
"""

from __future__ import annotations

from typing import Final

from bus.wire.frames import FRAME

CRC_POLYNOMIAL: Final = 0x4599  # x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1
CRC_BITS: Final = 15
TAIL_BITS: Final = 10  # delimiter, acknowledgement and its delimiter, end of frame
SPACE_BITS: Final = 3  # between two frames
HEADER_BITS: Final = 19  # start, id, remote, two reserved, length
STUFF_AFTER: Final = 5  # equal bits
ERROR_BITS: Final = (
    20  # an error frame with its flags overlapping as far as they can, and the space behind it: 6 to 12 + 8
)
BYTES: Final = 8


def find_crc(can_id: int, dlc: int, data: bytes) -> int:
    """Return the 15-bit checksum over start, id, control and data [1]. Leading zeros do not change it, its register is 0."""
    bits = (can_id << 7 | dlc) << 8 * dlc | int.from_bytes(data[:dlc], "big")
    crc = 0
    for byte in bits.to_bytes(3 + dlc, "big"):
        crc = (crc << BYTES ^ _CRC_TABLE[crc >> CRC_BITS - BYTES ^ byte]) & 0x7FFF
    return crc


def count_bits(can_id: int, dlc: int, data: bytes) -> int:
    """Return the bits of a data frame on the wire with its stuff bits and the space behind it [bit].

    can_id : 11 bits. dlc: 0..8. data: at least dlc bytes. Raises ValueError for any other.
    """
    if not 0 <= can_id <= 0x7FF or not 0 <= dlc <= 8 or len(data) < dlc:
        raise ValueError(f"0x{can_id:X} with {dlc} bytes is no classic data frame with an 11-bit id")
    head = (can_id << 7 | dlc) << 8 * dlc | int.from_bytes(data[:dlc], "big")
    length = HEADER_BITS + 8 * dlc + CRC_BITS  # two more than whole bytes
    stuffable = head << CRC_BITS | find_crc(can_id, dlc, data)
    state, stuffed = _START, 0
    for shift in (length - 1, length - 2):
        state, more = _step(state, stuffable >> shift & 1)
        stuffed += more
    for byte in (stuffable & ((1 << length - 2) - 1)).to_bytes((length - 2) // BYTES, "big"):
        state, more = _STUFF_TABLE[state][byte]
        stuffed += more
    return length + stuffed + TAIL_BITS + SPACE_BITS


def count_frame_bits(frame: bytes) -> int:
    """Return the bits of a struct can_frame on the wire; of an extended or remote one those of its 11 highest id bits."""
    can_id, dlc, data = FRAME.unpack(frame)
    return count_bits(can_id & 0x7FF, min(dlc, 8), data)


# a state is 2 * (equal bits so far, 0..4) + their value; after five of them the stuff bit counts as the first of its value
_START: Final = 1  # before the start bit the bus was recessive, which does not count


def _step(state: int, bit: int) -> tuple[int, int]:
    """Return the state after one more bit, and how many bits were stuffed behind it."""
    run = (state >> 1) + 1 if state & 1 == bit else 1
    if run < STUFF_AFTER:
        return run << 1 | bit, 0
    return 1 << 1 | 1 - bit, 1


def _walk(state: int, byte: int) -> tuple[int, int]:
    stuffed = 0
    for shift in range(7, -1, -1):
        state, more = _step(state, byte >> shift & 1)
        stuffed += more
    return state, stuffed


def _divide(byte: int) -> int:
    """Return what a byte at the top of the register leaves in it."""
    crc = byte << CRC_BITS - BYTES
    for _ in range(BYTES):
        crc = crc << 1 ^ (CRC_POLYNOMIAL if crc & 0x4000 else 0)
        crc &= 0x7FFF
    return crc


_CRC_TABLE: Final = tuple(_divide(byte) for byte in range(256))
_STUFF_TABLE: Final = tuple(tuple(_walk(state, byte) for byte in range(256)) for state in range(10))
