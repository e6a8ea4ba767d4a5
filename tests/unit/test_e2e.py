"""End-to-end protection: the checksum against its published check value, and what a receiver makes of a sequence."""

from __future__ import annotations

from random import Random

import pytest
from fastcrc.crc8 import sae_j1850

from bus.icd import codec as icd_codec
from bus.icd import e2e
from bus.icd.e2e import Link, part_group
from bus.icd.messages import MESSAGES
from bus.wire.frames import FRAME


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


def feed(counters: list[int], ticks: list[int] | None = None) -> tuple[Link, list[str]]:
    """What a link makes of frames with these counters, one a tick or at the ticks given."""
    link = Link(icd_codec.decode_RW1_TLM)
    outcomes = []
    for tick, counter in zip(ticks or range(len(counters)), counters, strict=True):
        values = link.accept(speed_frame(counter), tick)
        assert (values is not None) == (link.outcome in (e2e.OK, e2e.LOST))
        outcomes.append(link.outcome)
    return link, outcomes


def torque_frame(counter: int, torque_nm: float, tick: int) -> bytes:
    return icd_codec.encode_RW1_CMD(counter % 15, 1, torque_nm, tick & 0xFF)[8:]


def mix(
    offset: int, ticks: int, every: int = 1, period: int = 1, burst: int = 1, start: int = 5, known: int = 1
) -> tuple[Link, int, int]:
    """The link after a rightful sender (0.01 N m) and an intruder (0.5 N m), and how many frames of each were taken.

    offset : of the intruder's counter from the rightful one's when it starts
    every : ticks between the intruder's frames, period : between the rightful one's, of which the receiver knows `known`
    burst : frames at once
    """
    link = Link(icd_codec.decode_RW1_CMD, known)
    taken = {0.01: 0, 0.5: 0}
    theirs = start // period + offset
    for tick in range(ticks):
        frames = [torque_frame(tick // period, 0.01, tick)] if tick % period == 0 else []
        if tick >= start and tick % every == 0:
            frames += [torque_frame(theirs + k, 0.5, tick) for k in range(burst)]
            theirs += burst
        for frame in frames:
            values = link.accept(frame, tick)
            if values is not None:
                taken[0.01 if values[2] < 0.1 else 0.5] += 1
    return link, taken[0.01], taken[0.5]


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


def test_two_lost_frames_are_accepted_and_counted() -> None:
    """13 -> 1 leaves out 14 and 0, the largest jump that is taken; 1 -> 3 leaves out one."""
    link, outcomes = feed([13, 1, 2, 4], [0, 3, 4, 6])
    assert outcomes == [e2e.OK, e2e.LOST, e2e.OK, e2e.LOST]
    assert (link.accepted, link.faults[e2e.LOST], link.missing, link.rivals) == (4, 2, 3, 0)


def test_a_larger_jump_is_thrown_away_until_the_new_sequence_goes_on() -> None:
    """After three lost frames the first is thrown away; the second in a row is taken, and the sequence is whole again."""
    link, outcomes = feed([0, 4, 5, 6], [0, 4, 5, 6])
    assert outcomes == [e2e.OK, e2e.JUMP, e2e.LOST, e2e.OK]
    assert (link.accepted, link.faults[e2e.JUMP], link.missing, link.rivals) == (3, 1, 4, 0)


def test_no_new_sequence_is_taken_sooner_than_its_jump_takes_time() -> None:
    """Two frames in a row that are eight ahead after one tick are not what is left of an outage of eight ticks."""
    _, outcomes = feed([0, 8, 9, 1], [0, 1, 1, 1])
    assert outcomes == [e2e.OK, e2e.JUMP, e2e.JUMP, e2e.OK]


@pytest.mark.parametrize("outage", range(3, 40))
def test_every_outage_ends_with_the_second_frame_at_the_latest(outage: int) -> None:
    """However many frames are lost, at most one that arrives is thrown away, and nobody is called a second sender."""
    link = Link(icd_codec.decode_RW1_CMD)
    heard = [tick for tick in range(200) if not 50 <= tick < 50 + outage]
    taken = [tick for tick in heard if link.accept(torque_frame(tick, 0.01, tick), tick) is not None]
    assert set(heard) - set(taken) <= {50 + outage}
    assert link.rivals == 0


@pytest.mark.parametrize("offset", [0, *range(4, 15)])
def test_not_one_frame_of_an_intruder_gets_in(offset: int) -> None:
    """Checksum right, counter ahead by more than is taken: all of it thrown away, all of the rightful taken, noticed."""
    link, rightful, intruding = mix(offset, 600)
    assert (rightful, intruding) == (600, 0)
    assert link.rivals > 580


@pytest.mark.parametrize("offset", [2, 3])
def test_an_intruder_within_the_tolerated_jump_gets_in_once(offset: int) -> None:
    """Its first frame looks like one after a loss; then the rightful sequence proves alive and has its place again."""
    link, rightful, intruding = mix(offset, 600)
    assert (rightful, intruding) == (600, 1)
    assert link.rivals > 580


def test_an_intruder_that_is_one_ahead_is_noticed() -> None:
    """Whose counter is always the next cannot be told from the rightful one; that there are two is counted all the same."""
    link, _, _ = mix(1, 600)
    assert link.rivals > 580


@pytest.mark.parametrize("every", [2, 3, 7, 10, 100])
@pytest.mark.parametrize("offset", range(15))
def test_slower_intruders_are_noticed_too(offset: int, every: int) -> None:
    """At another rate its counter passes by the expected one now and then: once a turn at most, and it is noticed."""
    link, _, intruding = mix(offset, 1500, every)
    sent = len(range(0, 1500, every))
    assert link.rivals >= 0.7 * sent
    assert intruding <= max(3, 0.3 * sent)


@pytest.mark.parametrize("offset", range(4, 15))
def test_a_second_sender_of_a_slow_message_is_noticed(offset: int) -> None:
    """Every tenth tick, as the star tracker at 10 Hz: two senders within 20 s."""
    link, _, intruding = mix(offset, 2000, every=10, period=10, start=50)
    assert intruding == 0
    assert link.rivals > 0


@pytest.mark.parametrize("offset", range(15))
@pytest.mark.parametrize("shift", [0, 50])
def test_a_second_sender_of_the_heartbeat_is_noticed_in_ten_seconds(offset: int, shift: int) -> None:
    """Once a second, at 100 Hz: the receiver knows how often, so the counter cannot go round faster unnoticed."""
    link, _, intruding = mix(offset, 1000 + shift, every=100, period=100, start=shift, known=100)
    assert link.rivals > 0
    assert offset in (0, 1, 2, 3, 4, 14) or intruding == 0


def test_a_slow_sender_that_loses_frames_is_no_second_sender() -> None:
    """Heartbeats, each lost with a chance of one half, for an hour; and with one more than is due after each change."""
    link, draw, counter = Link(icd_codec.decode_RW1_CMD, 100), Random(1).random, 0
    for tick in range(0, 360_000, 100):
        for _ in range(2 if tick % 40_000 == 0 else 1):
            if draw() < 0.5:
                link.accept(torque_frame(counter, 0.01, tick), tick)
            counter += 1
    assert link.accepted > 1000
    assert link.rivals == 0


@pytest.mark.parametrize("burst", [2, 3, 8])
def test_bursts_do_not_get_in(burst: int) -> None:
    """Several frames in a row within a tick are a new sequence by their counters, but the old one is not silent."""
    for offset in range(4, 15 - burst):
        _, rightful, intruding = mix(offset, 6, burst=burst)
        assert (rightful, intruding) == (6, 0)


@pytest.mark.parametrize("loss", [0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97])
@pytest.mark.parametrize("length", [1, 5, 50])
def test_losses_alone_never_look_like_a_second_sender(loss: float, length: int) -> None:
    """One sender, frames lost singly or in stretches, up to 97 %: no rival, and what comes in stretches is used."""
    draw = Random(f"{loss} {length}").random
    link = Link(icd_codec.decode_RW1_CMD)
    lost = False
    for tick in range(10_000):
        lost = draw() < loss if draw() < 1 / length else lost
        if not lost:
            link.accept(torque_frame(tick, 0.01, tick), tick)
    arrived = link.accepted + sum(link.faults.values()) - link.faults[e2e.LOST]
    assert link.rivals == 0
    assert link.accepted >= (0.95 if length == 50 or loss <= 0.1 else 0.3) * arrived


def test_frames_that_come_late_and_together_are_no_second_sender() -> None:
    """A receiver that stood still for 50 ticks finds 50 frames at once, two of them lost: all taken, nobody suspected."""
    link = Link(icd_codec.decode_RW1_CMD)
    for sent in range(200):
        tick = 150 if 100 <= sent < 150 else sent
        if sent not in (120, 121):
            assert link.accept(torque_frame(sent, 0.01, sent), tick) is not None
    assert link.rivals == 0


def test_frames_that_the_bus_doubles_are_no_second_sender() -> None:
    """The very same frame twice is a repeat and nothing else."""
    link = Link(icd_codec.decode_RW1_CMD)
    for tick in range(100):
        frame = torque_frame(tick, 0.01, tick)
        assert link.accept(frame, tick) is not None
        assert link.accept(frame, tick) is None
    assert (link.faults[e2e.REPEATED], link.rivals) == (100, 0)


def test_a_counter_that_stands_is_no_second_sender() -> None:
    """A stuck node sends new values under one counter for 1000 ticks: each is a repeat, none is taken, nobody suspected."""
    link = Link(icd_codec.decode_RW1_CMD)
    assert link.accept(torque_frame(7, 0.01, 7), 7) is not None
    for tick in range(8, 1008):
        assert link.accept(torque_frame(7, 0.01 + tick * 1e-6, tick), tick) is None
    assert (link.faults[e2e.REPEATED], link.rivals) == (1000, 0)


@pytest.mark.parametrize("offset", range(4, 12))
def test_an_intruder_does_not_take_the_place_of_a_silent_sender_at_once(offset: int) -> None:
    """With a second sender known, two frames in a row are not enough: only its counter's coming by the expected one."""
    link, _, _ = mix(offset, 100)
    outcomes = []
    for tick in range(100, 116):
        link.accept(torque_frame(tick + offset, 0.5, tick), tick)
        outcomes.append(link.outcome)
    assert outcomes == [e2e.JUMP] * (15 - offset) + [e2e.OK] * (1 + offset)


def test_counter_fifteen_is_never_valid() -> None:
    """15 is thrown away, as the first frame too, and does not move the sequence."""
    link, outcomes = feed([15, 5, 15, 6])
    assert outcomes == [e2e.INVALID, e2e.OK, e2e.INVALID, e2e.OK]
    assert link.missing == 0


def test_bad_checksum_and_length_leave_the_sequence_alone() -> None:
    """A broken frame tells nothing, not even its counter: the next good one shows the gap."""
    link = Link(icd_codec.decode_RW1_TLM)
    assert link.accept(speed_frame(0), 0) is not None
    broken = bytearray(speed_frame(1))
    broken[3] ^= 0x10
    assert link.accept(bytes(broken), 1) is None
    assert link.outcome == e2e.CRC
    assert link.accept(speed_frame(2)[:7], 2) is None
    assert link.outcome == e2e.LENGTH
    assert link.accept(speed_frame(3), 3) is not None
    assert (link.outcome, link.missing) == (e2e.LOST, 2)


def test_a_group_is_told_from_what_stands_ahead_of_its_last_frame() -> None:
    """Two frames of the group, others between them; one of the group in between, or a part of a frame: no telling."""
    first, last, other, again = (FRAME.pack(can_id, 8, bytes(8)) for can_id in (0x110, 0x081, 0x702, 0x110))
    ids = (0x110, 0x081)
    assert part_group(first + other + other + last, 32, ids) == (first + last, other + other)
    assert part_group(first + again + last, 32, ids) is None
    assert part_group(first + other[:7] + last, 32, ids) is None
    for too_short in (b"", first, first[:9], first + last):
        assert part_group(too_short, 32, ids) is None
