"""What is taken a batch at a time is taken exactly as it would be frame by frame.

The oracle is the general path: the same side with a group that never expects anything, which sends every batch there.
"""

from __future__ import annotations

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from bus.icd.codec import (
    DECODERS,
    decode_commands,
    decode_sensors,
    encode_CYCLE_DONE,
    encode_fogs,
    encode_HEARTBEAT_FSW,
    encode_HEARTBEAT_PLANT,
    encode_RW1_CMD,
    encode_rw_cmds,
    encode_rw_tlms,
    encode_STR_QA,
    encode_STR_QB,
    encode_SYNC,
    encode_TIME,
)
from bus.icd.e2e import Link, Pace
from bus.settings import build
from bus.wire.frames import FRAME
from fsw.config import FswConfig
from fsw.inputs import Inputs
from fsw.vehicle import Vehicle
from plant_server.channel import Channel
from plant_server.config import PlantConfig
from plant_server.plant import Plant

EXAMPLES = settings.default.max_examples
TICK_S = 0.1
FSW = build(
    FswConfig,
    {
        "model": {"inertia_kgm2": [[45, 3, 2], [3, 38, -1.5], [2, -1.5, 50]]},
        "estimator": {"kind": "direct"},
        "observer": {"kind": "ilo"},
        "controller": {"kind": "smc"},
    },
    "test",
)
PLANT = build(
    PlantConfig,
    {
        "step_s": TICK_S,
        "body": {"inertia_kgm2": [[45, 3, 2], [3, 38, -1.5], [2, -1.5, 50]], "attitude_q": [1, 0, 0, 0],
                 "rate_deg_s": [0, 0, 0]},
        "wheels": [{"mount": mount, "max_torque_nm": 0.1} for mount in ("x", "y", "z", "skew")],
        "command_max_age_ticks": 2,
    },
    "test",
)  # fmt: skip

speeds = st.floats(-900.0, 900.0)
rates = st.floats(-2.0, 2.0)
torques = st.floats(-12.0, 12.0)


