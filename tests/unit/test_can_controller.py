"""The error states of a CAN controller against the rules of ISO 11898-1, and what Linux says of them."""

from __future__ import annotations

import pytest

from bus.wire.frames import FRAME
from plant_server.can_bus.controller import Controller, State
from plant_server.can_bus.error_frames import Reporter


def fail(controller: Controller, times: int) -> None:
    for _ in range(times):
        controller.note_send_error()


def test_a_transmitter_is_passive_after_16_failures_and_off_after_32() -> None:
    """8 counts each: 120 is active, 128 passive, 248 passive, 256 off; the warning stands from 96 on."""
    node = Controller()
    fail(node, 11)
    assert (node.tec, node.warns) == (88, False)
    fail(node, 1)
    assert (node.tec, node.warns, node.state) == (96, True, State.ACTIVE)
    fail(node, 3)
    assert (node.tec, node.state) == (120, State.ACTIVE)
    fail(node, 1)
    assert (node.tec, node.state) == (128, State.PASSIVE)
    fail(node, 15)
    assert (node.tec, node.state) == (248, State.PASSIVE)
    fail(node, 1)
    assert (node.tec, node.state, node.is_off) == (256, State.OFF, True)


def test_good_frames_count_down_by_one_and_not_below_zero() -> None:
    """Of both counters; a passive node is active again at 127."""
    node = Controller()
    fail(node, 16)
    node.note_sent()
    assert (node.tec, node.state) == (127, State.ACTIVE)
    node.note_hear_error()
    for _ in range(3):
        node.note_heard()
    assert node.rec == 0


def test_a_receiver_counts_one_an_error_and_never_goes_off() -> None:
    """Passive at 128; however many errors follow."""
    node = Controller()
    for _ in range(127):
        node.note_hear_error()
    assert (node.rec, node.state) == (127, State.ACTIVE)
    node.note_hear_error()
    assert node.state is State.PASSIVE
    for _ in range(1000):
        node.note_hear_error()
    assert (node.state, node.rec) == (State.PASSIVE, 255)


def test_one_good_frame_takes_a_receiver_out_of_the_passive_state() -> None:
    """The standard sets its counter to a value between 119 and 127."""
    node = Controller()
    node.note_dominant(32)
    assert node.state is State.PASSIVE
    node.note_heard()
    assert 119 <= node.rec <= 127
    assert node.state is State.ACTIVE


def test_a_node_that_nobody_acknowledges_never_goes_off() -> None:
    """Its counter climbs to 128 and stays there: a lone node on a bus waits for others."""
    node = Controller()
    for _ in range(1000):
        node.note_send_error(only_unacknowledged=True)
    assert (node.tec, node.state) == (128, State.PASSIVE)


def test_a_node_comes_back_after_128_sequences_of_11_recessive_bits() -> None:
    """Not one earlier, with both counters at 0; what happens meanwhile does not touch it."""
    node = Controller()
    fail(node, 32)
    node.note_sent()
    node.note_heard()
    node.note_hear_error()
    node.note_dominant(5)
    assert not node.note_recessive(127)
    assert node.is_off
    assert node.note_recessive(1)
    assert (node.state, node.tec, node.rec) == (State.ACTIVE, 0, 0)
    assert not node.note_recessive(1000)
    fail(node, 32)
    assert not node.note_recessive(127)  # it counts from the start again


def read(frames: bytes) -> list[tuple[int, int, int, int]]:
    """Class, what the controller says, TEC and REC of each error frame."""
    return [(can_id & 0x1FFFFFFF, data[1], data[6], data[7]) for can_id, _, data in FRAME.iter_unpack(frames)]


def test_error_frames_are_those_of_linux() -> None:
    """Classes and bits of linux/can/error.h: warning 0x08, passive 0x20, bus-off 0x40, restarted 0x100 with active 0x40."""
    node = Controller()
    reporter = Reporter(node)
    seen = []
    for _ in range(32):
        fail(node, 1)
        reporter.look()
    seen += read(reporter.take())
    node.note_recessive(128)
    reporter.look()
    seen += read(reporter.take())
    assert seen == [(0x204, 0x08, 96, 0), (0x204, 0x20, 128, 0), (0x240, 0, 255, 0), (0x304, 0x40, 0, 0)]
    assert reporter.take() == b""


@pytest.mark.parametrize(("errors", "bit"), [(96, 0x04), (128, 0x10)])
def test_error_frames_tell_the_receive_counter_from_the_transmit_counter(errors: int, bit: int) -> None:
    """Warning 0x04 and passive 0x10 of the receiver, and active again 0x40 from its good frames."""
    node = Controller()
    reporter = Reporter(node)
    for _ in range(errors):
        node.note_hear_error()
    reporter.look()
    assert read(reporter.take()) == [(0x204, bit, 0, errors)]
    for _ in range(200):
        node.note_heard()
    reporter.look()
    assert [row[:2] for row in read(reporter.take())] == [(0x204, 0x40)]


def test_python_can_knows_them_for_error_frames() -> None:
    """python-can takes the frame apart as one, dlc 8."""
    from bus.wire.python_can import unpack_message

    node = Controller()
    reporter = Reporter(node)
    fail(node, 32)
    reporter.look()
    (message,) = [unpack_message(*fields, 0.0) for fields in FRAME.iter_unpack(reporter.take())]
    assert message.is_error_frame
    assert message.dlc == 8
