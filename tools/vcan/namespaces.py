"""A process put into namespaces of its own, as root or, through a user namespace, as anyone whom the host allows.

What util-linux's `unshare --fork --kill-child` does, without its noise when the child is killed, and with a way down:
where the host allows no PID namespace, the program runs without one.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import socket
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from bus.wire import rtnetlink
from tools.vcan.process_tree import die_with_parent

CLONE_FLAGS = {"mount": 0x20000, "user": 0x10000000, "pid": 0x20000000, "net": 0x40000000}
MS_REC, MS_PRIVATE = 0x4000, 0x40000
OPTIONAL = "optional"
CANNOT_ISOLATE = 121
LIBC = ctypes.CDLL(None, use_errno=True)


def main(kinds: str, program: Sequence[str]) -> NoReturn:
    """Become the given program in new namespaces, which end with this process.

    kinds : comma-separated names of CLONE_FLAGS, with "optional" where the program shall run even if they are refused
    """
    wanted = set(kinds.split(","))
    optional = OPTIONAL in wanted
    wanted.discard(OPTIONAL)
    if not optional:
        isolate(wanted)
    elif not try_isolate(wanted, with_user=os.geteuid() != 0) and not try_isolate(wanted, with_user=True):
        os.execvp(program[0], list(program))
    child = os.fork() if "pid" in wanted else 0
    if child:
        wait_for(child)
    die_with_parent()
    if {"pid", "mount"} <= wanted:
        mount_proc()
    os.execvp(program[0], list(program))


def start_network(can: Sequence[str]) -> None:
    """Furnish a fresh network namespace: loopback and the named vcan interfaces up, raw CAN sockets. Raises OSError."""
    rtnetlink.switch_link("lo", up=True)
    for name in can:
        rtnetlink.add_vcan(name)
    socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()


def try_isolate(kinds: set[str], *, with_user: bool) -> bool:
    try:
        isolate(kinds | {"user"} if with_user else kinds)
    except OSError:
        return False
    return True


def isolate(kinds: set[str]) -> None:
    """Leave the parent's namespaces of these kinds; in a new user namespace, be root there. Raises OSError."""
    user, group = os.geteuid(), os.getegid()
    if LIBC.unshare(sum(CLONE_FLAGS[kind] for kind in kinds)):
        number = ctypes.get_errno()
        raise OSError(number, f"namespaces {', '.join(sorted(kinds))}: {os.strerror(number)}")
    if "user" in kinds:
        Path("/proc/self/setgroups").write_text("deny")
        Path("/proc/self/uid_map").write_text(f"0 {user} 1")
        Path("/proc/self/gid_map").write_text(f"0 {group} 1")


def wait_for(child: int) -> NoReturn:
    """End as the child ends. Its own end, by whatever signal, takes the child along."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, signal.SIG_IGN)
    die_with_parent()
    _, status = os.waitpid(child, 0)
    os._exit(os.WEXITSTATUS(status) if os.WIFEXITED(status) else 128 + os.WTERMSIG(status))


def mount_proc() -> None:
    """Give the new PID namespace a /proc that shows it. Raises OSError."""
    LIBC.mount(b"none", b"/", None, ctypes.c_ulong(MS_REC | MS_PRIVATE), None)
    if LIBC.mount(b"proc", b"/proc", b"proc", ctypes.c_ulong(0), None):
        number = ctypes.get_errno()
        raise OSError(number, f"mount of /proc: {os.strerror(number)}")


def run_wrapped() -> NoReturn:
    """Entry of `python -c`: the kinds and the program are the arguments."""
    with contextlib.suppress(OSError):
        main(sys.argv[1], sys.argv[2:])
    os._exit(CANNOT_ISOLATE)
