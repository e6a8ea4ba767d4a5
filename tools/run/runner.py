"""Runs a scenario end to end: recorder, plant and flight software as processes, watched until the last tick.

Whatever happens, the run ends in words: who failed, how, and where the log is. Exit codes: 0 ended, 3 infrastructure,
130 and 143 interrupted. Grading is somebody else's business (tools/grading).
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from tools.config.scenario import Resolved
from tools.run.processes import Process, make_pipe, memory_mb, share_processor, start, stop
from tools.run.provenance import describe_run, list_attachments

POLL_S = 0.1
END_POLL_S = 0.005
GRACE_S = 6.0  # after one process ended, how long the others may take to notice by themselves
RECORDER_PATIENCE_S = 10.0  # how long the recorder may take to finish the file once both sides have ended
STILL_S = 12.0  # without progress, everything is taken to hang


@dataclass(slots=True)
class RunReport:
    """How a run ended."""

    log: Path
    exit_code: int
    problems: list[str] = field(default_factory=list)  # what went wrong, in words, most telling first
    ticks: int = 0
    wall_s: float = 0.0
    first_cycle_s: float | None = None  # wall time from the start of the run to its first tick
    memory_mb: dict[str, float] = field(default_factory=dict)  # peak, per process
    details: dict[str, Any] = field(default_factory=dict)  # what the plant reported of itself


class Interrupted(Exception):
    """SIGINT or SIGTERM arrived at the runner; carries the number."""


def run_processes(resolved: Resolved, out_dir: Path, on_progress: Callable[[int], None]) -> RunReport:
    """Run the scenario in three processes and return how it ended."""
    out_dir.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as stack:
        address = resolved.scenario.bus.address
        if address == "hub:":
            address = "hub:" + stack.enter_context(tempfile.TemporaryDirectory(prefix="hilsat-"))
        stack.enter_context(_signals_raise())
        return _Supervisor(resolved, out_dir, address, on_progress).run()


@contextlib.contextmanager
def _signals_raise() -> Iterator[None]:
    def raise_interrupted(number: int, frame: FrameType | None) -> None:
        raise Interrupted(number)

    previous = {number: signal.signal(number, raise_interrupted) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


class _Supervisor:
    """Starts the processes of one run and sees them to their end."""

    def __init__(self, resolved: Resolved, out_dir: Path, address: str, on_progress: Callable[[int], None]) -> None:
        self._resolved = resolved
        self._out = out_dir
        self._address = address
        self._on_progress = on_progress
        self._report = RunReport(out_dir / "run.mcap", 3)
        self._started_s = time.monotonic()
        self._last_progress_s = self._started_s
        self._buffer = b""
        self._sides: list[Process] = []  # plant, then flight software
        self._recorders: list[Process] = []  # one, once it has started

    def run(self) -> RunReport:
        progress_in, progress_out = make_pipe()
        try:
            if self._try_start(progress_out):
                self._watch(progress_in)
        except Interrupted as interruption:
            number = int(interruption.args[0])
            self._report.exit_code = 128 + number
            self._report.problems.append(f"interrupted by {signal.Signals(number).name}; the log is closed properly")
        finally:
            self._end()
            self._read_progress(progress_in)  # the last words of the two sides
            os.close(progress_in)
        self._report.wall_s = time.monotonic() - self._started_s
        return self._report

    # -- starting --------------------------------------------------------------------------------------------------

    def _try_start(self, progress_out: int) -> bool:
        """Start the three; False when the system has no process, no descriptor or no room on the disk for one of them."""
        try:
            self._start(progress_out)
        except OSError as error:
            self._report.problems.append(f"cannot start the run: {error}; free some of it and start again")
            return False
        finally:
            os.close(progress_out)
        return True

    def _start(self, progress_out: int) -> None:
        plant_in, plant_out = make_pipe()
        fsw_in, fsw_out = make_pipe()
        plant_file, fsw_file, meta_file = (self._out / name for name in ("plant.json", "fsw.json", "meta.json"))
        plant_file.write_text(self._resolved.plant_json(self._address))
        fsw_file.write_text(self._resolved.fsw_json(self._address))
        meta_file.write_text(json.dumps(describe(self._resolved, self._address)))
        out = self._out
        try:
            self._recorders.append(start(
                "recorder", "tools.run.recorder_process",
                ["--out", str(self._report.log), "--meta", str(meta_file), "--source", f"1:{plant_in}",
                 "--source", f"2:{fsw_in}"],
                [plant_in, fsw_in], out / "recorder.err", orphan=True,
            ))  # fmt: skip
            self._sides.append(start(
                "plant", "plant_server",
                ["--config", str(plant_file), "--telemetry-fd", str(plant_out), "--progress-fd", str(progress_out)],
                [plant_out, progress_out], out / "plant.err",
            ))  # fmt: skip
            self._sides.append(start(
                "flight software", "fsw",
                ["--config", str(fsw_file), "--telemetry-fd", str(fsw_out), "--progress-fd", str(progress_out)],
                [fsw_out, progress_out], out / "fsw.err",
            ))  # fmt: skip
        finally:
            for fd in (plant_in, plant_out, fsw_in, fsw_out):
                os.close(fd)
        if self._resolved.scenario.clock.mode == "lockstep":
            share_processor(*self._sides)

    # -- watching --------------------------------------------------------------------------------------------------

    def _watch(self, progress_in: int) -> None:
        plant = self._sides[0]
        processes = [*self._sides, *self._recorders]
        ended_s: float | None = None
        while any(process.code is None for process in processes):
            self._read_progress(progress_in)
            now_s = time.monotonic()
            bad = [process for process in processes if process.code not in (None, 0)]
            if bad or plant.code == 0:
                ended_s = ended_s or now_s
                if now_s - ended_s > GRACE_S:
                    break
            elif now_s - self._last_progress_s > STILL_S:
                self._report.problems.append(f"nothing moved for {STILL_S:g} s at tick {self._report.ticks}")
                break
        self._judge()

    def _read_progress(self, fd: int) -> None:
        if not select.select([fd], [], [], POLL_S)[0]:
            return
        data = os.read(fd, 65536)
        if not data:  # the plant has closed its end: nothing more to wait for here
            time.sleep(END_POLL_S)
        self._buffer += data
        *lines, self._buffer = self._buffer.split(b"\n")
        for line in lines:
            what = json.loads(line)
            self._last_progress_s = time.monotonic()
            if what.get("state") == "running":
                self._report.first_cycle_s = self._last_progress_s - self._started_s
            if "tick" in what:
                self._report.ticks = what["tick"]
                self._on_progress(what["tick"])
                self._report.memory_mb = {p.name: memory_mb(p) for p in (*self._sides, *self._recorders)}
            else:
                self._report.details |= what

    def _judge(self) -> None:
        """Say who failed, the most telling first: who was killed or hangs, then the recorder, whose end ends the others."""
        report = self._report
        bad = [process for process in (*self._recorders, *self._sides) if process.code != 0]
        if not bad:
            report.exit_code = 0
            report.ticks = self._resolved.ticks
            return
        bad.sort(key=lambda process: (process.code is not None, process.code if process.code is not None else 0))
        said: set[str] = set()  # without the name ahead of it: what both sides say is said once
        for process in bad:
            words = process.words()
            if not words or (process.code is not None and process.code < 0):
                report.problems.append(f"{process.fate()} at about tick {report.ticks}")
            elif words.partition(": ")[2] not in said:
                said.add(words.partition(": ")[2])
                report.problems.append(words)
        report.exit_code = 2 if any(process.code == 2 for process in bad) else 3

    def _end(self) -> None:
        """First the two sides, so that the recorder sees its pipes close and finishes the file."""
        stop(self._sides)
        for recorder in self._recorders:
            with contextlib.suppress(subprocess.TimeoutExpired):
                recorder.popen.wait(RECORDER_PATIENCE_S)
        stop(self._recorders)
        for name in ("plant", "fsw", "recorder"):
            path = self._out / f"{name}.err"
            if path.exists() and not path.stat().st_size:
                path.unlink()
        for name in ("plant.json", "fsw.json", "meta.json"):
            (self._out / name).unlink(missing_ok=True)


def describe(resolved: Resolved, address: str) -> dict[str, Any]:
    """What the recorder is told: metadata and attachments of the log."""
    return {
        "metadata": describe_run(resolved, address),
        "attachments": [
            {"name": a.name, "media_type": a.media_type, "text": a.data.decode()} for a in list_attachments(resolved)
        ],
        "realtime": resolved.scenario.clock.mode == "realtime",
    }


def print_progress(ticks: int) -> Callable[[int], None]:
    """A progress printer for stderr: a moving line on a terminal, ten lines elsewhere."""
    terminal = sys.stderr.isatty() and not os.environ.get("NO_COLOR")
    last = -1

    def show(tick: int) -> None:
        nonlocal last
        percent = 100 * tick // max(1, ticks)
        if terminal:
            print(f"\r  {percent:3d} %  tick {tick} of {ticks}", end="", file=sys.stderr, flush=True)
        elif percent // 10 > last // 10:
            print(f"  {percent:3d} %  tick {tick} of {ticks}", file=sys.stderr, flush=True)
        last = percent

    return show
