"""The recorder: merging, flushing, and every way in which a recording ends badly."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

import bus
from bus.errors import RecordError
from bus.telemetry.link import Field, TelemetryLink, TickPacker, Topic, announce_topics, pack_frames
from tools.log.mcap_reader import read_run
from tools.log.recorder import CHUNK_BYTES, Recorder, RunAttachment
from tools.log.recover import recover
from tools.run.recorder_process import main

ROOT = Path(bus.__file__).resolve().parents[1]
PLANT = TickPacker([Topic("/truth/x", "hilsat/TruthX", (Field("tick"), Field("wall_s"), Field("x", "float64", 20)))], 2)
FSW = TickPacker([Topic("/fsw/y", "hilsat/FswY", (Field("tick"),)),
                  Topic("/fsw/timing", "hilsat/Timing", (Field("us"),), deterministic=False)], 101)  # fmt: skip
TICK_NS = 10_000_000


def plant_tick(tick: int) -> bytes:
    t_ns = tick * TICK_NS
    values = PLANT.pack(tick, t_ns, float(tick), time.monotonic(), *[0.1 * tick] * 20)
    return pack_frames(1, tick, t_ns, bytes(16 * 13)) + values


def fsw_tick(tick: int) -> bytes:
    return FSW.pack(tick, tick * TICK_NS, float(tick), time.monotonic())


def make_recorder(path: Path, **options: Any) -> Recorder:
    recorder = Recorder(path, metadata={"run_id": "r1"}, **options)
    recorder.announce(1, announce_topics([PLANT], {1: "bus0"}))
    recorder.announce(2, announce_topics([FSW]))
    return recorder


class RecorderProcess:
    """`python -P -m tools.run.recorder_process` with the two pipes it reads."""

    def __init__(self, directory: Path, prepare: Callable[[], None] | None = None, **meta: Any) -> None:
        self.out = directory / "run.mcap"
        (directory / "meta.json").write_text(json.dumps(meta))
        reads, writes = zip(*(os.pipe() for _ in range(2)), strict=True)
        command = [sys.executable, "-P", "-m", "tools.run.recorder_process", "--out", str(self.out)]
        command += ["--meta", str(directory / "meta.json"), "--source", f"1:{reads[0]}", "--source", f"2:{reads[1]}"]
        self.popen = subprocess.Popen(
            command, pass_fds=reads, stderr=subprocess.PIPE, text=True, preexec_fn=prepare,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
        )  # fmt: skip
        for fd in reads:
            os.close(fd)
        realtime = bool(meta.get("realtime"))
        self.links = [TelemetryLink(fd, source, not realtime) for source, fd in enumerate(writes, 1)]
        self.links[0].announce(announce_topics([PLANT], {1: "bus0"}))
        self.links[1].announce(announce_topics([FSW]))

    def write(self, tick: int) -> None:
        self.links[0].write_tick(tick, tick * TICK_NS, plant_tick(tick))
        self.links[1].write_tick(tick, tick * TICK_NS, fsw_tick(tick))

    def write_out(self, tick: int) -> None:
        """A tick, and everything that the links hold back."""
        self.write(tick)
        for link in self.links:
            link.flush()

    def write_many(self, ticks: int) -> None:
        for tick in range(ticks):
            self.write(tick)

    def finish(self) -> tuple[int, str]:
        for link in self.links:
            link.close("done")
        _, words = self.popen.communicate(timeout=30)
        return self.popen.returncode, words

    def kill(self) -> None:
        for link in self.links:
            link.close()
        if self.popen.poll() is None:
            self.popen.kill()
        self.popen.communicate()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., RecorderProcess]]:
    started: list[RecorderProcess] = []

    def make(**options: Any) -> RecorderProcess:
        started.append(RecorderProcess(tmp_path, **options))
        return started[-1]

    yield make
    for process in started:
        process.kill()


def wait_for(condition: Callable[[], bool]) -> None:
    until = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < until, "it did not happen within 20 s"
        time.sleep(0.02)


# -- the ordinary run ----------------------------------------------------------------------------------------------


def test_two_processes_make_one_complete_file(start: Callable[..., RecorderProcess]) -> None:
    """The library's own reader finds every message; the recorder says nothing and ends with 0."""
    process = start(metadata={"seed": "3"})
    for tick in range(500):
        process.write(tick)
    assert process.finish() == (0, "")
    with open(process.out, "rb") as file:
        topics = [channel.topic for _, channel, _ in make_reader(file, validate_crcs=True).iter_messages()]
    assert {topic: topics.count(topic) for topic in topics} == dict.fromkeys(
        ("/can/bus0", "/truth/x", "/fsw/y", "/fsw/timing"), 500
    )
    assert read_run(process.out).metadata["recording"]["ended_1"] == "done"


