"""Process trees: finding the children of a process, and leaving none behind."""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import signal
import subprocess
from pathlib import Path

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36
END_LIMIT_S = 10.0
LIBC = ctypes.CDLL(None)


def die_with_parent() -> None:
    """Have the kernel kill this process when its parent ends, however that happens."""
    LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)


def become_subreaper() -> None:
    """Let orphans among the descendants of this process become its children."""
    LIBC.prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def list_processes() -> list[int]:
    """Return the pids that /proc shows. Any of them may be gone by the time it is looked at."""
    return [int(name) for name in os.listdir("/proc") if name.isdigit()]


def list_children(parent: int) -> list[int]:
    """Return the pids whose parent is the given process, from /proc/<pid>/stat."""
    children = []
    for pid in list_processes():
        with contextlib.suppress(OSError):
            fields = Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2].split()
            if int(fields[1]) == parent:
                children.append(pid)
    return children


def end_descendants() -> None:
    """Kill and collect all that this process, a subreaper, still has below it."""
    while True:
        try:
            for pid in list_children(os.getpid()):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            os.waitpid(-1, 0)
        except ChildProcessError:
            return


def end_machine(process: subprocess.Popen[bytes]) -> None:
    """Kill a session leader with all its processes and return when they are gone.

    Where the leader has made a PID namespace, process 1 of it is killed first and waited for: the leader ends only
    after the kernel has cleared the whole namespace.
    """
    first = [pid for pid in list_children(process.pid) if is_namespace_init(pid)] if process.poll() is None else []
    for pid in first:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.kill(pid, signal.SIGKILL)
    if first:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(END_LIMIT_S)
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def is_namespace_init(pid: int) -> bool:
    """Return whether a process is process 1 of a PID namespace below this one."""
    try:
        found = re.search(r"^NSpid:\t(.*)$", Path(f"/proc/{pid}/status").read_text(), re.MULTILINE)
    except OSError:
        return False
    return found is not None and found[1].split()[1:] != [] and found[1].split()[-1] == "1"


def end_processes_naming(path: str) -> None:
    """Kill the machines of ours that were given a path inside this directory (`init=<path>/init` and the like)."""
    sign = b"=" + os.fsencode(path) + b"/"
    for pid in list_processes():
        with contextlib.suppress(OSError):
            entry = Path(f"/proc/{pid}/cmdline")
            if entry.stat().st_uid == os.geteuid() and sign in entry.read_bytes():
                os.kill(pid, signal.SIGKILL)
