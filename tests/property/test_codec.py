"""The generated codec against cantools bit for bit, and against whatever may arrive on a bus.

cantools reads the DBC at test time and does not know the generated code; the checksum comes from bit-by-bit division.
"""

from __future__ import annotations

import itertools
import math
import struct
from typing import Any

import cantools
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bus.icd import codec as icd_codec
from bus.icd.codec import DECODERS, ENCODERS
from bus.icd.e2e import LOST, Link
from bus.icd.messages import IDS, MESSAGES, Message, Signal, dbc_path

DATABASE: Any = cantools.database.load_file(dbc_path())
ALL_IDS = sorted(MESSAGES)
BY_NAME = pytest.mark.parametrize("name", sorted(IDS))
nibbles = st.integers(0, 15)
counts8 = st.integers(0, 255)


def divide_crc8(data: bytes) -> int:
    register = 0xFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = (register << 1) ^ (0x11D if register & 0x80 else 0)
    return register ^ 0xFF


def seal(frame_id: int, payload: bytes) -> bytes:
    """8 data bytes with the checksum of this id in front."""
    data_id = DATABASE.get_message_by_frame_id(frame_id).dbc.attributes["DataID"].value
    return bytes([divide_crc8(struct.pack("<H", data_id) + payload)]) + payload


def encode_by_cantools(frame_id: int, values: tuple[Any, ...]) -> bytes:
    """The can_frame that cantools makes of counter, nibble and signals."""
    message = DATABASE.get_message_by_frame_id(frame_id)
    names = [signal.name for signal in message.signals]
    data = message.encode(dict(zip(names, (0, *values), strict=True)), strict=True)
    return struct.pack("=IB3x8s", frame_id, 8, seal(frame_id, data[1:]))


def decode_by_cantools(frame_id: int, data: bytes) -> tuple[Any, ...]:
    """Counter, nibble and signals as cantools reads them, value names left as numbers."""
    message = DATABASE.get_message_by_frame_id(frame_id)
    decoded = message.decode(data, decode_choices=False)
    return tuple(decoded[signal.name] for signal in message.signals[1:])


def is_count(signal: Signal) -> bool:
    return signal.scale == 1 and not signal.unit


def in_range(signal: Signal) -> st.SearchStrategy[Any]:
    """Physical values of a signal: anything between its limits, steps, halves between steps, and their neighbours."""
    low, high = round(signal.minimum / signal.scale), round(signal.maximum / signal.scale)
    if is_count(signal):
        return st.integers(low, high)
    halves = st.integers(2 * low, 2 * high).map(lambda twice: twice / 2 * signal.scale)
    nudged = st.tuples(halves, st.sampled_from([-math.inf, math.inf])).map(lambda pair: math.nextafter(*pair))
    values = st.floats(signal.minimum, signal.maximum) | halves | nudged
    return values.filter(lambda value: signal.minimum <= value <= signal.maximum)


def values_of(message: Message) -> st.SearchStrategy[tuple[Any, ...]]:
    return st.tuples(*(in_range(signal) for signal in message.signals[1:]))


def bits(values: tuple[Any, ...]) -> list[tuple[type, Any]]:
    """Values with their types, floats as bit patterns: 0.0 and -0.0, 1 and 1.0 are not the same."""
    return [(type(value), struct.pack("<d", value) if isinstance(value, float) else value) for value in values]


@BY_NAME
@given(data=st.data())
def test_encode_equals_cantools(name: str, data: st.DataObject) -> None:
    """Every in-range value of every message makes the very frame that cantools makes, checksum by division."""
    frame_id = IDS[name]
    values = data.draw(values_of(MESSAGES[frame_id]))
    assert ENCODERS[frame_id](*values) == encode_by_cantools(frame_id, values)


@BY_NAME
@given(payload=st.binary(min_size=7, max_size=7))
@example(bytes(7))
@example(b"\xff" * 7)
@example(b"\x00\x00\x00\x80\x00\x00\x80")  # most negative 24-bit values
def test_decode_equals_cantools(name: str, payload: bytes) -> None:
    """Every bit pattern is read with the same values and types as cantools reads it, unused bits set or not."""
    frame_id = IDS[name]
    data = seal(frame_id, payload)
    values = DECODERS[frame_id](data)
    assert values is not None
    assert bits(values) == bits(decode_by_cantools(frame_id, data))


