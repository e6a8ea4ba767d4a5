"""How long a frame is on the wire: checksum and stuffing against a bit-by-bit reading of the standard."""

from __future__ import annotations

import random

import pytest

from bus.icd.load import worst_case_bits
from bus.wire.frames import FRAME
from plant_server.can_bus.frame_time import count_bits, count_frame_bits, find_crc

GENERATOR = 0b1100010110011001  # x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1, Bosch CAN 2.0, section 3.1.1


def list_bits(value: int, count: int) -> list[int]:
    return [value >> shift & 1 for shift in range(count - 1, -1, -1)]


def list_head(can_id: int, dlc: int, data: bytes) -> list[int]:
    """Start, id, remote, extension, reserved, length and data of a frame, bit by bit."""
    bits = [0, *list_bits(can_id, 11), 0, 0, 0, *list_bits(dlc, 4)]
    for byte in data[:dlc]:
        bits += list_bits(byte, 8)
    return bits


def divide(bits: list[int]) -> int:
    """The remainder of a polynomial with 15 zeros behind it by the generator: long division, as on paper."""
    rest = [*bits, *[0] * 15]
    generator = list_bits(GENERATOR, 16)
    for at in range(len(bits)):
        if rest[at]:
            for offset, bit in enumerate(generator):
                rest[at + offset] ^= bit
    return int("".join(map(str, rest[-15:])), 2)


def stuff(bits: list[int]) -> list[int]:
    """Bits with a complementary one behind each five equal ones, stuffed ones counted along."""
    out: list[int] = []
    for bit in bits:
        out.append(bit)
        if len(out) >= 5 and len(set(out[-5:])) == 1 and find_run(out) == 5:
            out.append(1 - bit)
    return out


def find_run(bits: list[int]) -> int:
    run = 1
    while run < len(bits) and bits[-run - 1] == bits[-1]:
        run += 1
    return run


def measure(can_id: int, dlc: int, data: bytes) -> int:
    head = list_head(can_id, dlc, data)
    return len(stuff([*head, *list_bits(divide(head), 15)])) + 1 + 1 + 1 + 7 + 3


@pytest.mark.parametrize("dlc", range(9))
def test_bits_are_those_of_the_frame_laid_out(dlc: int) -> None:
    """Checksum and length of 60 frames of each size, random ones and those of long runs, against plain lists of bits."""
    chance = random.Random(dlc)
    for number in range(60):
        can_id = chance.choice([0, 0x7FF, 0x78F, chance.randrange(0x800)])
        data = bytes(chance.choice([0, 0xFF, 0x1F, 0x83, chance.randrange(256)]) for _ in range(8))
        head = list_head(can_id, dlc, data)
        assert find_crc(can_id, dlc, data) == divide(head), number
        assert count_bits(can_id, dlc, data) == measure(can_id, dlc, data), number


@pytest.mark.parametrize("dlc", range(9))
def test_no_frame_is_longer_than_the_published_worst_case(dlc: int) -> None:
    """Davis et al. 2007, eq (1), without and with all stuff bits: bounds of 2000 random frames."""
    chance = random.Random(100 + dlc)
    least = 34 + 8 * dlc + 13
    for _ in range(2000):
        data = bytes(chance.choice([0, 0xFF, chance.randrange(256)]) for _ in range(8))
        assert least <= count_bits(chance.randrange(0x800), dlc, data) <= worst_case_bits(dlc)


def test_the_head_of_a_worst_case_frame_has_the_published_stuff_bits() -> None:
    """A pattern that stuffs as often as it can: a stuff bit for every four bits of data, as Davis et al. 2007 draw it."""
    data = bytes([0b00111100, 0b00111100] * 4)
    plain = count_bits(0x555, 8, bytes([0x55] * 8))
    assert plain < count_bits(0x078, 8, data) <= 135
    assert count_bits(0x078, 8, data) >= 34 + 64 + 13 + 16  # of 64 data bits every fourth


def test_a_frame_is_measured_by_its_own_length() -> None:
    """What stands behind the data bytes in a struct can_frame does not count."""
    assert count_frame_bits(FRAME.pack(0x123, 2, b"\x12\x34")) == count_bits(0x123, 2, b"\x12\x34")
    assert count_frame_bits(FRAME.pack(0x123, 2, b"\x12\x34\xff\xff")) == count_bits(0x123, 2, b"\x12\x34")


@pytest.mark.parametrize(("can_id", "dlc", "data"), [(0x800, 0, b""), (1, 9, bytes(9)), (1, 3, b"ab"), (-1, 0, b"")])
def test_what_is_no_classic_frame_is_refused(can_id: int, dlc: int, data: bytes) -> None:
    """Ids beyond 11 bits, more than 8 bytes, fewer bytes than said."""
    with pytest.raises(ValueError, match="no classic data frame"):
        count_bits(can_id, dlc, data)
