"""Whatever is packed comes back: through the mcap library's reader and an outside CDR decoder, and through ours."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory

from bus.telemetry.cdr import PRIMITIVES
from bus.telemetry.link import Field, TickPacker, Topic, announce_topics, pack_frames
from tools.log.diff import compare_runs
from tools.log.mcap_reader import read_run
from tools.log.recorder import Recorder

VALUES = {
    "float64": st.floats(allow_nan=False),
    "uint64": st.integers(0, 2**64 - 1),
    "uint32": st.integers(0, 2**32 - 1),
    "int32": st.integers(-(2**31), 2**31 - 1),
    "uint8": st.integers(0, 255),
    "bool": st.booleans(),
}


@st.composite
def topics_with_ticks(draw: st.DrawFn) -> tuple[list[Topic], list[list[Any]]]:
    """Up to three topics of any layout, and the flat values of a few ticks."""
    shapes = st.lists(st.tuples(st.sampled_from(sorted(PRIMITIVES)), st.integers(1, 5)), min_size=1, max_size=8)
    topics = [
        Topic(f"/t{number}", f"hilsat/T{number}", tuple(Field(f"f{i}", kind, n) for i, (kind, n) in enumerate(shape)))  # type: ignore[arg-type]
        for number, shape in enumerate(draw(st.lists(shapes, min_size=1, max_size=3)))
    ]
    kinds = [field.kind for topic in topics for field in topic.fields for _ in range(field.count)]
    ticks = draw(st.lists(st.tuples(*(VALUES[kind] for kind in kinds)), min_size=1, max_size=6))
    return topics, [list(tick) for tick in ticks]


def expected(topics: list[Topic], ticks: list[list[Any]]) -> dict[str, dict[str, list[Any]]]:
    """Topic -> field -> values per tick, a list where the field has several."""
    found: dict[str, dict[str, list[Any]]] = {}
    at = 0
    for topic in topics:
        found[topic.name] = {}
        for field in topic.fields:
            cut = slice(at, at + field.count)
            found[topic.name][field.name] = [tick[cut] if field.count > 1 else tick[at] for tick in ticks]
            at += field.count
    return found


@settings(max_examples=60, deadline=None)
@given(topics_with_ticks(), st.integers(0, 2**31 * 10**9 - 10**6))
def test_every_layout_survives_an_outside_decoder(case: tuple[list[Topic], list[list[Any]]], start_ns: int) -> None:
    """Schema text and bytes agree as mcap-ros2-support reads them, stamps included, and as our numpy reader does."""
    topics, ticks = case
    packer = TickPacker(topics, 2)
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "a.mcap"
        recorder = Recorder(path, metadata={}, sources=[1])
        link = recorder.link(1)
        link.announce(announce_topics([packer]))
        for tick, values in enumerate(ticks):
            link.write_tick(tick, start_ns + tick, packer.pack(tick, start_ns + tick, *values))
        recorder.close()
        want = expected(topics, ticks)
        with open(path, "rb") as file:
            decoded = list(
                make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
            )
        run = read_run(path)
    assert len(decoded) == len(ticks) * len(topics)
    for _, channel, message, content in decoded:
        tick = message.sequence
        assert (content.stamp.sec, content.stamp.nanosec) == divmod(start_ns + tick, 10**9)
        assert message.log_time == message.publish_time == start_ns + tick
        for name, values in want[channel.topic].items():
            got = getattr(content, name)
            assert (list(got) if isinstance(values[tick], list) else got) == values[tick]
    for topic, fields in want.items():
        signals = run.signals(topic)
        assert list(signals) == list(fields)
        for name, values in fields.items():
            assert signals[name].tolist() == values
        assert run.t_ns(topic).tolist() == [start_ns + tick for tick in range(len(ticks))]
        assert run.sequences(topic) == list(range(len(ticks)))


PLANT = TickPacker([Topic("/truth/x", "hilsat/X", (Field("x"), Field("n", "uint8")))], 2)
FSW = TickPacker([Topic("/fsw/y", "hilsat/Y", (Field("y", count=3),))], 101)


def write_run(path: Path, schedule: list[int], ticks: int, flush_every: int) -> None:
    """Play two sources tick by tick; `schedule` says who goes next as long as both have something to say."""
    clock = iter(range(10**9))
    recorder = Recorder(path, metadata={}, clock=lambda: float(next(clock) // flush_every))
    links = {1: recorder.link(1), 2: recorder.link(2)}
    links[1].announce(announce_topics([PLANT], {1: "bus0"}))
    links[2].announce(announce_topics([FSW]))
    at = {1: 0, 2: 0}
    turns = iter(schedule)
    while at[1] < ticks or at[2] < ticks:
        source = next(turns, 1)
        source = source if at[source] < ticks else 3 - source
        tick = at[source]
        t_ns = tick * 1000
        if source == 1:
            frames = bytes([tick % 256] * 16 * (tick % 4))  # the number of frames varies, so do the lengths of ticks
            links[1].write_tick(
                tick, t_ns, pack_frames(1, tick, t_ns, frames) + PLANT.pack(tick, t_ns, tick / 3, tick % 256)
            )
            if tick % 5 == 0:
                links[1].event(t_ns, "info", "plant", f"after {tick}")
        else:
            links[2].write_tick(tick, t_ns, FSW.pack(tick, t_ns, tick * 1.0, 0.0, -1.0))
            if tick % 7 == 0:
                links[2].event(t_ns, "info", "fsw", f"after {tick}")
        at[source] += 1
        if at[source] == ticks:
            links[source].close("done")
    recorder.close()


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.sampled_from([1, 2]), max_size=80), st.lists(st.sampled_from([1, 2]), max_size=80),
    st.integers(1, 40), st.integers(1, 30), st.integers(1, 30),
)  # fmt: skip
def test_content_and_order_do_not_depend_on_scheduling(
    one: list[int], two: list[int], ticks: int, flush_one: int, flush_two: int
) -> None:
    """Two runs that differ in who was ahead when, and in when chunks were closed, say the same in the same order."""
    with tempfile.TemporaryDirectory() as directory:
        paths = [Path(directory) / name for name in ("a.mcap", "b.mcap")]
        write_run(paths[0], one, ticks, flush_one)
        write_run(paths[1], two, ticks, flush_two)
        orders = []
        for path in paths:
            with open(path, "rb") as file:
                reader = NonSeekingReader(file, validate_crcs=True).iter_messages(log_time_order=False)
                orders.append([(channel.topic, message.log_time, message.data) for _, channel, message in reader])
        runs = [read_run(path) for path in paths]
    assert orders[0] == orders[1]
    assert len(orders[0]) == 3 * ticks + len(range(0, ticks, 5)) + len(range(0, ticks, 7))
    assert compare_runs(*runs).same


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_a_file_cut_anywhere_gives_back_a_beginning_of_the_run(data: st.DataObject) -> None:
    """Cut at any byte: never an error, and what is read is exactly the first n ticks of what was written."""
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "a.mcap"
        write_run(path, [1, 2] * 200, 200, 60)
        whole = read_run(path)
        raw = path.read_bytes()
        path.write_bytes(raw[: data.draw(st.integers(8, len(raw)))])
        cut = read_run(path)
    for topic in ("/truth/x", "/fsw/y", "/can/bus0"):
        if topic in cut.topics:
            got = cut.payloads(topic)
            assert got == whole.payloads(topic)[: len(got)]
            assert np.array_equal(cut.t_ns(topic), whole.t_ns(topic)[: len(got)])