@BY_NAME
@given(data=st.data())
def test_decoded_values_encode_to_the_same_frame(name: str, data: st.DataObject) -> None:
    """What was decoded encodes to the same bytes again: recording and replay lose nothing."""
    frame_id = IDS[name]
    frame = ENCODERS[frame_id](*data.draw(values_of(MESSAGES[frame_id])))
    values = DECODERS[frame_id](frame[8:])
    assert values is not None
    assert ENCODERS[frame_id](*values) == frame


@BY_NAME
@given(data=st.data())
def test_out_of_range_values_saturate(name: str, data: st.DataObject) -> None:
    """A value outside its range, infinity included, is sent as the nearest limit; other signals stay as they are."""
    message = MESSAGES[IDS[name]]
    values = list(data.draw(values_of(message)))
    place = data.draw(st.integers(0, len(values) - 1))
    signal = message.signals[1:][place]
    above = data.draw(st.booleans() if place > 1 and signal.minimum < 0 else st.just(True))
    limit = signal.maximum if above else signal.minimum
    step = signal.scale * data.draw(st.integers(1, 2**40))
    beyond = limit + step if above else limit - step
    infinite = not is_count(signal) and data.draw(st.booleans())
    values[place] = math.copysign(math.inf, beyond) if infinite else beyond
    bounded = [*values[:place], limit, *values[place + 1 :]]
    assert ENCODERS[message.frame_id](*values) == encode_by_cantools(message.frame_id, tuple(bounded))


@BY_NAME
def test_negative_counts_saturate_at_zero(name: str) -> None:
    """A negative count goes as 0 and does not borrow from its neighbours."""
    message = MESSAGES[IDS[name]]
    zeros: list[int] = [0] * (len(message.signals) - 1)
    expected = ENCODERS[message.frame_id](*zeros)
    for place, signal in enumerate(message.signals[1:]):
        if place > 1 and is_count(signal) and signal.minimum == 0:
            values = [*zeros]
            values[place] = -7
            assert ENCODERS[message.frame_id](*values) == expected


def test_unity_quaternion_saturates_one_step_below_one() -> None:
    """+1.0 does not fit 2^-23 steps in 24 bits: it is sent as 8388607, an error of 1.2e-7."""
    frame = icd_codec.encode_STR_QA(0, 0, 1.0, -1.0)
    assert frame[10:13] == (8388607).to_bytes(3, "little")
    assert frame[13:16] == b"\x00\x00\x80"
    assert icd_codec.decode_STR_QA(frame[8:]) == (0, 0, 8388607 / 2**23, -1.0)


def test_rounding_is_half_even() -> None:
    """Half steps go to the even neighbour; 2^-16 and 2^-23 are exact in binary, so the halves are true halves."""
    for halves, even in [(1, 0), (3, 2), (5, 2), (7, 4)]:
        frame = icd_codec.encode_STR_QA(0, 0, halves / 2**24, -halves / 2**24)
        assert frame[10:13] == even.to_bytes(3, "little")
        assert frame[13:16] == (-even).to_bytes(3, "little", signed=True)
        assert icd_codec.encode_TIME(0, 0, 0, halves / 2**17)[14:] == even.to_bytes(2, "little")


@BY_NAME
def test_nan_is_refused_by_name(name: str) -> None:
    """NaN has no nearest value: the error names frame and signal."""
    message = MESSAGES[IDS[name]]
    for place, signal in enumerate(message.signals[1:]):
        if not is_count(signal):
            values: list[float] = [0] * (len(message.signals) - 1)
            values[place] = math.nan
            with pytest.raises(ValueError, match=rf"0x{message.frame_id:03X}: {signal.name} is not a number"):
                ENCODERS[message.frame_id](*values)


def test_fraction_of_a_count_is_refused() -> None:
    """A tick of 1.5 is a mistake of the caller, not something to round."""
    with pytest.raises(TypeError):
        icd_codec.encode_SYNC(0, 0, 1.5)  # type: ignore[arg-type]


# -- groups --------------------------------------------------------------------------------------------------------

anything = st.floats(allow_nan=False)  # out of range and infinite too


def four(values: st.SearchStrategy[Any]) -> st.SearchStrategy[tuple[Any, ...]]:
    return st.tuples(values, values, values, values)