def test_file_order_is_tick_then_source_however_they_were_scheduled(tmp_path: Path) -> None:
    """One source far ahead, then the other: the messages still stand tick by tick, plant first, events behind."""
    recorder = make_recorder(tmp_path / "a.mcap")
    plant, fsw = recorder.link(1), recorder.link(2)
    for tick in range(50):
        fsw.event(tick * TICK_NS, "info", "fsw", f"in tick {tick}")
        fsw.write_tick(tick, tick * TICK_NS, fsw_tick(tick))
    for tick in range(50):
        plant.write_tick(tick, tick * TICK_NS, plant_tick(tick))
    recorder.close()
    with open(tmp_path / "a.mcap", "rb") as file:
        got = [
            (channel.topic, message.log_time // TICK_NS)
            for _, channel, message in make_reader(file).iter_messages(log_time_order=False)
        ]
    order = ("/can/bus0", "/truth/x", "/fsw/y", "/fsw/timing", "/events")
    assert got == [(topic, tick) for tick in range(50) for topic in order]


@pytest.mark.parametrize("realtime", [False, True])
def test_real_time_does_not_wait_for_a_silent_source(realtime: bool, tmp_path: Path) -> None:
    """With a clock of our own: lock-step holds the plant's ticks back, real time lets them go within a second."""
    now = 0.0
    recorder = make_recorder(tmp_path / "a.mcap", realtime=realtime, clock=lambda: now)
    plant = recorder.link(1)
    for tick in range(100):
        now = 0.01 * tick
        plant.write_tick(tick, tick * TICK_NS, plant_tick(tick))
    written = read_run(tmp_path / "a.mcap").t_ns("/truth/x")
    assert (len(written) > 0) is realtime
    assert not realtime or now - written[-1] * 1e-9 <= 0.81
    recorder.close()
    assert len(read_run(tmp_path / "a.mcap").t_ns("/truth/x")) == 100


def test_chunks_close_by_size_and_by_time(tmp_path: Path) -> None:
    """No chunk is much larger than the limit, and half a second of wall time closes a small one."""
    now = 0.0
    recorder = make_recorder(tmp_path / "a.mcap", clock=lambda: now)
    plant, fsw = recorder.link(1), recorder.link(2)
    for tick in range(3000):
        plant.write_tick(tick, tick * TICK_NS, plant_tick(tick))
        fsw.write_tick(tick, tick * TICK_NS, fsw_tick(tick))
    flushed = len(read_run(tmp_path / "a.mcap").t_ns("/fsw/y"))
    assert flushed > 2000
    now = 0.6
    plant.write_tick(3000, 0, plant_tick(3000))
    assert len(read_run(tmp_path / "a.mcap").t_ns("/fsw/y")) == 3000
    recorder.close()
    with open(tmp_path / "a.mcap", "rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    sizes = [index.uncompressed_size for index in summary.chunk_indexes]
    assert max(sizes) < 1.1 * CHUNK_BYTES
    assert len(sizes) <= sum(sizes) / CHUNK_BYTES + 3


def test_metadata_and_attachments_come_before_the_first_tick(tmp_path: Path) -> None:
    """They are in the file before anything was recorded, for a run that is killed in its first second."""
    attachment = RunAttachment("scenario.yaml", "application/yaml", b"name: x\n")
    recorder = make_recorder(tmp_path / "a.mcap", attachments=[attachment])
    run = read_run(tmp_path / "a.mcap")
    assert run.metadata["run"] == {"run_id": "r1"}
    assert run.attachments == {"scenario.yaml": b"name: x\n"}
    assert {"/can/bus0", "/truth/x", "/fsw/y", "/events", "/faults"} <= set(run.topics)
    assert not run.complete
    recorder.close()


def test_dropped_ticks_are_in_the_log(start: Callable[..., RecorderProcess]) -> None:
    """A stopped recorder in real time: the writer goes on, and the count of what it dropped is in the file."""
    process = start(realtime=True)
    process.write(0)
    wait_for(lambda: process.out.exists() and process.out.stat().st_size > 0)
    process.popen.send_signal(signal.SIGSTOP)
    for tick in range(1, 20_000):
        process.write(tick)
    dropped = process.links[0].dropped
    assert dropped > 0
    process.popen.send_signal(signal.SIGCONT)
    assert process.finish() == (0, "")
    run = read_run(process.out)
    assert run.metadata["recording"]["dropped_ticks_1"] == str(dropped)
    assert len(run.t_ns("/truth/x")) == 20_000 - dropped


# -- the ways it ends badly ----------------------------------------------------------------------------------------


def test_a_killed_recorder_loses_less_than_a_second(start: Callable[..., RecorderProcess], tmp_path: Path) -> None:
    """SIGKILL after two seconds of wall time: the writers are told who died, and the recovered file, read with the
    library's reader, ends less than 1 s of wall time before the kill."""
    process = start()
    begun = time.monotonic()
    tick = 0
    while time.monotonic() < begun + 2.0:
        process.write(tick)
        tick += 1
        time.sleep(0.002)
    process.popen.kill()
    killed = time.monotonic()
    process.popen.wait()
    with pytest.raises(RecordError, match="the recorder died"):
        process.write_out(tick)
    found = recover(process.out, tmp_path / "whole.mcap")
    assert not found.complete
    assert found.messages > 1000
    with open(tmp_path / "whole.mcap", "rb") as file:
        messages = sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())
    assert messages == found.messages
    assert killed - read_run(tmp_path / "whole.mcap").signals("/truth/x")["wall_s"][-1] < 1.0


def test_a_killed_writer_is_named_in_the_log(start: Callable[..., RecorderProcess]) -> None:
    """A pipe that closes without a goodbye ends the waiting for that source and leaves a line on /events."""
    process = start()
    for tick in range(20):
        process.write_out(tick)
    os.close(process.links[1]._fd)  # type: ignore[arg-type]
    process.links[1]._fd = None
    for tick in range(20, 40):
        process.links[0].write_tick(tick, tick * TICK_NS, plant_tick(tick))
    assert process.finish() == (0, "")
    run = read_run(process.out)
    assert len(run.t_ns("/truth/x")) == 40
    assert [event["message"] for event in run.events] == ["the flight software ended without closing its telemetry"]


def test_the_first_signal_leaves_the_file_to_the_others_and_the_second_closes_it(
    start: Callable[..., RecorderProcess],
) -> None:
    """After one SIGTERM ticks are still recorded; after two the file is complete though the pipes are open."""
    process = start()
    process.write(0)
    wait_for(lambda: process.out.exists() and "/fsw/y" in read_run(process.out).topics)
    process.popen.send_signal(signal.SIGTERM)
    time.sleep(0.6)
    process.write(1)
    wait_for(lambda: len(read_run(process.out).t_ns("/fsw/y")) == 2)
    assert process.popen.poll() is None
    process.popen.send_signal(signal.SIGTERM)
    assert process.popen.wait(10) == 0
    assert read_run(process.out).complete


def test_a_full_disk_is_said_and_the_rest_is_readable(start: Callable[..., RecorderProcess], tmp_path: Path) -> None:
    """A file size limit in the recorder's process: exit code 3, the reason in words, and a readable log."""
    limit = 400_000
    process = start(prepare=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)))
    with pytest.raises(RecordError, match="the recorder died"):
        process.write_many(200_000)
    _, words = process.popen.communicate(timeout=30)
    assert process.popen.returncode == 3
    assert "cannot write the log: File too large" in words
    assert "free some space" in words
    assert process.out.stat().st_size <= limit
    run = read_run(process.out)
    assert len(run.t_ns("/truth/x")) > 100
    recover(process.out, tmp_path / "whole.mcap")


