"""The codec in native integers gives what the other one gives: every byte, value, None and exception.

Not compiled, it is slow and computes the same; compiled, these tests check what the compiler made of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.icd import codec, native_codec
from bus.icd.e2e import checksum
from bus.icd.messages import MESSAGES, Signal

TICK_FRAMES = {
    "sensors": [*((0x190 + k, 0) for k in range(4)), *((0x1A0 + k, 0) for k in range(3)), (0x080, 0)],
    "commands": [*((0x110 + k, 1) for k in range(4)), (0x081, None)],
}
BATCHES = pytest.mark.parametrize("batch", sorted(TICK_FRAMES))
STARS = pytest.mark.parametrize("star", [0x1B0, 0x1B1])
HALF_EVEN = 6755399441055744.0

odd_counts = st.sampled_from([-(2**70), -(2**62), -17, -16, -1, 16, 255, 256, 2**16, 2**32, 2**62, 2**63, 2**70])
odd_floats = st.sampled_from([math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, -5e-324, 0.0, -0.0])
whole_nibbles = st.integers(0, 15)
nibbles = st.one_of(*[whole_nibbles] * 9, odd_counts, st.booleans())


def is_count(signal: Signal) -> bool:
    return signal.scale == 1 and not signal.unit


def describe(function: Callable[..., Any], *values: Any) -> Any:
    """Result or exception of a call, such that 0.0 and -0.0, 1 and 1.0 are not the same."""
    try:
        return repr(function(*values))
    except Exception as error:
        return type(error), str(error)


def both_agree(function: str, *values: Any) -> bool:
    return bool(describe(getattr(native_codec, function), *values) == describe(getattr(codec, function), *values))


def values_of(signal: Signal) -> st.SearchStrategy[Any]:
    """Mostly values inside the range, all over it and at its ends; also half steps, their neighbours, and odd ones."""
    low, high = round(signal.minimum / signal.scale), round(signal.maximum / signal.scale)
    if is_count(signal):
        whole = st.integers(low, high)
        return st.one_of(*[whole] * 9, st.integers(low - 2, low + 2), st.integers(high - 2, high + 2), odd_counts)
    ends = st.integers(2 * low - 3, 2 * low + 3) | st.integers(2 * high - 3, 2 * high + 3)
    halves = (st.integers(2 * low, 2 * high) | st.integers(-9, 9) | ends).map(lambda twice: twice / 2 * signal.scale)
    nudged = st.tuples(halves, st.sampled_from([-math.inf, math.inf])).map(lambda pair: math.nextafter(*pair))
    inside = st.floats(signal.minimum, signal.maximum)
    return st.one_of(
        *[inside] * 6, halves, halves, nudged, nudged, st.one_of(st.floats(), odd_floats, odd_counts.map(float))
    )


def arguments_of(first: int, size: int) -> st.SearchStrategy[tuple[Any, ...]]:
    """Arguments of the encoder of `size` like frames; of one alone, if it is 1."""
    signals = MESSAGES[first].signals[3:]
    if size == 1:
        return st.tuples(nibbles, nibbles, *map(values_of, signals))
    many = [values_of(s) if is_count(s) else st.tuples(*[values_of(s)] * size) for s in signals]
    return st.tuples(nibbles, st.tuples(*[nibbles] * size), *many)


def seal(frame_id: int, payload: bytes) -> bytes:
    """The can_frame of these 7 bytes, checksum and all."""
    return (
        frame_id.to_bytes(4, "little")
        + b"\x08\0\0\0"
        + bytes((checksum(MESSAGES[frame_id].data_id, payload),))
        + payload
    )


@st.composite
def sealed_batches(draw: Any, batch: str) -> tuple[bytes, int]:
    """Any batch that is taken, its padding filled too, and its counter."""
    counter = draw(st.integers(0, 14))
    frames = []
    for frame_id, nibble in TICK_FRAMES[batch]:
        high = draw(whole_nibbles) if nibble is None else nibble
        frames.append(seal(frame_id, bytes((high << 4 | counter,)) + draw(st.binary(min_size=6, max_size=6))))
    return b"".join(frames), counter


@pytest.mark.parametrize(
    ("function", "first", "size"),
    [
        ("encode_SYNC", 0x080, 1),
        ("encode_CYCLE_DONE", 0x081, 1),
        ("encode_STR_QA", 0x1B0, 1),
        ("encode_STR_QB", 0x1B1, 1),
        ("encode_rw_cmds", 0x110, 4),
        ("encode_rw_tlms", 0x190, 4),
        ("encode_fogs", 0x1A0, 3),
    ],
)
@given(data=st.data())
def test_encoders_agree(function: str, first: int, size: int, data: st.DataObject) -> None:
    """The same frames or the same exception, inside the ranges, at their ends, and outside."""
    assert both_agree(function, *data.draw(arguments_of(first, size)))


def test_a_single_wrong_argument_is_seen() -> None:
    """Each argument by itself can send a call the other way."""
    four, three = (0.5, -0.5, 1.5, 2.5), (1e-9, 0.5, -0.5)
    for odd in (math.nan, math.inf, -math.inf, 1e9, -1e9, -0.0, 5e-324):
        for at in range(4):
            floats = (*four[:at], odd, *four[at + 1 :])
            assert both_agree("encode_rw_cmds", 3, (1, 1, 1, 1), floats, 9)
            assert both_agree("encode_rw_tlms", 3, (0, 0, 0, 0), floats, four, 9)
            assert both_agree("encode_rw_tlms", 3, (0, 0, 0, 0), four, floats, 9)
        for at in range(3):
            assert both_agree("encode_fogs", 3, (0, 0, 0), (*three[:at], odd, *three[at + 1 :]), 9)
        for name in ("encode_STR_QA", "encode_STR_QB"):
            assert both_agree(name, 3, 1, odd, 0.5)
            assert both_agree(name, 3, 1, 0.5, odd)
    for count in (-(2**70), -17, -1, 0, 15, 16, 255, 256, 65535, 65536, 2**32 - 1, 2**32, 2**63, 2**70):
        for at in range(4):
            odd4 = (*(0,) * at, count, *(0,) * (3 - at))
            assert both_agree("encode_rw_cmds", 3, odd4, four, 9)
            assert both_agree("encode_rw_tlms", 3, odd4, four, four, 9)
            assert both_agree("encode_CYCLE_DONE", *odd4)
            assert both_agree("encode_SYNC", *odd4[:3])
            assert both_agree("encode_fogs", 3, odd4[:3], three, 9)
        for name in ("encode_STR_QA", "encode_STR_QB"):
            assert both_agree(name, count, 1, 0.5, 0.25)
            assert both_agree(name, 1, count, 0.5, 0.25)
        for counter, sync_cnt in ((count, 9), (3, count)):
            assert both_agree("encode_rw_cmds", counter, (1, 1, 1, 1), four, sync_cnt)
            assert both_agree("encode_rw_tlms", counter, (0, 0, 0, 0), four, four, sync_cnt)
            assert both_agree("encode_fogs", counter, (0, 0, 0), three, sync_cnt)


@given(st.lists(st.floats(-(2.0**51), 2.0**51) | st.integers(-(2**51), 2**51).map(lambda n: n / 2), min_size=20))
def test_rounding_without_a_call(values: list[float]) -> None:
    """Adding and taking away 1.5 * 2^52 is round(), up to 2^51."""
    assert [(value + HALF_EVEN) - HALF_EVEN for value in values] == [round(value) for value in values]


@BATCHES
@given(data=st.data())
def test_taken_batches_agree(batch: str, data: st.DataObject) -> None:
    """A batch in which all is right is taken, with the same values; with any other counter it is not."""
    frames, counter = data.draw(sealed_batches(batch))
    assert getattr(native_codec, f"decode_{batch}")(frames, counter)[-1] != -1
    for other in range(-18, 18):
        assert both_agree(f"decode_{batch}", frames, other)


@BATCHES
def test_each_counter_and_turned_bit(batch: str) -> None:
    """With every counter, and with every single bit turned over."""
    for counter in range(15):
        frames = b"".join(
            seal(frame_id, bytes((((nibble or 0) << 4) | counter, 250, 3, 251, 252, 255, 254)))
            for frame_id, nibble in TICK_FRAMES[batch]
        )
        assert both_agree(f"decode_{batch}", frames, counter)
        bits = int.from_bytes(frames, "little")
        for bit in range(counter % 3, 8 * len(frames), 3):  # all of them within three counters
            turned = (bits ^ 1 << bit).to_bytes(len(frames), "little")
            assert both_agree(f"decode_{batch}", turned, counter)


@BATCHES
@given(st.data())
def test_other_bytes_agree(batch: str, data: st.DataObject) -> None:
    """Of any length, and right in part."""
    frames, counter = data.draw(sealed_batches(batch))
    junk = data.draw(st.binary(max_size=2 * len(frames)))
    start = data.draw(st.integers(0, len(frames)))
    pieces = (junk, frames[:start], frames[start:], frames + junk, (frames[:start] + junk + frames)[: len(frames)])
    for piece in (*pieces, junk.ljust(len(frames), b"\0")[: len(frames)], b""):
        assert both_agree(f"decode_{batch}", piece, counter)
    at = data.draw(st.integers(0, len(frames) - 1))
    assert both_agree(
        f"decode_{batch}", frames[:at] + data.draw(st.binary(min_size=1, max_size=1)) + frames[at + 1 :], counter
    )


@STARS
@given(payload=st.binary(min_size=7, max_size=7), junk=st.binary(max_size=20))
def test_star_frames_agree(star: int, payload: bytes, junk: bytes) -> None:
    """Any data with the right checksum, with one bit turned over, and anything else."""
    name = f"decode_{MESSAGES[star].name}"
    data = seal(star, payload)[8:]
    assert getattr(native_codec, name)(data) is not None
    assert both_agree(name, data)
    bits = int.from_bytes(data, "little")
    for bit in range(64):
        assert both_agree(name, (bits ^ 1 << bit).to_bytes(8, "little"))
    for other in (junk, data[:7], data + b"\0", junk.ljust(8, b"\0")[:8]):
        assert both_agree(name, other)
