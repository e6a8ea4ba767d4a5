"""One run of a machine, seen from the host: streams, signals, time limit, exit code, and nothing left behind."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import BinaryIO

from tools.vcan import plan
from tools.vcan.cache import say
from tools.vcan.errors import GuestError, VcanError
from tools.vcan.machine import Machine
from tools.vcan.process_tree import die_with_parent, end_machine, end_processes_naming

JOB_PREFIX = "hilsat-vcan-"
TIMED_OUT = 124
STALE_S = 10.0  # a directory without a lock may be younger than its lock
GRACE_S = 5.0  # for a command to close its files after its time is over, before the guest is switched off under it
POLL_S = 0.02
LAST_SIGNAL = 3  # the third interrupt switches the guest off
FORWARDED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
FIFO_PRIORITY = 10
LOG_TAIL_LINES = 25


@contextlib.contextmanager
def job_directory() -> Iterator[Path]:
    """A private directory for one run, removed at its end; at its beginning those of killed runs are removed."""
    base = Path(tempfile.gettempdir()).resolve()
    if re.search(r"[\s,:\\\"']", str(base)):
        base = Path("/tmp")  # the name goes onto a kernel's command line and into mount options
    sweep_jobs(base)
    job = Path(tempfile.mkdtemp(prefix=JOB_PREFIX, dir=base))
    lock = os.open(job, os.O_RDONLY | os.O_DIRECTORY)
    fcntl.flock(lock, fcntl.LOCK_EX)
    try:
        yield job
    finally:
        os.close(lock)
        shutil.rmtree(job, ignore_errors=True)


def sweep_jobs(base: Path) -> None:
    """Remove the directories of runs whose process has gone (their lock is free), and what still runs for them."""
    for path in base.glob(f"{JOB_PREFIX}*"):
        try:
            lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        except OSError:
            continue
        try:
            status = os.fstat(lock)
            if status.st_uid == os.geteuid() and time.time() - status.st_ctime >= STALE_S:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                end_processes_naming(str(path))
                shutil.rmtree(path, ignore_errors=True)
        except OSError:
            pass
        finally:
            os.close(lock)


class Session:
    """A started machine. `run` returns the command's exit code."""

    def __init__(self, job: Path, machine: Machine, *, real_time: bool, timeout_s: float) -> None:
        self.job = job
        self.machine = machine
        self.timeout_s = timeout_s
        self.requests: list[int] = []
        self.console = (job / plan.CONSOLE_LOG).open("ab")
        read_end, self.control = os.pipe2(os.O_CLOEXEC)
        own_streams = self.console if machine.copies_streams else None
        cpu = choose_cpu(machine, real_time)
        try:
            self.process = subprocess.Popen(
                list(machine.argv),
                env=dict(machine.env),
                stdin=read_end,
                stdout=own_streams,
                stderr=own_streams,
                start_new_session=True,
                preexec_fn=lambda: enter_child(cpu, real_time),
            )
        except OSError as error:
            os.close(self.control)
            raise VcanError(f"{machine.name}: {machine.argv[0]} cannot be started: {error.strerror}") from error
        finally:
            os.close(read_end)

    def run(self) -> int:
        """Return the command's exit code, 124 after the time limit, 128 + n for a signal n before the command began.

        Raises GuestError when the machine ends, or does not come up, without an exit code.
        """
        with handled_signals(self.requests), contextlib.ExitStack() as stack:
            stack.callback(self.close)
            pumps = [
                Pump(stack.enter_context((self.job / name).open("rb")), stream.buffer)
                for name, stream in zip(plan.STREAMS, (sys.stdout, sys.stderr), strict=True)
            ]
            code = self.watch(pumps)
            for pump in pumps:
                pump.move()
            return code

    def watch(self, pumps: list[Pump]) -> int:
        """Move output and forward signals until there is an exit code; return it."""
        start = time.monotonic()
        ended = os.pidfd_open(self.process.pid)
        forwarded, kill_at, timed_out, broken = 0, float("inf"), False, False
        try:
            while True:
                gone = bool(select.select([ended], [], [], POLL_S)[0])
                for pump in pumps:
                    pump.move()
                if (text := plan.read_result(self.job, plan.EXIT_CODE)) is not None:
                    return TIMED_OUT if timed_out else int(text)
                now = time.monotonic()
                started = plan.read_result(self.job, plan.STARTED) is not None
                if gone or (not started and now - start > self.machine.boot_limit_s):
                    raise GuestError(self.describe_failure(gone, started))
                if not broken and any(pump.broken for pump in pumps):
                    broken = True
                    self.requests.append(signal.SIGTERM)
                while forwarded < len(self.requests):
                    number = self.requests[forwarded]
                    forwarded += 1
                    if not started or forwarded >= LAST_SIGNAL:
                        return 128 + number
                    self.send(signal.Signals(number).name.removeprefix("SIG"))
                if self.timeout_s and not timed_out and now - start > self.timeout_s:
                    say(f"the time limit of {self.timeout_s:g} s is over: terminating the command")
                    timed_out, kill_at = True, now + GRACE_S
                    self.send("TERM")
                if now > kill_at:
                    return TIMED_OUT
        finally:
            os.close(ended)

    def send(self, word: str) -> None:
        with contextlib.suppress(BrokenPipeError):
            os.write(self.control, word.encode() + b"\n")

    def close(self) -> None:
        """End the machine and everything in it."""
        end_machine(self.process)
        os.close(self.control)
        self.console.close()

    def describe_failure(self, gone: bool, started: bool) -> str:
        """Return what is known of a machine that ended, or did not begin, without the command's exit code."""
        what = "went down while the command was running" if started else "did not come up"
        if not gone:
            what += f" within {self.machine.boot_limit_s:g} s"
        logs = [self.read_tail(name) for name in (plan.GUEST_LOG, plan.CONSOLE_LOG)]
        lines = "\n".join(f"  {line}" for text in logs for line in text)
        hint = explain_console(lines)
        return f"{self.machine.name} {what}{f': {hint}' if hint else ''}\n{lines or '  (it said nothing)'}"

    def read_tail(self, name: str) -> list[str]:
        with contextlib.suppress(FileNotFoundError):
            return (self.job / name).read_text(errors="replace").splitlines()[-LOG_TAIL_LINES:]
        return []


