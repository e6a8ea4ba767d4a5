"""End-to-end protection: the checksum against its published check value, and what a receiver makes of a sequence."""

from __future__ import annotations

from fastcrc.crc8 import sae_j1850

from bus.icd import codec as icd_codec
from bus.icd import e2e
from bus.icd.e2e import Link, Receiver, part_group
from bus.icd.messages import MESSAGES
from bus.wire.frames import FRAME

SPEED_FRAME_ID = 0x190


def divide_crc8(data: bytes) -> int:
    """CRC-8 SAE-J1850 by polynomial long division, bit by bit: polynomial 0x1D, start 0xFF, final xor 0xFF."""
    register = 0xFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = (register << 1) ^ (0x11D if register & 0x80 else 0)
    return register ^ 0xFF


def speed_frame(counter: int, speed_rad_s: float = 1.0) -> bytes:
    return icd_codec.encode_RW1_TLM(counter, 0, speed_rad_s, 0, 0)[8:]


def feed(counters: list[int]) -> tuple[Link, list[str]]:
    link = Link(icd_codec.decode_RW1_TLM)
    outcomes = []
    for counter in counters:
        values = link.accept(speed_frame(counter))
        assert (values is not None) == (link.outcome in (e2e.OK, e2e.LOST))
        outcomes.append(link.outcome)
    return link, outcomes


def test_check_value_of_the_catalogue() -> None:
    """AUTOSAR and the CRC catalogue give 0x4B for "123456789"; division and the library must both say so."""
    assert divide_crc8(b"123456789") == 0x4B
    assert sae_j1850(b"123456789") == 0x4B


def test_checksum_is_over_data_id_low_byte_first_then_payload() -> None:
    """0x3231 is "12" low byte first, so id and payload together are the string of the check value."""
    assert e2e.checksum(0x3231, b"3456789") == 0x4B


def test_checksum_equals_division_for_every_data_id_in_use() -> None:
    """The data id absorbed in the start value gives what dividing id and payload gives."""
    payload = bytes.fromhex("31a5005affc377")
    for message in MESSAGES.values():
        expected = divide_crc8(message.data_id.to_bytes(2, "little") + payload)
        assert e2e.checksum(message.data_id, payload) == expected


def test_residue_accepts_exactly_the_right_checksum() -> None:
    """Running the CRC through the checksum byte first must accept one checksum of 256, the divided one."""
    payload = bytes.fromhex("0e01027f80fe55")
    for data_id in (0, 0x110, 0xFFFF):
        start = e2e.residue_start(data_id)
        good = [c for c in range(256) if sae_j1850(bytes([c]) + payload, start) == e2e.RESIDUES[c]]
        assert good == [divide_crc8(data_id.to_bytes(2, "little") + payload)]


def test_data_ids_differ_in_the_checksum() -> None:
    """16-bit ids fold to 8 bits: two that fold alike would let one unit's frame pass as the other's."""
    starts = {e2e.checksum_start(message.data_id) for message in MESSAGES.values()}
    assert len(starts) == len(MESSAGES)


def test_sequence_of_two_wraps_is_ok() -> None:
    """0..14 and again: 14 is followed by 0, and any counter may come first."""
    link, outcomes = feed([(7 + k) % 15 for k in range(40)])
    assert outcomes == [e2e.OK] * 40
    assert (link.accepted, link.missing, sum(link.faults.values())) == (40, 0, 0)


def test_next_counter_never_yields_fifteen() -> None:
    """Whatever a sender holds, what it sends next is 0..14, one up."""
    assert [e2e.NEXT_COUNTER[c] for c in range(16)] == [*range(1, 15), 0, 0]


def test_repeated_counter_is_thrown_away() -> None:
    """A frame with the counter of the last one is stale data; the one after it is in sequence again."""
    link, outcomes = feed([3, 3, 3, 4])
    assert outcomes == [e2e.OK, e2e.REPEATED, e2e.REPEATED, e2e.OK]
    assert (link.accepted, link.faults[e2e.REPEATED], link.missing) == (2, 2, 0)


def test_gap_is_accepted_and_counted_frame_by_frame() -> None:
    """13 -> 1 leaves out 14 and 0; 1 -> 0 leaves out 2..14, the largest gap that the counter can tell."""
    link, outcomes = feed([13, 1, 2, 1])
    assert outcomes == [e2e.OK, e2e.LOST, e2e.OK, e2e.LOST]
    assert (link.accepted, link.faults[e2e.LOST], link.missing) == (4, 2, 2 + 13)


def test_counter_fifteen_is_never_valid() -> None:
    """15 is thrown away, as the first frame too, and does not move the sequence."""
    link, outcomes = feed([15, 5, 15, 6])
    assert outcomes == [e2e.INVALID, e2e.OK, e2e.INVALID, e2e.OK]
    assert link.missing == 0


def test_bad_checksum_and_length_leave_the_sequence_alone() -> None:
    """A broken frame tells nothing, not even its counter: the next good one shows the gap."""
    link = Link(icd_codec.decode_RW1_TLM)
    assert link.accept(speed_frame(0)) is not None
    broken = bytearray(speed_frame(1))
    broken[3] ^= 0x10
    assert link.accept(bytes(broken)) is None
    assert link.outcome == e2e.CRC
    assert link.accept(speed_frame(2)[:7]) is None
    assert link.outcome == e2e.LENGTH
    assert link.accept(speed_frame(3)) is not None
    assert (link.outcome, link.missing) == (e2e.LOST, 2)


def test_receiver_counts_by_name_over_all_ids() -> None:
    """Every frame that went in is in exactly one count; frames that never arrived are counted apart."""
    receiver = Receiver(icd_codec.DECODERS)
    gyro = icd_codec.encode_FOGX_RATE(0, 0, 0.0, 0)[8:]
    assert receiver.accept(SPEED_FRAME_ID, speed_frame(0, 12.5)) == (0, 0, 12.5, 0, 0)
    assert receiver.accept(SPEED_FRAME_ID, speed_frame(2)) is not None  # 1 is lost
    assert receiver.accept(SPEED_FRAME_ID, speed_frame(2)) is None
    assert receiver.accept(0x1A0, gyro) is not None
    assert receiver.accept(0x1A1, gyro) is None  # x under the id of y
    assert receiver.accept(0x1A0, b"") is None
    assert receiver.accept(0x123, gyro) is None
    assert receiver.accept(0x1A0, speed_frame(15)) is None  # a wheel's frame: its checksum fails before its counter
    assert receiver.accept(SPEED_FRAME_ID, speed_frame(15)) is None
    assert receiver.counts() == {
        "ok": 2, "lost": 1, "repeated": 1, "invalid": 1, "crc": 2, "length": 1, "unknown": 1, "missing": 1,
    }  # fmt: skip


def test_a_group_is_told_from_what_stands_ahead_of_its_last_frame() -> None:
    """Two frames of the group, others between them; one of the group in between, or a part of a frame: no telling."""
    first, last, other, again = (FRAME.pack(can_id, 8, bytes(8)) for can_id in (0x110, 0x081, 0x702, 0x110))
    ids = (0x110, 0x081)
    assert part_group(first + other + other + last, 32, ids) == (first + last, other + other)
    assert part_group(first + again + last, 32, ids) is None
    assert part_group(first + other[:7] + last, 32, ids) is None
    for too_short in (b"", first, first[:9], first + last):
        assert part_group(too_short, 32, ids) is None
