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
from subprocess import PIPE

import pytest

from bus.errors import RecordError, StepSizeError
from tools.config.loader import load_scenario
from tools.config.scenario_files import find_scenario
from tools.log.mcap_reader import read_run
from tools.log.mcap_writer import McapWriter
from tools.run import children, runner
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


@contextlib.contextmanager
def start_run(place: Path, clock: str, *, logged_bytes: int) -> Iterator[LiveRun]:
    """A long run on that clock that has logged so much telemetry."""
    log = place / "run" / "run.mcap"
    command = [sys.executable, "-P", "-m", "tools.cli", "run", "zhang2018", "--clock", clock, "--out", str(log.parent)]
    environment = {**os.environ, "TMPDIR": str(place)}
    popen = subprocess.Popen([*command, *LONG], stdout=PIPE, stderr=PIPE, text=True, env=environment)
    try:
        until = time.monotonic() + 30
        while time.monotonic() < until and not (log.exists() and log.stat().st_size > logged_bytes):
            time.sleep(0.05)
            assert popen.poll() is None, popen.communicate()
        yield LiveRun(popen, log)
    finally:
        popen.kill()
        popen.wait()


@pytest.fixture
def live_run(tmp_path: Path) -> Iterator[LiveRun]:
    """A long lock-step run that has logged at least one second of telemetry."""
    with start_run(tmp_path, "lockstep", logged_bytes=200_000) as live:
        yield live


WORDS = {"plant": "plant", "fsw": "flight software", "recorder": "recorder"}
FATES = {
    signal.SIGKILL: "was killed by SIGKILL",
    signal.SIGSTOP: "was stopped (SIGSTOP)",
    40: "was killed by signal 40",
}
ALL = [(clock, victim, number) for clock in ("lockstep", "realtime") for victim in WORDS for number in FATES]
QUICK = [("lockstep", "fsw", signal.SIGSTOP), ("realtime", "fsw", signal.SIGKILL)]


@pytest.mark.parametrize(
    ("clock", "victim", "number"),
    [case if case in QUICK else pytest.param(*case, marks=pytest.mark.slow) for case in ALL],
)
def test_who_is_killed_or_stopped_is_named_first_within_five_seconds(
    clock: str, victim: str, number: int, tmp_path: Path
) -> None:
    """From the signal to the end of the command 5 s at most: exit code 3, the victim in the first message and nobody who
    is well in any, a log that reads back, no process and nothing in the temporary directory left."""
    with start_run(tmp_path, clock, logged_bytes=200_000 if clock == "lockstep" else 90_000) as live_run:
        pids = [live_run.child(name) for name in MODULES]
        os.kill(live_run.child(victim), number)
        code, result, err, took_s = live_run.finish()
    assert code == 3
    assert err.startswith(f"hilsat run: {WORDS[victim]} {FATES[signal.Signals(number) if number < 32 else number]}"), (
        err
    )
    assert "still running" not in err
    assert took_s < 5.0
    assert result["exit_code"] == 3
    assert not [pid for pid in pids if Path(f"/proc/{pid}").exists()]
    assert list(tmp_path.iterdir()) == [live_run.log.parent]
    assert read_run(live_run.log).t_ns("/truth/attitude").size > 0


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        (signal.SIGINT, 130),
        pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow),
        pytest.param(signal.SIGHUP, 129, marks=pytest.mark.slow),
    ],
)
def test_an_interrupted_run_closes_its_log(live_run: LiveRun, number: int, expected: int, tmp_path: Path) -> None:
    """Ctrl-C, SIGTERM and a terminal that goes away: the conventional exit code, a grade of what was flown, a finished
    file, no process left, nothing of ours beside the log or in the temporary directory."""
    children = [live_run.child(name) for name in MODULES]
    live_run.popen.send_signal(number)
    code, result, err, _ = live_run.finish()
    assert code == expected
    assert "interrupted" in err
    assert result["grade"] is not None
    assert [path.name for path in live_run.log.parent.iterdir()] == ["run.mcap"]
    assert list(tmp_path.iterdir()) == [live_run.log.parent]
    assert live_run.log.read_bytes().endswith(b"\x89MCAP0\r\n")
    assert not [pid for pid in children if Path(f"/proc/{pid}").exists()]


@pytest.mark.slow
def test_more_signals_do_not_disturb_the_end(live_run: LiveRun) -> None:
    """`timeout` and impatient people send several: still the code of the first, a finished file and no traceback."""
    for number in (signal.SIGTERM, signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        live_run.popen.send_signal(number)
        time.sleep(0.05)
    code, _, err, _ = live_run.finish()
    assert code == 143
    assert "Traceback" not in err
    assert live_run.log.read_bytes().endswith(b"\x89MCAP0\r\n")


@pytest.mark.slow
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

    def start(name: str, *args: object, **options: object) -> children.Process:
        if name == victim:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN), sys.executable)
        started.append(children.start(name, *args, **options))  # type: ignore[arg-type]
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
