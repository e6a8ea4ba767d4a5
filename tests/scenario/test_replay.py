"""A log is evidence: flown again it says the same to the bit, and what was changed in it is found where it was changed."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Message
from mcap.writer import Writer

from bus.errors import RecordError
from tools.cli import main
from tools.log.mcap_reader import read_run
from tools.replay.inputs import parse_input
from tools.run.bench import Bench
from tools.verbs.replay import replay

INPUT, FRAMES, CONTROL = "/fsw/input", "/can/bus0", "/fsw/control"
SHORT = ["duration_s=4", "expect=[]", "faults=[]", "clock.mode=inprocess"]


def fly(path: Path, scenario: str = "nominal", overrides: list[str] | None = None) -> Path:
    """A log of a whole run in process."""
    with Bench.open(scenario, SHORT if overrides is None else overrides, log=path) as bench:
        bench.run_to_end()
    return path


def rewrite(source: Path, target: Path, edit: Callable[[str, Message], bytes | None]) -> Path:
    """The same log with other message data, by an outside library; `edit` returns None for a message to leave out."""
    with source.open("rb") as reading, target.open("wb") as writing:
        reader, writer = make_reader(reading), Writer(writing)
        writer.start()
        summary = reader.get_summary()
        assert summary is not None
        schemas = {key: writer.register_schema(s.name, s.encoding, s.data) for key, s in summary.schemas.items()}
        channels = {
            key: writer.register_channel(c.topic, c.message_encoding, schemas.get(c.schema_id, 0), dict(c.metadata))
            for key, c in summary.channels.items()
        }
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, dict(record.metadata))
        for file in reader.iter_attachments():
            writer.add_attachment(file.create_time, file.log_time, file.name, file.media_type, file.data)
        for _, channel, message in reader.iter_messages(log_time_order=False):
            data = edit(channel.topic, message)
            if data is not None:
                writer.add_message(channels[channel.id], message.log_time, data, message.publish_time, message.sequence)
        writer.finish()
    return target


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run with noisy sensors."""
    overrides = [*SHORT, "plant.gyro.preset=tactical"]
    return fly(tmp_path_factory.mktemp("replay") / "run.mcap", overrides=overrides)


def test_a_run_is_repeated_to_the_bit(log: Path) -> None:
    """Every record and every frame of it, and none was left out of the comparison."""
    outcome = replay(log)
    assert (outcome.differing_ticks, outcome.first, outcome.unheard) == (0, None, 0)
    with log.open("rb") as file:
        counts = {}
        for _, channel, _ in make_reader(file).iter_messages():
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
    assert outcome.ticks == counts[INPUT]
    flight = sum(n for topic, n in counts.items() if topic.startswith("/fsw/") and topic != "/fsw/timing")
    assert outcome.records == flight
    assert outcome.frames == outcome.ticks * 5 + 4  # four commands and CYCLE_DONE, and a heartbeat a second


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["zhang2018", "slew", "gyro-dead", "wang2010-periodic", "seizure", "bus-sag"])
def test_whole_scenarios_are_repeated_to_the_bit(scenario: str, tmp_path: Path) -> None:
    """Commands of the ground, faults, noise, detectors: nothing but what was logged decides what the software says."""
    outcome = replay(fly(tmp_path / "run.mcap", scenario, ["clock.mode=inprocess"]))
    assert outcome.same
    assert (outcome.unheard, outcome.first) == (0, None)


@pytest.mark.slow
@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_a_run_of_two_processes_is_repeated_to_the_bit(clock: str, tmp_path: Path) -> None:
    """In real time too: what counts is what arrived before which cycle."""
    out = tmp_path / "out"
    words = ["run", "nominal", "--clock", clock, "--set", "duration_s=5", "--set", "expect=[]", "--no-plot", "-q"]
    assert main([*words, "--out", str(out)]) in (0, 1)
    outcome = replay(out / "run.mcap")
    assert outcome.same
    assert outcome.ticks >= 45
    assert outcome.unheard <= (30 if clock == "realtime" else 0)


