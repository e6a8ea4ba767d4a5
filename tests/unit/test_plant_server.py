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
from plant_server.channel import PlantServer
from plant_server.config import FaultConfig, PlantConfig
from plant_server.plant import Plant

FRAME = Struct("=IB3x8s")
TICK_S = 0.1
TORQUES = (0.01, -0.02, 0.03, -0.04)
WHEELS = [{"mount": mount} for mount in ("x", "y", "z", "skew")]


def make(faults: tuple[FaultConfig, ...] = (), **settings: int) -> PlantServer:
    data = {"body": {"inertia_kgm2": [[45, 3, 2], [3, 38, -1.5], [2, -1.5, 50]]}, "wheels": WHEELS, **settings}
    return PlantServer(Plant(build(PlantConfig, data, "test"), faults, TICK_S, 1), TICK_S, 42)


def commands(server: PlantServer, sync_cnt: int | None = None, mode: int = 1) -> bytes:
    tick = server.tick
    counter = tick % 15
    batch = encode_rw_cmds(counter, (mode,) * 4, TORQUES, (tick if sync_cnt is None else sync_cnt) & 0xFF)
    return batch + encode_CYCLE_DONE(counter, 2, tick, 0)


def applied(server: PlantServer) -> tuple[float, ...]:
    """Torque of each wheel on the body in the tick that ended now."""
    return server.plant.truth()[15:19]


def fly(server: PlantServer, batch: bytes | None) -> bytes:
    sent = server.announce()
    if batch is not None:
        server.accept(batch)
    server.advance()
    return sent


def ids(batch: bytes) -> list[int]:
    return [can_id for can_id, _, _ in FRAME.iter_unpack(batch)]


def test_a_tick_is_announced_with_sync_last() -> None:
    """Wheels, gyro axes, star tracker, TIME and heartbeat on the first tick, and SYNC with the tick number last."""
    server = make()
    assert ids(server.announce()) == [
        0x190, 0x191, 0x192, 0x193, 0x1A0, 0x1A1, 0x1A2, 0x1B0, 0x1B1, 0x100, 0x701, 0x080,
    ]  # fmt: skip
    server.advance()
    batch = server.announce()
    assert ids(batch)[-1] == 0x080
    assert DECODERS[0x080](batch[-8:])[2] == 1  # type: ignore[index]


def test_a_good_command_turns_the_wheels() -> None:
    """The torque commanded is the torque applied, to the resolution of the frame (1e-7 N m)."""
    server = make()
    server.announce()
    assert server.accept(commands(server))
    server.advance()
    assert applied(server) == pytest.approx(TORQUES, abs=5e-8)


def test_silence_ends_in_zero_torque() -> None:
    """The last command holds for command_timeout_ticks ticks, then the motor rests."""
    server = make(command_timeout_ticks=3)
    fly(server, commands(server))
    for _ in range(2):
        fly(server, b"")
        assert applied(server) == pytest.approx(TORQUES, abs=5e-8)
    fly(server, b"")
    assert applied(server) == (0.0, 0.0, 0.0, 0.0)
    assert server.counters.timeouts == 4


def test_an_old_command_is_not_taken() -> None:
    """SYNC_CNT says which tick a command answers; more than command_max_age_ticks ago is too old, across the wrap too."""
    server = make(command_max_age_ticks=2, command_timeout_ticks=1)
    for _ in range(256):
        fly(server, commands(server))
    fly(server, commands(server, sync_cnt=server.tick - 2))
    assert applied(server) == pytest.approx(TORQUES, abs=5e-8)
    fly(server, commands(server, sync_cnt=server.tick - 3))
    assert applied(server) == (0.0, 0.0, 0.0, 0.0)
    assert server.counters.too_old == 4


def test_mode_off_is_zero_torque() -> None:
    """A command with mode 0 commands rest, whatever torque stands beside it."""
    server = make()
    fly(server, commands(server, mode=0))
    assert applied(server) == (0.0, 0.0, 0.0, 0.0)