@st.composite
def sensor_frames(draw: Any, tick: int) -> list[bytes]:
    """The frames of one tick of the plant, nearly always as they should be."""
    counter = tick % 15
    status = draw(st.sampled_from([0, 0, 0, 0, 0, 0, 0, 1, 2, 3]))
    speed = (draw(speeds), draw(speeds), draw(speeds), draw(speeds))
    batch = encode_rw_tlms(counter, (0, 0, status, 0), speed, (1.0, 2.0, 3.0, 4.0), tick & 0xFF)
    fog_status = draw(st.sampled_from([0, 0, 0, 0, 0, 0, 0, 1, 2]))
    batch += encode_fogs(counter, (fog_status, 0, 0), (draw(rates), draw(rates), draw(rates)), tick & 0xFF)
    if draw(st.booleans()):
        batch += encode_STR_QA(tick // 3 % 15, 1, 0.6, 0.0) + encode_STR_QB(tick // 3 % 15, 1, 0.8, 0.0)
    if draw(st.booleans()):
        batch += encode_TIME(counter, 0, tick, 0.5) + encode_HEARTBEAT_PLANT(counter, 0, 5, 77)
    return split(batch + encode_SYNC(counter, 0, tick))


@st.composite
def command_frames(draw: Any, tick: int) -> list[bytes]:
    """The frames of one cycle of the flight software, nearly always as they should be."""
    last_mode = draw(st.sampled_from([1, 1, 1, 1, 0, 3]))
    torque = (draw(torques), draw(torques), draw(torques), draw(torques))
    sync_cnt = (tick - draw(st.sampled_from([0, 0, 0, 0, 1, 2, 3, 200]))) & 0xFF
    batch = encode_rw_cmds(tick % 15, (1, 1, 1, last_mode), torque, sync_cnt)
    if draw(st.booleans()):
        batch += encode_HEARTBEAT_FSW(tick % 15, 0, 5, 77)
    return split(batch + encode_CYCLE_DONE(tick % 15, draw(st.integers(0, 3)), tick, 0))


def names_of(cls: type) -> tuple[str, ...]:
    """The attributes of a class with slots, which one that is compiled names otherwise."""
    names: tuple[str, ...] = getattr(cls, "__mypyc_attrs__", ()) or cls.__slots__  # type: ignore[attr-defined]
    return names


def split(batch: bytes) -> list[bytes]:
    return [batch[at : at + 16] for at in range(0, len(batch), 16)]


@st.composite
def disturbed(draw: Any, frames: list[bytes]) -> bytes:
    """The batch as it is (mostly), or with frames lost, doubled, swapped, of other tick, or with bits turned over."""
    for _ in range(draw(st.sampled_from([0, 0, 0, 1, 2]))):
        at = draw(st.integers(0, len(frames) - 1)) if frames else 0
        match draw(st.sampled_from(["lose", "double", "swap", "flip", "insert", "intrude", "cut"])):
            case "lose":
                frames = frames[:at] + frames[at + 1 :]
            case "double":
                frames = [*frames[: at + 1], *frames[at:]]
            case "swap" if frames:
                frames = [*frames[:at], *frames[at + 1 :], frames[at]]
            case "flip" if frames:
                bit = draw(st.integers(0, 127))
                turned = int.from_bytes(frames[at], "little") ^ 1 << bit
                frames = [*frames[:at], turned.to_bytes(16, "little"), *frames[at + 1 :]]
            case "insert":
                other = draw(st.sampled_from(sorted(DECODERS)) | st.integers(0, 0xFFFFFFFF))
                junk = other.to_bytes(4, "little") + b"\x08\0\0\0" + draw(st.binary(min_size=8, max_size=8))
                frames = [*frames[:at], junk, *frames[at:]]
            case "intrude":
                counter = draw(st.integers(0, 14))
                frames = [
                    *frames[:at],
                    encode_RW1_CMD(counter, 1, 0.5, counter),
                    encode_SYNC(counter, 0, at),
                    *frames[at:],
                ]
            case "cut":
                frames = frames[:at]
    return b"".join(frames)


def forget(side: Inputs | Channel) -> None:
    """Send this side's next batch through the general path."""
    side._group.part()
    side._group.expected = -1


def describe_links(links: dict[int, Any]) -> list[tuple[Any, ...]]:
    """All that a link knows, its suspicions included."""
    parts = [name for name in names_of(Link) if name not in ("decode", "_pace")]
    return [
        (i, *(getattr(link, name) for name in parts), *(getattr(link._pace, name) for name in names_of(Pace)))
        for i, link in sorted(links.items())
    ]


@settings(max_examples=EXAMPLES, deadline=None)
@given(st.data())
def test_sensors_are_the_same_by_both_ways(data: st.DataObject) -> None:
    """Sensors, counters and every link are equal after every tick, whatever happens to the batches."""
    usual, each = (Inputs(FSW.modes, Vehicle(FSW.model), TICK_S, 77) for _ in range(2))
    for tick in range(data.draw(st.integers(1, 20))):
        batch = data.draw(disturbed(data.draw(sensor_frames(tick))))
        forget(each)
        assert usual.receive(tick, batch) == each.receive(tick, batch)
        assert usual.counters == each.counters
        assert (usual.plant_tick, usual.plant_state) == (each.plant_tick, each.plant_state)
    assert describe_links(usual.links) == describe_links(each.links)


@settings(max_examples=EXAMPLES, deadline=None)
@given(st.data())
def test_commands_are_the_same_by_both_ways(data: st.DataObject) -> None:
    """Torques in effect, counters and every link are equal after every tick, whatever happens to the batches."""
    usual, each = (Channel(Plant(PLANT, (), TICK_S, 1), TICK_S, 77) for _ in range(2))
    for tick in range(data.draw(st.integers(1, 20))):
        assert usual.announce() == each.announce()
        batch = data.draw(disturbed(data.draw(command_frames(tick))))
        forget(each)
        assert usual.accept(batch) == each.accept(batch)
        usual.advance()
        each.advance()
        assert usual.counters == each.counters
        assert repr(usual.plant.truth()) == repr(each.plant.truth())
        assert (usual.done_tick, usual.fsw_state) == (each.done_tick, each.fsw_state)
    for side in (usual, each):
        side._group.part()
    assert describe_links(usual._links) == describe_links(each._links)


def test_the_usual_batch_is_taken_at_once() -> None:
    """The quick way is in use at all, and its values are those of the decoders one by one, digit for digit."""
    sensors = (
        encode_rw_tlms(4, (0, 0, 0, 0), (1.5, -2.5, 600.123, 0.001), (1.0, 2.0, 3.0, 4.0), 9)
        + encode_fogs(4, (0, 0, 0), (0.1, -0.2, 0.3), 9)
        + encode_SYNC(4, 0, 9)
    )
    one_by_one = [values for can_id, _, data in FRAME.iter_unpack(sensors) if (values := DECODERS[can_id](data))]
    assert decode_sensors(sensors, 4) == (
        *(values[2] for values in one_by_one[:4]), *(values[3] for values in one_by_one[:4]),
        *(values[2] for values in one_by_one[4:]),
    )  # fmt: skip
    commands = encode_rw_cmds(4, (1, 1, 1, 1), (0.01, -0.02, 0.03, 0.1), 9) + encode_CYCLE_DONE(4, 2, 9, 0)
    one_by_one = [DECODERS[int.from_bytes(frame[:4], "little")](frame[8:]) for frame in split(commands)]
    assert decode_commands(commands, 4) == (
        *(values[2] for values in one_by_one[:4] if values is not None), 9, 9, 9, 9, 9,
    )  # fmt: skip
    for counter in (5, 14, -1):
        assert decode_sensors(sensors, counter)[-1] == -1
        assert decode_commands(commands, counter)[-1] == -1


def test_one_turned_bit_is_always_seen() -> None:
    """No batch with a single bit turned over, anywhere in header, padding, checksum or payload, passes."""
    commands = encode_rw_cmds(4, (1, 1, 1, 1), (0.01, -0.02, 0.03, 0.1), 9) + encode_CYCLE_DONE(4, 2, 9, 0)
    bits = int.from_bytes(commands, "little")
    assert all(decode_commands((bits ^ 1 << bit).to_bytes(80, "little"), 4)[-1] == -1 for bit in range(640))
    sensors = (
        encode_rw_tlms(4, (0, 0, 0, 0), (1.5, -2.5, 600.123, 0.001), (1.0, 2.0, 3.0, 4.0), 9)
        + encode_fogs(4, (0, 0, 0), (0.1, -0.2, 0.3), 9)
        + encode_SYNC(4, 0, 9)
    )
    bits = int.from_bytes(sensors, "little")
    assert all(decode_sensors((bits ^ 1 << bit).to_bytes(128, "little"), 4)[-1] == -1 for bit in range(1024))


def test_after_a_sync_of_another_tick_both_ways_judge_the_wheels_the_same() -> None:
    """A second sender's SYNC(6) within the frames of tick 0 makes the wheels of tick 1 too old, whichever way they take."""
    usual, each = (Inputs(FSW.modes, Vehicle(FSW.model), TICK_S, 77) for _ in range(2))
    for tick in range(4):
        frames = split(
            encode_rw_tlms(tick, (0, 0, 0, 0), (1.0, 2.0, 3.0, 4.0), (1.0, 2.0, 3.0, 4.0), tick)
            + encode_fogs(tick, (0, 0, 0), (0.1, -0.2, 0.3), tick)
            + encode_SYNC(tick, 0, tick)
        )
        if tick == 0:
            frames.insert(-2, encode_SYNC(0, 0, 6))
        forget(each)
        assert usual.receive(tick, b"".join(frames)) == each.receive(tick, b"".join(frames))
        assert usual.counters == each.counters
        assert [wheel.new for wheel in usual.sensors.wheels] == [tick != 1] * 4