@settings(max_examples=12)
@given(seed=st.integers(0, 2**32))
def test_one_bit_of_an_input_is_found_at_its_tick(log: Path, seed: int) -> None:
    """Whichever it is: of a frame, of the flags, of the number of slips, of the checksum itself."""
    dice = random.Random(seed)
    tick = dice.randrange(40)
    place = dice.random()

    def flip(topic: str, message: Message) -> bytes | None:
        if topic != INPUT or message.sequence != tick:
            return bytes(message.data)
        data = bytearray(message.data)
        bit = 12 * 8 + int(place * (len(data) - 12) * 8)  # behind the stamp, which is no input
        data[bit // 8] ^= 1 << bit % 8
        return bytes(data)

    edited = rewrite(log, log.with_name(f"{seed}.mcap"), flip)
    try:
        with pytest.raises(RecordError, match=f"/fsw/input of tick {tick} is damaged"):
            replay(edited)
    finally:
        edited.unlink()


def test_another_bit_of_telemetry_is_found_with_its_signal(log: Path, tmp_path: Path) -> None:
    """Tick, topic, signal, both values and their bits."""

    def edit(topic: str, message: Message) -> bytes | None:
        data = bytearray(message.data)
        if topic == CONTROL and message.sequence == 20:
            data[12 + 8] ^= 1  # the last bit of the second number, behind encapsulation and stamp
        return bytes(data)

    outcome = replay(rewrite(log, tmp_path / "edited.mcap", edit))
    first = outcome.first
    assert first is not None
    assert outcome.differing_ticks == 1
    assert (first.tick, first.where, first.signal) == (20, CONTROL, "tau_cmd_b_nm")
    ones, twos = first.recorded_bits.split(), first.replayed_bits.split()
    assert [int(a, 16) ^ int(b, 16) for a, b in zip(ones, twos, strict=True)] == [0, 1, 0]
    assert "frames 190#" in first.inputs


def test_another_frame_of_the_flight_software_is_found(log: Path, tmp_path: Path) -> None:
    """A command frame that the bus has logged otherwise than it was sent."""

    def edit(topic: str, message: Message) -> bytes | None:
        data = bytearray(message.data)
        if topic == FRAMES and message.sequence == 7:
            data[data.index(b"\x12\x01\x00\x00\x08") + 10] ^= 4  # of wheel 3: its torque
        return bytes(data)

    outcome = replay(rewrite(log, tmp_path / "edited.mcap", edit))
    assert outcome.first is not None
    assert (outcome.first.tick, outcome.first.where) == (7, "frame 0x112")


def test_a_hole_in_the_inputs_is_no_pass(log: Path, tmp_path: Path) -> None:
    """Beyond it nothing can be said, and it says so."""

    def cut(topic: str, message: Message) -> bytes | None:
        return None if topic.startswith("/fsw/") and message.sequence in (11, 12) else bytes(message.data)

    with pytest.raises(RecordError, match="the inputs of ticks 11 to 12 are not in the log; up to there 0 of 11 ticks"):
        replay(rewrite(log, tmp_path / "cut.mcap", cut))


def test_the_verb_says_it_and_exits_with_it(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """0 for the same, 1 for a difference, 3 for what cannot be replayed; a line of JSON each."""

    def edit(topic: str, message: Message) -> bytes | None:
        data = bytearray(message.data)
        if topic == "/fsw/attitude" and message.sequence == 3:
            data[20] ^= 1
        return bytes(data)

    other = rewrite(log, tmp_path / "edited.mcap", edit)
    bare = rewrite(log, tmp_path / "bare.mcap", lambda topic, m: None if topic == INPUT else bytes(m.data))
    assert main(["replay", str(log)]) == 0
    assert f"{log}: 0 differences in 40 ticks" in capsys.readouterr().out
    assert main(["replay", "--json", str(log), str(other)]) == 1
    same, differs = map(json.loads, capsys.readouterr().out.splitlines())
    assert (same["same"], differs["same"], differs["first"]["tick"]) == (True, False, 3)
    assert main(["replay", str(bare)]) == 3
    assert "no cycle of the flight software is in the log" in capsys.readouterr().err


def test_an_input_is_read_back_whole(log: Path) -> None:
    """Tick, counts and frames, as many as the bus has for that tick."""
    with log.open("rb") as file:
        messages = make_reader(file).iter_messages(topics=[INPUT, FRAMES])
        records = {channel.topic: message for _, channel, message in messages if message.sequence == 5}
    given_then = parse_input(5, records[INPUT].data)
    assert (given_then.tick, given_then.slips, given_then.flags, given_then.commands) == (5, 0, 0, ())
    assert given_then.frames in records[FRAMES].data


@pytest.fixture(scope="module")
def long_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of many chunks."""
    overrides = ["duration_s=30", "expect=[]", "faults=[]"]
    return fly(tmp_path_factory.mktemp("replay") / "long.mcap", "zhang2018-flight", overrides)


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7, 0.9])
def test_a_log_that_was_cut_has_no_false_divergence(long_log: Path, tmp_path: Path, share: float) -> None:
    """Up to its last cycle nothing differs, wherever it was cut; the same when it was made whole."""
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(long_log.read_bytes()[: int(long_log.stat().st_size * share)])
    recovered = tmp_path / "recovered.mcap"
    assert main(["recover", str(cut), "-o", str(recovered)]) in (0, 1, 3)
    for path in (cut, recovered):
        outcome = replay(path)
        assert outcome.same, outcome.first
        assert 0 < outcome.ticks < 3000


def test_a_whole_log_without_its_last_cycles_is_no_pass(log: Path, tmp_path: Path) -> None:
    """Frames whose cycles are missing at the end of a log that was closed properly are a divergence, not a torn end."""
    last = read_run(log).ticks(INPUT).max()
    gone = {topic for topic in read_run(log).topics if topic.startswith("/fsw/")}

    def edit(topic: str, message: Message) -> bytes | None:
        return None if topic in gone and message.sequence > last - 3 else message.data

    assert not replay(rewrite(log, tmp_path / "short.mcap", edit)).same
