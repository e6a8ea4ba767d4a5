"""The processes of a run: started with what they inherit, watched, and ended without leaving anything behind."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bus.process import name_signal
from bus.trace import PLACE

PR_SET_PDEATHSIG = 1
TERM_PATIENCE_S = 3.0  # between asking a process to end and ending it
_LIBC = ctypes.CDLL(None, use_errno=True)


def end_with_parent() -> None:
    """In the child: be told to end when the process that started us is killed."""
    _LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


@dataclass(slots=True)
class Process:
    """One child process: its name for messages, and where its words went."""

    name: str
    popen: subprocess.Popen[bytes]
    stderr_path: Path

    @property
    def code(self) -> int | None:
        """Exit code once it has ended; minus the signal's number when a signal ended it."""
        return self.popen.poll()

    @property
    def stopped(self) -> bool:
        """Whether a signal holds it (SIGSTOP), or a debugger."""
        return self.code is None and _read_state(self.popen.pid) in ("T", "t")

    def words(self) -> str:
        """What it wrote on stderr."""
        try:
            return self.stderr_path.read_text(errors="replace").strip()
        except OSError:
            return ""

    def resume(self) -> None:
        """Let it go on if a signal holds it."""
        if self.code is None:
            self.popen.send_signal(signal.SIGCONT)

    def fate(self) -> str:
        """How it ended, in words."""
        code = self.code
        if code is None:
            return f"{self.name} {'was stopped (SIGSTOP)' if self.stopped else 'is still running'}"
        if code < 0:
            return f"{self.name} was killed by {name_signal(-code)}"
        return f"{self.name} ended with exit code {code}"


def start(
    name: str,
    module: str,
    arguments: Sequence[str],
    fds: Sequence[int],
    stderr_path: Path,
    *,
    traces: Path | None = None,
    orphan: bool = False,
) -> Process:
    """Start `python -P -m module` in a session of its own, so that Ctrl-C reaches only the runner.

    fds    : descriptors it inherits
    traces : directory for the traceback of what it did not foresee; None: as it is for this process
    orphan : it outlives a killed runner (the recorder: it ends when its pipes close)
    """
    environment = None if traces is None else {PLACE: str(traces)} | os.environ
    with open(stderr_path, "xb") as stderr:
        popen = subprocess.Popen(
            [sys.executable, "-P", "-m", module, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=stderr,
            stderr=stderr,
            pass_fds=tuple(fds),
            env=environment,
            start_new_session=True,
            preexec_fn=None if orphan else end_with_parent,
        )
    return Process(name, popen, stderr_path)


def stop(processes: Sequence[Process], patience_s: float = TERM_PATIENCE_S) -> None:
    """Ask the processes to end, wait, and kill those that do not. A stopped process is continued first."""
    for process in processes:
        if process.code is None:
            process.popen.send_signal(signal.SIGTERM)
            process.resume()
    until = time.monotonic() + patience_s
    for process in processes:
        try:
            process.popen.wait(max(0.0, until - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.popen.kill()
            process.popen.wait()


def share_processor(*processes: Process) -> None:
    """Put processes that wait for each other in turn on one processor.

    They never run at the same time, and waking a processor that has gone to sleep costs as much as a tick's work: see
    docs/decisions/0002-one-processor.md for the measurement.
    """
    allowed = sorted(os.sched_getaffinity(0))
    chosen = {allowed[os.getpid() % len(allowed)]}
    for process in processes:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.sched_setaffinity(process.popen.pid, chosen)
            # The first frame of a batch must not take the processor away from its sender before the last one is out.
            os.sched_setscheduler(process.popen.pid, os.SCHED_BATCH, os.sched_param(0))


def _read_state(pid: int) -> str:
    """The state letter of proc_pid_stat(5); empty when the process is gone."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2].split()[0]
    except (OSError, IndexError):
        return ""


def memory_mb(process: Process) -> float:
    """Peak resident memory of a running process [MB]; 0 when it is gone."""
    try:
        status = Path(f"/proc/{process.popen.pid}/status").read_text()
    except OSError:
        return 0.0
    for line in status.splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) / 1024.0
    return 0.0


def make_pipe() -> tuple[int, int]:
    """Read and write end, neither inherited unless passed on."""
    return os.pipe2(os.O_CLOEXEC)