def test_latency_delays_by_whole_ticks() -> None:
    """With two ticks of latency the command of tick 0 acts during tick 2."""
    server = make(command_latency_ticks=2)
    seen = []
    for _ in range(3):
        fly(server, commands(server))
        seen.append(applied(server)[0])
    assert seen == pytest.approx([0.0, 0.0, 0.01], abs=5e-8)


def test_bad_frames_are_counted_and_change_nothing() -> None:
    """A flipped bit, another wheel's frame under this id, a short frame, a repeat, foreign traffic."""
    server = make()
    server.announce()
    good = encode_RW1_CMD(0, 1, 0.05, 0)
    flipped = good[:12] + bytes([good[12] ^ 1]) + good[13:]
    masqueraded = FRAME.pack(0x111, 8, good[8:])
    short = FRAME.pack(0x110, 7, good[8:])
    foreign = FRAME.pack(0x555, 8, bytes(8)) + FRAME.pack(0x80000110, 8, good[8:])
    assert not server.accept(flipped + masqueraded + short + foreign + good + good)
    assert server.counters.refused == 4
    assert server.counters.foreign == 2
    assert server.counters.accepted == 1
    server.advance()
    assert applied(server) == pytest.approx((0.05, 0.0, 0.0, 0.0), abs=5e-8)


@pytest.mark.parametrize("place", ["before", "between", "after"])
@pytest.mark.parametrize("ahead", range(15))
def test_a_stray_end_of_another_cycle_neither_ends_nor_blocks_this_one(ahead: int, place: str) -> None:
    """CYCLE_DONE of another tick with any counter, before, among or after the rightful frames: tick after tick ends well."""
    server = make()
    for _ in range(20):
        server.announce()
        good = commands(server)
        stray = encode_CYCLE_DONE((server.tick + ahead) % 15, 2, server.tick + 7, 0)
        if place == "before":
            assert not server.accept(stray)
        at = {"before": 0, "between": 64, "after": 80}[place]
        assert server.accept(good if place == "before" else good[:at] + stray + good[at:])
        server.advance()
        assert applied(server) == pytest.approx(TORQUES, abs=5e-8)
    assert server.counters.stray + server.counters.refused >= 20


def test_a_stray_sync_does_not_end_the_wait() -> None:
    """Nor does CYCLE_DONE of another tick as the very first frame; both are counted."""
    server = make()
    server.announce()
    assert not server.accept(encode_CYCLE_DONE(0, 2, 7, 0))
    assert not server.accept(encode_SYNC(0, 0, 0))
    assert server.accept(encode_CYCLE_DONE(1, 2, 0, 0))
    assert (server.counters.stray, server.counters.foreign) == (1, 1)


def test_an_intruder_moves_no_wheel() -> None:
    """A second client with right checksums and a counter seven ahead, for 600 ticks: not one tick of its torque."""
    server = make()
    for _ in range(600):
        server.announce()
        ahead = (server.tick + 7) % 15
        intruding = encode_rw_cmds(ahead, (1, 1, 1, 1), (0.1, 0.1, 0.1, 0.1), server.tick & 0xFF)
        assert server.accept(commands(server) + intruding)
        server.advance()
        assert applied(server) == pytest.approx(TORQUES, abs=5e-8)
    assert server._links[0x110].rivals > 580


def test_the_peer_is_known_by_its_heartbeat() -> None:
    """State and run hash of the flight software, for the meeting."""
    server = make()
    server.accept(encode_HEARTBEAT_FSW(0, 0, 5, 42))
    assert (server.fsw_state, server.fsw_run_hash) == (5, 42)
    server.begin()
    assert server.counters.accepted == 0


def test_a_silent_unit_sends_no_frame() -> None:
    """A dead gyro axis and a silent wheel are missing from the batch; the rest is there, in order."""
    faults = tuple(
        build(FaultConfig, fault, "test")
        for fault in ({"unit": "gyro.y", "kind": "dead", "at_s": 0}, {"unit": "wheel.3", "kind": "silent", "at_s": 0})
    )
    server = make(faults)
    assert ids(server.announce())[:5] == [0x190, 0x191, 0x193, 0x1A0, 0x1A2]
