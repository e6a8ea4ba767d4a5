"""The plant behind its frames: which commands a wheel takes, for how long, and what a silent unit leaves out."""

from __future__ import annotations

from struct import Struct

import pytest

from bus.icd.codec import (
    DECODERS,
    encode_CYCLE_DONE,
    encode_HEARTBEAT_FSW,
    encode_RW1_CMD,
    encode_rw_cmds,
    encode_SYNC,
)
from bus.settings import build
from plant_server.channel import Channel
from plant_server.config import PlantConfig
from plant_server.faults import Fault, make_fault
from plant_server.plant import Plant

FRAME = Struct("=IB3x8s")
TICK_S = 0.1
TORQUES = (0.01, -0.02, 0.03, -0.04)
WHEELS = [{"mount": mount} for mount in ("x", "y", "z", "skew")]


def make(faults: tuple[Fault, ...] = (), **settings: int) -> Channel:
    data = {"body": {"inertia_kgm2": [[45, 3, 2], [3, 38, -1.5], [2, -1.5, 50]]}, "wheels": WHEELS, **settings}
    return Channel(Plant(build(PlantConfig, data, "test"), faults, TICK_S, 1), TICK_S, 42)


def commands(channel: Channel, sync_cnt: int | None = None, mode: int = 1) -> bytes:
    tick = channel.tick
    counter = tick % 15
    batch = encode_rw_cmds(counter, (mode,) * 4, TORQUES, (tick if sync_cnt is None else sync_cnt) & 0xFF)
    return batch + encode_CYCLE_DONE(counter, 2, tick, 0)


def applied(channel: Channel) -> tuple[float, ...]:
    """Torque of each wheel on the body in the tick that ended now."""
    return channel.plant.truth().tau_rw_true_nm


def fly(channel: Channel, batch: bytes | None) -> bytes:
    sent = channel.announce()
    if batch is not None:
        channel.accept(batch)
    channel.advance()
    return sent


def ids(batch: bytes) -> list[int]:
    return [can_id for can_id, _, _ in FRAME.iter_unpack(batch)]


def test_a_tick_is_announced_with_sync_last() -> None:
    """Wheels, gyro axes, star tracker, TIME and heartbeat on the first tick, and SYNC with the tick number last."""
    channel = make()
    assert ids(channel.announce()) == [
        0x190, 0x191, 0x192, 0x193, 0x1A0, 0x1A1, 0x1A2, 0x1B0, 0x1B1, 0x100, 0x701, 0x080,
    ]  # fmt: skip
    channel.advance()
    batch = channel.announce()
    assert ids(batch)[-1] == 0x080
    assert DECODERS[0x080](batch[-8:])[2] == 1  # type: ignore[index]


def test_a_good_command_turns_the_wheels() -> None:
    """The torque commanded is the torque applied, to the resolution of the frame (1e-7 N m)."""
    channel = make()
    channel.announce()
    assert channel.accept(commands(channel))
    channel.advance()
    assert applied(channel) == pytest.approx(TORQUES, abs=5e-8)


def test_silence_ends_in_zero_torque() -> None:
    """The last command holds for command_timeout_ticks ticks, then the motor rests."""
    channel = make(command_timeout_ticks=3)
    fly(channel, commands(channel))
    for _ in range(2):
        fly(channel, b"")
        assert applied(channel) == pytest.approx(TORQUES, abs=5e-8)
    fly(channel, b"")
    assert applied(channel) == (0.0, 0.0, 0.0, 0.0)
    assert channel.counters.timeouts == 4


def test_an_old_command_is_not_taken() -> None:
    """SYNC_CNT says which tick a command answers; more than command_max_age_ticks ago is too old, across the wrap too."""
    channel = make(command_max_age_ticks=2, command_timeout_ticks=1)
    for _ in range(256):
        fly(channel, commands(channel))
    fly(channel, commands(channel, sync_cnt=channel.tick - 2))
    assert applied(channel) == pytest.approx(TORQUES, abs=5e-8)
    fly(channel, commands(channel, sync_cnt=channel.tick - 3))
    assert applied(channel) == (0.0, 0.0, 0.0, 0.0)
    assert channel.counters.too_old == 4


def test_mode_off_is_zero_torque() -> None:
    """A command with mode 0 commands rest, whatever torque stands beside it."""
    channel = make()
    fly(channel, commands(channel, mode=0))
    assert applied(channel) == (0.0, 0.0, 0.0, 0.0)


