"""Runs a scenario end to end: recorder, plant and flight software as processes, watched until the last tick.

Whatever happens, the run ends in words: who failed, how, and where the log is. Exit codes: 0 ended, 3 infrastructure,
130 and 143 interrupted. Grading is somebody else's business (tools/grading).
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bus.errors import RecordError
from bus.process import Interrupted, name_signal, raise_signals
from tools.config.scenario import Resolved
from tools.ground.launch import GatewayPlan, end_gateway
from tools.run.children import Process, make_pipe, memory_mb, share_processor, start, stop
from tools.run.directory import LOG, keep_words
from tools.run.provenance import describe_run, list_attachments
from tools.run.run_file import PREFIX, RunFile, describe_bench, ground_of, write_run_file
from tools.run.watch import LOST, RECORDER_PATIENCE_S, START_S, STILL_S, Failure, Watch

POLL_S = 0.1
END_POLL_S = 0.005


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
    notes: list[str] = field(default_factory=list)  # what went wrong beside the run and did not end it, in words


def run_processes(
    resolved: Resolved, out_dir: Path, on_progress: Callable[[int], None], gateway: GatewayPlan | None = None
) -> RunReport:
    """Run the scenario in three processes and return how it ended. Raises RecordError without a temporary directory.

    gateway : the links to ground stations, another process; None: no gateway
    """
    out_dir.mkdir(parents=True, exist_ok=True)
    with raise_signals(), make_private() as private:
        address = resolved.scenario.bus.address
        if address == "hub:":
            address = f"hub:{private / 'bus'}"
        bench = describe_bench(resolved, private, address=address, out=out_dir, linked=gateway is not None)
        return Supervisor(resolved, out_dir, private, bench, on_progress, gateway).run()


@contextlib.contextmanager
def make_private() -> Iterator[Path]:
    """Yield a temporary directory that only this user can enter. Raises RecordError when there is no place for one."""
    try:
        place = tempfile.TemporaryDirectory(prefix=PREFIX, ignore_cleanup_errors=True)
    except OSError as error:
        raise RecordError(
            f"cannot make a temporary directory: {error.strerror}; set TMPDIR to a directory that can be written"
        ) from None
    with place as name:
        yield Path(name)


class Supervisor:
    """Starts the processes of one run and sees them to their end."""

    def __init__(
        self,
        resolved: Resolved,
        out_dir: Path,
        private: Path,
        bench: RunFile,
        on_progress: Callable[[int], None],
        gateway: GatewayPlan | None = None,
    ) -> None:
        """private: directory for what the processes are told and say; out_dir: for the log, and what a failed one said."""
        self._resolved = resolved
        self._out = out_dir
        self._private = private
        self._bench = bench
        self._plan = gateway
        self._on_progress = on_progress
        self._report = RunReport(out_dir / LOG, 3)
        self._started_s = time.monotonic()
        self._last_progress_s = self._started_s
        self._has_spoken = False  # the plant is up
        self._buffer = b""
        self._sides: list[Process] = []  # plant, then flight software
        self._recorders: list[Process] = []  # one, once it has started
        self._gateway: Process | None = None

    def run(self) -> RunReport:
        """Start them, watch them, end them."""
        progress_in, progress_out = make_pipe()
        try:
            if self._try_start(progress_out):
                self._watch(progress_in)
        except Interrupted as interruption:
            self._report.exit_code = 128 + interruption.number
            self._report.problems.append(
                f"interrupted by {name_signal(interruption.number)}; the log is closed properly"
            )
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
        private = self._private
        plant_file, fsw_file, meta_file = self._write_files()
        traces = self._out.absolute()
        try:
            self._recorders.append(start(
                "recorder", "tools.run.recorder_process",
                ["--out", str(self._report.log), "--meta", str(meta_file), "--source", f"1:{plant_in}",
                 "--source", f"2:{fsw_in}"],
                [plant_in, fsw_in], private / "recorder.err", traces=traces, orphan=True,
            ))  # fmt: skip
            self._sides.append(start(
                "plant", "plant_server",
                ["--config", str(plant_file), "--telemetry-fd", str(plant_out), "--progress-fd", str(progress_out)],
                [plant_out, progress_out], private / "plant.err", traces=traces,
            ))  # fmt: skip
            self._sides.append(start(
                "flight software", "fsw",
                ["--config", str(fsw_file), "--telemetry-fd", str(fsw_out), "--progress-fd", str(progress_out)],
                [fsw_out, progress_out], private / "fsw.err", traces=traces,
            ))  # fmt: skip
        finally:
            for fd in (plant_in, plant_out, fsw_in, fsw_out):
                os.close(fd)
        if self._resolved.scenario.clock.mode == "lockstep":
            share_processor(*self._sides)
        if self._plan is not None:
            self._gateway = self._plan.start(private, self._bench)

    def _write_files(self) -> tuple[Path, Path, Path]:
        """Write what plant, flight software and recorder are told, and what the bench says of itself."""
        bench, resolved = self._bench, self._resolved
        plant_file, fsw_file, meta_file = (self._private / name for name in ("plant.json", "fsw.json", "meta.json"))
        plant_file.write_text(resolved.plant_json(bench.bus, ground_of(bench, bench.plant)), encoding="utf-8")
        fsw_file.write_text(resolved.fsw_json(bench.bus, ground_of(bench, bench.fsw)), encoding="utf-8")
        meta_file.write_text(json.dumps(describe(resolved, bench.bus)), encoding="utf-8")
        write_run_file(self._private, bench)
        return plant_file, fsw_file, meta_file

    # -- watching --------------------------------------------------------------------------------------------------

    def _watch(self, progress_in: int) -> None:
        """Return when all have ended, or shortly after the first has failed."""
        watch = Watch(self._sides, self._recorders)
        while True:
            codes = [process.code for process in (*self._sides, *self._recorders)]
            self._read_progress(progress_in)  # after the codes: who has ended has said before what there was to say
            now_s = time.monotonic()
            finished = "running_s" in self._report.details
            if watch.look(now_s, finished, codes):
                break
            patience_s = STILL_S if self._has_spoken else START_S
            if not finished and now_s - self._last_progress_s > patience_s:
                self._report.problems.append(
                    f"the plant has not moved for {patience_s:g} s at about tick {self._report.ticks}: it hangs, or waits "
                    "for the recorder"
                )
                break
        self._judge(watch)

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
            self._has_spoken = True
            if what.get("state") == "running":
                self._report.first_cycle_s = self._last_progress_s - self._started_s
            if "tick" in what:
                self._report.ticks = what["tick"]
                self._on_progress(what["tick"])
                self._report.memory_mb = {p.name: memory_mb(p) for p in (*self._sides, *self._recorders)}
            else:
                self._report.details |= what

    def _judge(self, watch: Watch) -> None:
        """Say who failed, the culprit first."""
        report = self._report
        said_errors = {"plant": "plant_error", "flight software": "fsw_error"}
        failures = watch.list_failures({name: report.details.get(key, "") for name, key in said_errors.items()})
        if not failures and not report.problems:
            report.exit_code = 0
            report.ticks = self._resolved.ticks
            return
        said: set[str] = set()  # without the name ahead of it: what both sides say is said once
        for failure in failures:
            words = failure.process.words()
            if not words or failure.how == LOST:
                report.problems.append(f"{failure.fate} at about tick {report.ticks}")
            elif words.partition(": ")[2] not in said:
                said.add(words.partition(": ")[2])
                report.problems.append(words)
        report.exit_code = _choose_code(failures)

    def _end(self) -> None:
        """First the two sides, so that the recorder sees its pipes close and finishes the file.

        A recorder that is held goes on before that: the sides may wait for room in its pipes, with something to say.
        """
        for recorder in self._recorders:
            recorder.resume()
        stop(self._sides)
        if self._gateway is not None:
            self._report.notes += end_gateway(self._gateway)
        for recorder in self._recorders:
            with contextlib.suppress(subprocess.TimeoutExpired):
                recorder.popen.wait(RECORDER_PATIENCE_S)
        stop(self._recorders)
        for process in (*self._sides, *self._recorders):
            name = process.stderr_path.stem
            if self._report.exit_code and (words := process.words()):
                keep_words(self._out, name, words.encode(errors="surrogateescape"))


def _choose_code(failures: list[Failure]) -> int:
    """2 when the culprit could not be started as it was asked for, else 3."""
    return 2 if failures and failures[0].process.code == 2 else 3


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
