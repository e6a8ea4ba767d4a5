"""What the flight software makes of a bus that fails: who is silent, what babbles, what its CAN controller says."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from bus.icd.batches import encode_fogs, encode_rw_tlms, encode_SYNC
from bus.icd.codec import encode_STR_QA, encode_STR_QB
from bus.settings import build
from bus.wire.frames import ERR_FLAG, FRAME, FRAME_SIZE
from fsw.inputs import Inputs
from fsw.link_watch import MOST_TAKEN, ROW, UNITS
from fsw.settings import ModelConfig, ModesConfig
from fsw.vehicle import Vehicle
from tools.run.bench import Bench

INERTIA = [[45, 3, 2], [3, 38, -1.5], [2, -1.5, 50]]


def make_inputs() -> Inputs:
    model = build(ModelConfig, {"inertia_kgm2": INERTIA}, "test")
    return Inputs(ModesConfig(stale_after_ticks=5, star_stale_after_s=0.5), Vehicle(model), 0.01, 7)


def batch(k: int, *, without: tuple[int, ...] = (), extra: bytes = b"", star: bool = True) -> bytes:
    tlms = encode_rw_tlms(k % 15, (0,) * 4, (1.0, 2.0, 3.0, 4.0), (0.0,) * 4, k & 0xFF)
    fogs = encode_fogs(k % 15, (0,) * 3, (0.1, 0.2, 0.3), k & 0xFF)
    frames = tlms + fogs
    kept = b"".join(frames[i * FRAME_SIZE : (i + 1) * FRAME_SIZE] for i in range(7) if i not in without)
    stars = encode_STR_QA(k % 15, 0, 1.0, 0.0) + encode_STR_QB(k % 15, 0, 0.0, 0.0) if star else b""
    return kept + stars + extra + encode_SYNC(k % 15, 0, k)


def fly(inputs: Inputs, first: int, last: int, **keys: Any) -> list[str]:
    """The lines of these ticks."""
    for k in range(first, last):
        inputs.receive(k, batch(k, **keys))
    return [f"{tick} {level}: {words}" for tick, level, words in inputs.watch.take_lines()]


def test_nothing_is_said_while_all_is_well() -> None:
    """1000 ticks in which every unit speaks: no line, no trouble, and the watch is asked for the star tracker alone."""
    inputs = make_inputs()
    appointments = set()  # each look ahead makes the next one
    for tick in range(1000):
        assert fly(inputs, tick, tick + 1) == []
        appointments.add(inputs.watch.next_look)
    assert not inputs.watch.is_troubled
    assert 1 < len(appointments) < 25


@pytest.mark.parametrize(("place", "unit"), [(0, "wheel.1"), (3, "wheel.4"), (4, "gyro.x"), (6, "gyro.z")])
def test_a_unit_that_falls_silent_is_named_once_and_so_is_its_return(place: int, unit: str) -> None:
    """After 10 ticks without a frame, with the tick from which on it is missing; back with the second frame, which is
    the first that the alive counter lets in.
    """
    inputs = make_inputs()
    assert fly(inputs, 0, 100) == []
    assert fly(inputs, 100, 200, without=(place,)) == [f"110 warning: {unit} is silent since tick 100"]
    assert inputs.watch.silent == [name == unit for name in UNITS]
    assert fly(inputs, 200, 300) == [f"201 info: {unit} is heard again"]
    assert not any(inputs.watch.silent)


def test_units_that_fall_silent_together_share_a_line() -> None:
    """A bus that is gone is one thing to say; the star tracker, whose frames are held for longer, follows."""
    inputs = make_inputs()
    fly(inputs, 0, 100)
    lines = fly(inputs, 100, 200, without=tuple(range(7)), star=False)
    assert lines == [
        "110 warning: wheel.1, wheel.2, wheel.3, wheel.4, gyro.x, gyro.y, gyro.z are silent since tick 100",
        "150 warning: star_tracker is silent since tick 100",
    ]


def test_a_star_tracker_falls_silent_while_all_others_speak() -> None:
    """Half a second, its hold, after its last frame; the batches are the usual ones meanwhile."""
    inputs = make_inputs()
    fly(inputs, 0, 100)
    assert fly(inputs, 100, 200, star=False) == ["150 warning: star_tracker is silent since tick 100"]
    assert fly(inputs, 200, 300) == ["201 info: star_tracker is heard again"]


def test_a_unit_whose_frames_are_all_refused_is_told_from_a_mute_one() -> None:
    """Frames with a wrong checksum come: it is not the wire that is cut."""
    inputs = make_inputs()
    fly(inputs, 0, 100)
    bad = FRAME.pack(0x191, 8, bytes(8))
    assert fly(inputs, 100, 120, without=(1,), extra=bad) == [
        "110 warning: wheel.2 is silent since tick 100: what comes is refused"
    ]


def test_a_unit_that_comes_and_goes_is_not_named_again_at_once() -> None:
    """13 ticks away, four back, for 10 s: a line in 5 s, and its return; not a hundred."""
    inputs = make_inputs()
    lines = []
    for k in range(1000):
        lines += fly(inputs, k, k + 1, without=(2,) if k % 17 >= 4 else ())
    assert 2 <= len(lines) <= 6


def test_nothing_from_the_start_is_said_too() -> None:
    """Empty cycles since boot."""
    inputs = make_inputs()
    for k in range(12):
        inputs.receive(k, b"")
    assert next(words for _, _, words in inputs.watch.take_lines()).endswith("gyro.z are silent since tick 0")


@pytest.mark.parametrize("can_id", [0x010, 0x192, 0x7A5])
def test_a_babbling_id_is_named_once(can_id: int) -> None:
    """20 frames a tick: named on the third tick in a row, over ten ticks after the last."""
    inputs = make_inputs()
    fly(inputs, 0, 100)
    flood = FRAME.pack(can_id, 8, bytes(8)) * 20
    count = 21 if can_id == 0x192 else 20  # with the one that wheel 3 sends itself
    words = f"babbling: id 0x{can_id:03X}, {count} frames a tick"
    assert fly(inputs, 100, 200, extra=flood) == [f"{99 + ROW} warning: {words}"]
    assert inputs.watch.babbling == 1
    assert fly(inputs, 200, 300) == [f"210 info: id 0x{can_id:03X} no longer babbles"]
    assert inputs.watch.babbling == 0
    assert all(wheel.valid for wheel in inputs.sensors.wheels)


def test_frames_of_many_foreign_ids_are_a_flood_as_well() -> None:
    """40 ids once each: named together."""
    inputs = make_inputs()
    flood = b"".join(FRAME.pack(0x600 + i, 8, bytes(8)) for i in range(40))
    assert fly(inputs, 0, 50, extra=flood) == ["2 warning: babbling: frames that nobody listens to, 40 frames a tick"]


def test_what_has_piled_up_is_no_babble() -> None:
    """Ten ticks' frames at once, as after a cycle that was late, say nothing."""
    inputs = make_inputs()
    fly(inputs, 0, 100)
    inputs.receive(109, b"".join(batch(k) for k in range(100, 110)))
    assert fly(inputs, 110, 200) == []