def test_a_full_disk_in_process_is_said_once_and_again(tmp_path: Path) -> None:
    """/dev/full, where the first write fails: the constructor says so in words."""
    with pytest.raises(RecordError, match="/dev/full: cannot write the log: No space left on device"):
        make_recorder(Path("/dev/full"))


def test_after_a_failed_write_every_tick_fails_and_closing_does_not(tmp_path: Path) -> None:
    """The runner closes the recorder in a `finally`: that must not hide the first error."""
    recorder = make_recorder(tmp_path / "a.mcap")
    link = recorder.link(1)
    stray = TickPacker([Topic("/stray", "hilsat/Stray", (Field("a"),))], 55).pack(0, 0, 1.0)
    link.write_tick(0, 0, stray)
    link.close()
    recorder.link(2).close()
    for _ in range(2):
        with pytest.raises(RecordError, match=r"channels \[55\], which no process announced"):
            recorder.flush()
    assert recorder.close().messages == 0
    assert read_run(tmp_path / "a.mcap").complete


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--out", "/nowhere/x.mcap"], "/nowhere/x.mcap: cannot write the log: No such file or directory"),
        (["--meta", "/nowhere/meta.json"], "/nowhere/meta.json: cannot be read"),
        (["--source", "plant"], '"plant" is not N:FD'),
    ],
)
def test_wrong_words_are_answered(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2 or 3 and the reason, for a directory, a file and a source that are not there."""
    (tmp_path / "meta.json").write_text("{}")
    base = ["--out", str(tmp_path / "a.mcap"), "--meta", str(tmp_path / "meta.json"), "--source", "1:0"]
    assert main(base + arguments) in (2, 3)
    assert words in capsys.readouterr().err


def test_garbage_on_a_pipe_is_refused(start: Callable[..., RecorderProcess]) -> None:
    """Bytes that are no telemetry end the recording in words, not in a file full of them."""
    process = start()
    process.write(0)
    os.write(process.links[0]._fd, b"hello, this is not telemetry at all")  # type: ignore[arg-type]
    _, words = process.popen.communicate(timeout=30)
    assert process.popen.returncode == 3
    assert "plant: what comes through its pipe is not telemetry" in words
    assert read_run(process.out).metadata["run"] == {}