@given(
    counter=nibbles, mode=four(nibbles), torque=four(st.floats(-12, 12) | anything), sync=counts8 | st.integers(-9, 999)
)
def test_group_of_wheel_commands_equals_single_frames(counter: int, mode: Any, torque: Any, sync: int) -> None:
    """The four commands in one go are the same bytes as one by one, saturation included."""
    singles = [ENCODERS[0x110 + k](counter, mode[k], torque[k], sync) for k in range(4)]
    assert icd_codec.encode_rw_cmds(counter, mode, torque, sync) == b"".join(singles)


@given(
    counter=nibbles, status=four(nibbles | st.just(99)), sync=counts8,
    speed=four(st.floats(-9000, 9000) | anything), current=four(st.floats(-40e3, 40e3) | anything),
)  # fmt: skip
def test_group_of_wheel_telemetry_equals_single_frames(
    counter: int, status: Any, speed: Any, current: Any, sync: int
) -> None:
    """The four telemetry frames in one go are the same bytes as one by one, saturation included."""
    singles = [ENCODERS[0x190 + k](counter, status[k], speed[k], current[k], sync) for k in range(4)]
    assert icd_codec.encode_rw_tlms(counter, status, speed, current, sync) == b"".join(singles)


@given(counter=nibbles | st.just(16), status=four(nibbles), rate=four(st.floats(-3, 3) | anything), sync=counts8)
def test_group_of_gyro_rates_equals_single_frames(counter: int, status: Any, rate: Any, sync: int) -> None:
    """The three rates in one go are the same bytes as one by one, saturation included."""
    singles = [ENCODERS[0x1A0 + k](counter, status[k], rate[k], sync) for k in range(3)]
    assert icd_codec.encode_fogs(counter, status[:3], rate[:3], sync) == b"".join(singles)


# -- what may arrive -----------------------------------------------------------------------------------------------


@given(data=st.binary(max_size=8))
@example(b"")
@example(bytes(8))
@example(b"\xff" * 8)
def test_no_bytes_make_a_decoder_raise(data: bytes) -> None:
    """0..8 bytes of anything, to every decoder: None, or what cantools reads where length and checksum fit."""
    for frame_id, decode in DECODERS.items():
        values = decode(data)
        if len(data) == 8 and data == seal(frame_id, data[1:]):
            assert values == decode_by_cantools(frame_id, data)
        else:
            assert values is None


@given(data=st.data())
def test_frame_under_another_id_is_detected(data: st.DataObject) -> None:
    """A good frame of any message is refused by the decoder of every other message: none passes by accident."""
    frame_id = data.draw(st.sampled_from(ALL_IDS))
    frame = ENCODERS[frame_id](*data.draw(values_of(MESSAGES[frame_id])))
    accepting = [other for other in ALL_IDS if DECODERS[other](frame[8:]) is not None]
    assert accepting == [frame_id]


@BY_NAME
@settings(max_examples=10)  # the CRC is linear: which errors it sees does not depend on what was sent
@given(data=st.data())
def test_all_single_and_double_bit_flips_are_detected(name: str, data: st.DataObject) -> None:
    """All 64 + 2016 errors of one or two bits, anywhere in the 8 bytes, checksum included, are refused."""
    frame_id = IDS[name]
    decode = DECODERS[frame_id]
    sent = int.from_bytes(ENCODERS[frame_id](*data.draw(values_of(MESSAGES[frame_id])))[8:], "little")
    singles = [1 << bit for bit in range(64)]
    for error in singles + [first | second for first, second in itertools.combinations(singles, 2)]:
        assert decode((sent ^ error).to_bytes(8, "little")) is None


@given(frames=st.lists(st.tuples(st.sampled_from(ALL_IDS), st.binary(max_size=8), st.booleans()), max_size=40))
def test_links_count_every_frame_once(frames: list[tuple[int, bytes, bool]]) -> None:
    """Random frames, some with a right checksum: none raises, each is taken or in one count, only good ones give values."""
    links = {frame_id: Link(decode) for frame_id, decode in DECODERS.items()}
    accepted = 0
    for tick, (frame_id, data, sealed) in enumerate(frames):
        if sealed and len(data) == 8:
            data = seal(frame_id, data[1:])
        accepted += links[frame_id].accept(data, tick) is not None
    assert sum(link.accepted for link in links.values()) == accepted
    refused = sum(sum(link.faults.values()) - link.faults[LOST] for link in links.values())
    assert accepted + refused == len(frames)
