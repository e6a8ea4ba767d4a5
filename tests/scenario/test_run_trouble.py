"""Trouble in the middle of a run: every death is named, ends with the right exit code, and leaves a readable log."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from bus.errors import RecordError, StepSizeError
from tools.config.loader import load_scenario
from tools.config.scenario_files import find_scenario
from tools.log.mcap_reader import read_run
from tools.log.mcap_writer import McapWriter
from tools.run import processes, runner
from tools.run.in_process import run_in_process

LONG = ["--set", "duration_s=3000", "--set", "expect=[]", "--no-plot", "--json", "-q"]
MODULES = {"plant": "plant_server", "fsw": "fsw", "recorder": "tools.run.recorder_process"}


@dataclass
class LiveRun:
    """A `hilsat run` in progress."""

    popen: subprocess.Popen[str]
    log: Path

    def child(self, name: str) -> int:
        """Process id of one of its children."""
        for entry in Path("/proc").glob("[0-9]*"):
            try:
                parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
                words = (entry / "cmdline").read_bytes().split(b"\0")
            except (OSError, IndexError):
                continue
            if parent == self.popen.pid and MODULES[name].encode() in words:
                return int(entry.name)
        raise AssertionError(f"{name} is not running")

    def finish(self) -> tuple[int, dict[str, object], str, float]:
        """Exit code, JSON on stdout, stderr, and how long the end took [s]."""
        started = time.monotonic()
        out, err = self.popen.communicate(timeout=60)
        return self.popen.returncode, json.loads(out), err, time.monotonic() - started


@pytest.fixture
def live_run(tmp_path: Path) -> Iterator[LiveRun]:
    """A long lock-step run that has logged at least one second of telemetry."""
    log = tmp_path / "run" / "run.mcap"
    command = [sys.executable, "-P", "-m", "tools.cli", "run", "zhang2018", "--out", str(log.parent), *LONG]
    popen = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 30
    while time.monotonic() < until and not (log.exists() and log.stat().st_size > 200_000):
        time.sleep(0.05)
        assert popen.poll() is None, popen.communicate()
    yield LiveRun(popen, log)
    popen.kill()
    popen.wait()


@pytest.mark.parametrize(("victim", "word"), [("plant", "plant"), ("fsw", "flight software"), ("recorder", "recorder")])
def test_a_killed_process_is_named_within_five_seconds(live_run: LiveRun, victim: str, word: str) -> None:
    """kill -9 of each process: exit code 3, its name in the first message, a log that reads back."""
    os.kill(live_run.child(victim), signal.SIGKILL)
    code, result, err, took_s = live_run.finish()
    assert code == 3
    assert word in err
    assert "SIGKILL" in err
    assert took_s < 20.0
    run = read_run(live_run.log)
    assert run.t_ns("/truth/attitude").size > 100
    assert result["exit_code"] == 3


def test_a_hanging_process_is_named(live_run: LiveRun) -> None:
    """SIGSTOP of the flight software: the plant gives up on it by name; nothing is left running."""
    victim = live_run.child("fsw")
    os.kill(victim, signal.SIGSTOP)
    code, _, err, _ = live_run.finish()
    assert code == 3
    assert "flight software has not ended its cycle" in err
    assert not Path(f"/proc/{victim}").exists()


@pytest.mark.parametrize(("number", "expected"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupted_run_closes_its_log(live_run: LiveRun, number: int, expected: int) -> None:
    """Ctrl-C and SIGTERM: the conventional exit code, a finished file, no process left."""
    children = [live_run.child(name) for name in MODULES]
    live_run.popen.send_signal(number)
    code, _, err, _ = live_run.finish()
    assert code == expected
    assert "interrupted" in err
    assert live_run.log.read_bytes().endswith(b"\x89MCAP0\r\n")
    assert not [pid for pid in children if Path(f"/proc/{pid}").exists()]


def test_a_killed_runner_leaves_no_process_behind(live_run: LiveRun) -> None:
    """kill -9 of the runner itself: plant and flight software are told, and the recorder finishes the file."""
    children = [live_run.child(name) for name in MODULES]
    live_run.popen.kill()
    live_run.popen.wait()
    until = time.monotonic() + 10
    while time.monotonic() < until and any(Path(f"/proc/{pid}").exists() for pid in children):
        time.sleep(0.05)
    assert not [pid for pid in children if Path(f"/proc/{pid}").exists()]
    assert live_run.log.read_bytes().endswith(b"\x89MCAP0\r\n")


@pytest.mark.parametrize("victim", ["plant", "flight software"])
def test_a_process_that_cannot_be_started_ends_the_run(
    victim: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The system has no more processes: exit code 3 and its words; what had started has ended, nothing is left open."""
    started = []

    def start(name: str, *args: object, **options: object) -> processes.Process:
        if name == victim:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN), sys.executable)
        started.append(processes.start(name, *args, **options))  # type: ignore[arg-type]
        return started[-1]

    monkeypatch.setattr(runner, "start", start)
    descriptors = len(os.listdir("/proc/self/fd"))
    report = runner.run_processes(load_scenario(find_scenario("zhang2018"), []), tmp_path, lambda tick: None)
    assert report.exit_code == 3
    assert "cannot start the run: [Errno 11] Resource temporarily unavailable" in report.problems[0]
    assert started
    assert all(process.code is not None for process in started)
    assert len(os.listdir("/proc/self/fd")) == descriptors


def test_what_fails_once_the_run_has_begun_is_not_called_a_failed_start(tmp_path: Path) -> None:
    """Whoever reads the progress has gone: the caller gets that error itself, no process is left, the log is whole."""
    resolved = load_scenario(find_scenario("zhang2018"), ["duration_s=3000", "expect=[]"])

    def show(tick: int) -> None:
        raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))

    descriptors = len(os.listdir("/proc/self/fd"))
    with pytest.raises(BrokenPipeError):
        runner.run_processes(resolved, tmp_path, show)
    assert len(os.listdir("/proc/self/fd")) == descriptors
    assert read_run(tmp_path / "run.mcap").complete


@pytest.mark.parametrize(("error", "reason"), [(KeyboardInterrupt(), "interrupted"), (StepSizeError("no"), "failed")])
def test_the_ticks_before_an_end_in_process_are_in_the_log(error: BaseException, reason: str, tmp_path: Path) -> None:
    """Ctrl-C, or an algorithm that gives up, at tick 100: the log is whole and ends with that tick, on both sides."""

    def end(tick: int) -> None:
        if tick == 100:
            raise error

    resolved = load_scenario(find_scenario("zhang2018"), ["clock.mode=inprocess"])
    with contextlib.nullcontext() if reason == "interrupted" else pytest.raises(StepSizeError):
        assert run_in_process(resolved, tmp_path, end).exit_code == 130
    run = read_run(tmp_path / "run.mcap")
    assert run.complete
    assert [len(run.t_ns(topic)) for topic in ("/can/bus0", "/truth/wheels", "/fsw/attitude")] == [101, 101, 101]
    assert run.metadata["recording"]["ended_1"] == reason


def test_a_disk_that_is_full_at_the_last_write_fails_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is left to write but what the links hold back: the run does not pass without it."""

    def write_chunk(writer: McapWriter, parts: list[bytes]) -> None:
        raise RecordError("no space left")

    monkeypatch.setattr(McapWriter, "write_chunk", write_chunk)
    resolved = load_scenario(
        find_scenario("zhang2018"), ["clock.mode=inprocess", "duration_s=1", "expect=[]", "faults=[]"]
    )
    with pytest.raises(RecordError, match="no space left"):
        run_in_process(resolved, tmp_path, lambda tick: None)
