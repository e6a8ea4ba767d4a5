"""Runs one command as the last parent of everything in its guest or namespace, and lets the host signal it.

The control line carries one word per line, host to here: a signal's name without SIG. INT and QUIT go to the command's
process group, as a terminal sends them; the others to the command alone, as `kill` does. The end of the line means that
the host has gone: the command is told to terminate. Nothing here sets a timer: in virtual time an idle guest leaps to
the next one.
"""

from __future__ import annotations

import contextlib
import os
import selectors
import signal
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

GROUP_SIGNALS = frozenset({signal.SIGINT, signal.SIGQUIT})
NOT_EXECUTABLE, NOT_FOUND = 126, 127


@dataclass(frozen=True, slots=True)
class Command:
    """What to run: argument vector, environment, working directory, and the descriptors of its two output streams."""

    argv: Sequence[str]
    env: Mapping[str, str]
    cwd: str
    stdout_fd: int
    stderr_fd: int


def supervise(command: Command, control_fd: int) -> int:
    """Return the command's exit code, 128 + n when signal n ended it. Forwards signals from the control line."""
    wake_read, wake_write = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wake_write, warn_on_full_buffer=False)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)
    child = start_command(command)
    os.set_blocking(control_fd, False)
    selector = selectors.DefaultSelector()
    selector.register(wake_read, selectors.EVENT_READ)
    selector.register(control_fd, selectors.EVENT_READ)
    pending = b""
    while True:
        status = reap_children(child)
        if status is not None:
            selector.close()
            return os.waitstatus_to_exitcode(status) if os.WIFEXITED(status) else 128 + os.WTERMSIG(status)
        for key, _ in selector.select():
            if key.fd == wake_read:
                drain_pipe(wake_read)
                continue
            data = read_control(control_fd)
            if data is None:
                selector.unregister(control_fd)
                send_signal(child, signal.SIGTERM)
                continue
            *lines, pending = (pending + data).split(b"\n")
            for line in lines:
                obey_line(child, line)


def start_command(command: Command) -> int:
    """Return the pid of the command, in a session of its own, its signals as a shell would leave them."""
    pid = os.fork()
    if pid:
        return pid
    code = NOT_EXECUTABLE
    try:
        os.setsid()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGPIPE, signal.SIGCHLD):
            signal.signal(number, signal.SIG_DFL)
        null = os.open("/dev/null", os.O_RDONLY)
        for source, target in ((null, 0), (command.stdout_fd, 1), (command.stderr_fd, 2)):
            os.dup2(source, target, inheritable=True)
        os.chdir(command.cwd)
        os.execvpe(command.argv[0], list(command.argv), dict(command.env))
    except OSError as error:
        code = NOT_FOUND if isinstance(error, FileNotFoundError) else NOT_EXECUTABLE
        os.write(2, os.fsencode(f"hilsat vcan exec: cannot run {command.argv[0]} in {command.cwd}: {error.strerror}\n"))
    finally:
        os._exit(code)


def reap_children(child: int) -> int | None:
    """Collect every child that has ended; return the wait status of `child` when it is one of them."""
    found = None
    while True:
        try:
            pid, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return found
        if pid == 0:
            return found
        if pid == child:
            found = status


def read_control(control_fd: int) -> bytes | None:
    """Return what the control line holds now, None at its end."""
    try:
        return os.read(control_fd, 4096) or None
    except BlockingIOError:
        return b""
    except OSError:
        return None


def drain_pipe(descriptor: int) -> None:
    with contextlib.suppress(BlockingIOError):
        os.read(descriptor, 4096)


def obey_line(child: int, line: bytes) -> None:
    name = line.strip().decode("ascii", "replace")
    if name in ("INT", "QUIT", "TERM", "HUP", "KILL", "USR1", "USR2"):
        send_signal(child, signal.Signals[f"SIG{name}"])


def send_signal(child: int, number: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError):
        if number in GROUP_SIGNALS:
            os.killpg(child, number)
        else:
            os.kill(child, number)