class Pump:
    """Copies what grows at the end of a file to a stream, byte for byte."""

    def __init__(self, source: BinaryIO, sink: BinaryIO) -> None:
        self.source = source
        self.sink = sink
        self.broken = False

    def move(self) -> None:
        """Copy what is there now. After the reader has gone, drop it."""
        moved = False
        while data := self.source.read(1 << 16):
            if self.broken:
                continue
            try:
                self.sink.write(data)
                moved = True
            except BrokenPipeError:
                self.broken = True
        if moved:
            try:
                self.sink.flush()
            except BrokenPipeError:
                self.broken = True


def explain_console(text: str) -> str:
    """Return what a known message of a guest kernel means, empty for others."""
    known = {
        "ptrace set fp regs failed": "this XSAVE area is larger than the kernel knows, and the shim (gcc) is missing",
        "PTRACE_TRACEME": "ptrace is forbidden here (a container's seccomp profile: --cap-add SYS_PTRACE)",
        "ptrace: Operation not permitted": "ptrace is forbidden here (container: --cap-add SYS_PTRACE)",
        "Operation not supported": "the guest's kernel lacks a part",
        "No space left": "the guest's memory or a directory is full; ask for more with --mem",
    }
    return next((meaning for sign, meaning in known.items() if sign in text), "")


def enter_child(cpu: int | None, real_time: bool) -> None:
    """In the child, before it becomes the machine: die with the parent, stay on one processor, SCHED_FIFO if asked."""
    die_with_parent()
    if cpu is not None:
        os.sched_setaffinity(0, {cpu})
    if real_time:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))


def choose_cpu(machine: Machine, real_time: bool) -> int | None:
    """Return the processor to stay on, None for all. Real time takes the last one, as interrupts favour the first.

    User-mode Linux runs one of its processes at a time; the wake-ups from one processor to another make each of its
    system calls four to five times dearer (docs/vcan.md has the measurement).
    """
    allowed = sorted(os.sched_getaffinity(0))
    if real_time:
        return allowed[-1]
    return allowed[os.getpid() % len(allowed)] if machine.one_cpu else None


def require_real_time() -> None:
    """Raise VcanError where this user may not use SCHED_FIFO."""
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
    except OSError as error:
        raise VcanError(
            f"--real-time: SCHED_FIFO is not permitted ({error.strerror}); run as root, add "
            f"`USER - rtprio {FIFO_PRIORITY}` to /etc/security/limits.conf, or (container) --cap-add SYS_NICE"
        ) from error
    os.sched_setscheduler(0, policy, parameter)


@contextlib.contextmanager
def handled_signals(requests: list[int]) -> Iterator[None]:
    """While inside, the forwarded signals are appended to `requests` instead of ending this process."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def note(number: int, _frame: FrameType | None) -> None:
        requests.append(number)

    before = {number: signal.signal(number, note) for number in FORWARDED}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
