"""What the flight software reckons it commanded is what the wheels will read, for any torque."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.icd.codec import DECODERS, encode_rw_cmds
from bus.wire.frames import FRAME
from fsw.drive import OFF, TORQUE, command_wheels
from fsw.records import HEALTHY, WheelCommands, WheelHealth

torque = st.floats(-1e6, 1e6) | st.floats(-0.2, 0.2)
flags = st.tuples(*[st.booleans()] * 4)


def read_back(commands: WheelCommands) -> tuple[list[float], list[int]]:
    """Torques and modes as the generated decoder reads them from the frames."""
    batch = encode_rw_cmds(3, commands.modes, commands.tau_rw_nm, 9)
    values = [DECODERS[can_id](data) for can_id, _, data in FRAME.iter_unpack(batch)]
    assert all(value is not None for value in values)
    return [float(value[2]) for value in values if value], [int(value[1]) for value in values if value]


@given(st.tuples(torque, torque, torque, torque), flags)
def test_what_comes_back_is_what_the_frames_carry(
    tau: tuple[float, float, float, float], available: tuple[bool, ...]
) -> None:
    """Torques returned equal decode(encode()) digit for digit; a wheel that is not available is OFF with zero torque."""
    commands = command_wheels(tau, WheelHealth(available=available))  # type: ignore[arg-type]
    torques, modes = read_back(commands)
    assert list(commands.tau_rw_nm) == torques
    assert modes == [TORQUE if ok else OFF for ok in available]
    for asked, sent, ok in zip(tau, torques, available, strict=True):
        if not ok:
            assert sent == 0.0
        elif abs(asked) < 200.0:
            assert sent == pytest.approx(asked, abs=0.5001e-7)


def test_a_torque_that_no_frame_can_carry_is_cut_and_counted() -> None:
    """1000 N m becomes the largest of a frame, either way, and each is counted; one that fits is not."""
    commands = command_wheels((1e3, -1e3, 0.1, 0.0), HEALTHY)
    assert commands.saturated == 2
    torques, _ = read_back(commands)
    assert torques[0] == pytest.approx((2**31 - 1) * 1e-7)
    assert torques[1] == pytest.approx(-(2**31) * 1e-7, abs=2e-7)
    assert list(commands.tau_rw_nm) == torques
    assert command_wheels((0.1, -0.1, 200.0, -200.0), HEALTHY).saturated == 0
    off = WheelHealth(available=(False, True, True, True))
    assert command_wheels((1e3, 0.0, 0.0, 0.0), off).saturated == 0