def test_latency_delays_by_whole_ticks() -> None:
    """With two ticks of latency the command of tick 0 acts during tick 2."""
    channel = make(command_latency_ticks=2)
    seen = []
    for _ in range(3):
        fly(channel, commands(channel))
        seen.append(applied(channel)[0])
    assert seen == pytest.approx([0.0, 0.0, 0.01], abs=5e-8)


def test_bad_frames_are_counted_and_change_nothing() -> None:
    """A flipped bit, another wheel's frame under this id, a short frame, a repeat, foreign traffic."""
    channel = make()
    channel.announce()
    good = encode_RW1_CMD(0, 1, 0.05, 0)
    flipped = good[:12] + bytes([good[12] ^ 1]) + good[13:]
    masqueraded = FRAME.pack(0x111, 8, good[8:])
    short = FRAME.pack(0x110, 7, good[8:])
    foreign = FRAME.pack(0x555, 8, bytes(8)) + FRAME.pack(0x80000110, 8, good[8:])
    assert not channel.accept(flipped + masqueraded + short + foreign + good + good)
    assert channel.counters.refused == 4
    assert channel.counters.foreign == 2
    assert channel.counters.accepted == 1
    channel.advance()
    assert applied(channel) == pytest.approx((0.05, 0.0, 0.0, 0.0), abs=5e-8)


@pytest.mark.parametrize("place", ["before", "between", "after"])
@pytest.mark.parametrize("ahead", range(15))
def test_a_stray_end_of_another_cycle_neither_ends_nor_blocks_this_one(ahead: int, place: str) -> None:
    """CYCLE_DONE of another tick with any counter, before, among or after the rightful frames: tick after tick ends well."""
    channel = make()
    for _ in range(20):
        channel.announce()
        good = commands(channel)
        stray = encode_CYCLE_DONE((channel.tick + ahead) % 15, 2, channel.tick + 7, 0)
        if place == "before":
            assert not channel.accept(stray)
        at = {"before": 0, "between": 64, "after": 80}[place]
        assert channel.accept(good if place == "before" else good[:at] + stray + good[at:])
        channel.advance()
        assert applied(channel) == pytest.approx(TORQUES, abs=5e-8)
    assert channel.counters.stray + channel.counters.refused >= 20


def test_a_stray_sync_does_not_end_the_wait() -> None:
    """Nor does CYCLE_DONE of another tick as the very first frame; both are counted."""
    channel = make()
    channel.announce()
    assert not channel.accept(encode_CYCLE_DONE(0, 2, 7, 0))
    assert not channel.accept(encode_SYNC(0, 0, 0))
    assert channel.accept(encode_CYCLE_DONE(1, 2, 0, 0))
    assert (channel.counters.stray, channel.counters.foreign) == (1, 1)


def test_an_intruder_moves_no_wheel() -> None:
    """A second client with right checksums and a counter seven ahead, for 600 ticks: not one tick of its torque."""
    channel = make()
    for _ in range(600):
        channel.announce()
        ahead = (channel.tick + 7) % 15
        intruding = encode_rw_cmds(ahead, (1, 1, 1, 1), (0.1, 0.1, 0.1, 0.1), channel.tick & 0xFF)
        assert channel.accept(commands(channel) + intruding)
        channel.advance()
        assert applied(channel) == pytest.approx(TORQUES, abs=5e-8)
    assert channel._links[0x110].rivals > 580


def test_the_peer_is_known_by_its_heartbeat() -> None:
    """State and run hash of the flight software, for the meeting."""
    channel = make()
    channel.accept(encode_HEARTBEAT_FSW(0, 0, 5, 42))
    assert (channel.fsw_state, channel.fsw_run_hash) == (5, 42)
    channel.begin()
    assert channel.counters.accepted == 0


def test_a_silent_unit_sends_no_frame() -> None:
    """A dead gyro axis and a silent wheel are missing from the batch; the rest is there, in order."""
    faults = (make_fault(unit="gyro.y", kind="dead", at_s=0), make_fault(unit="wheel.3", kind="silent", at_s=0))
    channel = make(faults)
    assert ids(channel.announce())[:5] == [0x190, 0x191, 0x193, 0x1A0, 0x1A2]