def test_a_flood_is_cut_and_the_rest_counted() -> None:
    """Of 4000 frames of one id in a batch MOST_TAKEN are looked at; SYNC behind them still counts."""
    inputs = make_inputs()
    fly(inputs, 0, 10)
    refused = inputs.counters.refused
    inputs.receive(10, batch(10, extra=FRAME.pack(0x1B1, 8, bytes(8)) * 4000, star=False))
    assert inputs.watch.flooded == 4000 - MOST_TAKEN
    assert inputs.counters.refused == refused + MOST_TAKEN
    assert inputs.plant_tick == 10


def error(kind: int, word: int = 0) -> bytes:
    return FRAME.pack(ERR_FLAG | kind, 8, bytes([0, word, 0, 0, 0, 0, 0, 0]))


def test_error_frames_are_counted_and_a_change_of_state_is_said() -> None:
    """Warning, passive, off, restarted; a bus error is counted alone. None is a foreign frame."""
    inputs = make_inputs()
    lines = []
    for k, frame in enumerate(
        [error(0x204, 8), error(0x88), error(0x204, 0x20), error(0x240), error(0x304, 0x40), error(0x88)]
    ):
        lines += fly(inputs, k, k + 1, extra=frame)
    assert lines == [
        "0 info: CAN controller at the warning limit", "2 warning: CAN controller error passive",
        "3 warning: CAN controller bus-off", "4 info: CAN controller restarted",
    ]  # fmt: skip
    assert (inputs.watch.error_frames, inputs.counters.foreign) == (6, 0)


def test_a_controller_that_goes_to_and_fro_does_not_flood_the_log() -> None:
    """Off and back on every tick for 10 s: each word at most once in 5 s."""
    inputs = make_inputs()
    lines = []
    for k in range(1000):
        lines += fly(inputs, k, k + 1, extra=error(0x240) if k % 2 else error(0x304, 0x40))
    assert len(lines) <= 4


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    """A run in which wheel 3 says nothing for 0.5 s."""
    with Bench.open("zhang2018-flight", ["faults=[]"], log="memory") as bench:
        bench.inject(at_tick=50, unit="bus", kind="silent", node="wheel.3", until_s=1.0)
        yield bench.step(150)


def test_what_is_said_is_in_the_log(bench: Bench) -> None:
    """A line in /events for silence and return, and /fsw/link_health from the first trouble on, not before."""
    words = [event["message"] for event in bench.log.records("/events")]
    assert words.count("wheel.3 is silent since tick 50") == words.count("wheel.3 is heard again") == 1
    health = bench.log.signals("/fsw/link_health")
    ticks = bench.log.ticks("/fsw/link_health")
    assert ticks[0] == 60
    assert health["silent"][ticks < 100][:, 2].all()
    assert not health["silent"][ticks > 101].any()
    assert bench.read("fsw.link_health.silent") == (False,) * 8


def test_a_sound_run_has_no_record_of_the_links() -> None:
    """Nor one of the wire: what ran before runs on without either."""
    with Bench.open("zhang2018-flight", ["faults=[]"], log="memory") as bench:
        run = bench.step(100).log
        assert not run.has("/fsw/link_health")
        assert "/plant/bus" not in run.topics
