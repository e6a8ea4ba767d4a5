"""What the frames can carry, against the codec itself and against the wheels that fly."""

from __future__ import annotations

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from bus.icd.codec import decode_RW1_CMD, encode_RW1_CMD
from bus.icd.ranges import find_signal, quantise_torque

HIGH_NM = 214.7483647


@given(st.floats(allow_nan=False) | st.floats(-0.2, 0.2) | st.integers(-(2**33), 2**33).map(lambda n: n * 5e-8))
@example(HIGH_NM + 0.4e-7)
@example(HIGH_NM + 0.6e-7)
@example(-HIGH_NM - 1.4e-7)
@example(-HIGH_NM - 1.6e-7)
@example(-0.0)
@example(math.inf)
@example(-math.inf)
def test_what_is_said_to_be_sent_is_what_arrives(torque_nm: float) -> None:
    """To the last bit, within the range, at its ends, between steps and beyond; cut only where the range ends."""
    arrived = decode_RW1_CMD(encode_RW1_CMD(0, 1, torque_nm, 0)[8:])
    assert arrived is not None
    sent_nm, is_cut = quantise_torque(torque_nm)
    assert (sent_nm, math.copysign(1.0, sent_nm)) == (arrived[2], math.copysign(1.0, arrived[2]))
    assert is_cut == (not abs(sent_nm - torque_nm) <= 0.51e-7)


def test_nan_is_refused_as_the_encoder_does() -> None:
    """NaN has no nearest step."""
    with pytest.raises(ValueError, match="NaN"):
        quantise_torque(math.nan)


def test_the_ranges_are_those_of_the_contract() -> None:
    """32 bits at 1e-7 N m and 1e-9 rad/s, 24 bits at 1e-3 rad/s, 16 bits at 1 mA; a 10 N m wheel fits."""
    torque, speed, current, rate = (
        (signal.minimum, signal.maximum)
        for signal in (
            find_signal("RW1_CMD", "TORQUE"), find_signal("RW1_TLM", "SPEED"), find_signal("RW1_TLM", "CURRENT"),
            find_signal("FOGX_RATE", "RATE"),
        )
    )  # fmt: skip
    assert torque == (-214.7483648, HIGH_NM)
    assert torque[1] > 10.0
    assert speed == (-8388.608, 8388.607)
    assert tuple(1e-3 * milliampere for milliampere in current) == pytest.approx((-32.768, 32.767))
    assert rate == (-2.147483648, 2.147483647)
