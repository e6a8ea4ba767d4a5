"""Where the kernel has CAN: a private network namespace with the interfaces in it, as root or in a user namespace."""

from __future__ import annotations

import errno
import os
import socket
from functools import cache
from pathlib import Path

from tools.vcan import plan
from tools.vcan.errors import VcanError
from tools.vcan.machine import Machine, Request, in_namespaces, inside_command, try_command, write_job
from tools.vcan.namespaces import start_network
from tools.vcan.process_tree import become_subreaper, end_descendants
from tools.vcan.supervisor import Command, supervise

PROBE = "probe"


def socket_obstacle() -> str | None:
    """Return why this kernel gives no raw CAN socket, None when it does."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        meaning = {
            errno.EAFNOSUPPORT: "this kernel has no CAN (AF_CAN is not supported)",
            errno.EPROTONOSUPPORT: "this kernel has CAN but not raw sockets (module can-raw)",
            errno.EPERM: "CAN sockets are forbidden here (a container's seccomp profile?)",
            errno.EACCES: "CAN sockets are forbidden here (a container's seccomp profile?)",
        }
        return meaning.get(error.errno or 0, f"a CAN socket cannot be opened: {error.strerror}")
    return None


def find_obstacle() -> str | None:
    """Return why commands cannot run natively in a network namespace with vcan, None when they can."""
    if reason := socket_obstacle():
        return reason
    if find_namespaces() is None:
        who = "root" if os.geteuid() == 0 else f"uid {os.geteuid()}"
        return (
            f"{who} may not make a network namespace with a vcan interface here (module vcan missing, or not permitted)"
        )
    return None


@cache
def find_namespaces() -> tuple[str, ...] | None:
    """Return the most private kinds of namespaces in which a vcan interface can be made, None if it can in none."""
    whole, bare = ("net", "pid", "mount"), ("net",)
    choices = [(*whole, "user"), (*bare, "user")]
    if os.geteuid() == 0:
        choices = [whole, bare, *choices]
    for kinds in choices:
        if try_command([*in_namespaces(*kinds), *inside_command(Path(PROBE), "native")]):
            return kinds
    return None


def prepare(job: Path, request: Request) -> Machine:
    """Return the namespace as a process to start. Raises VcanError."""
    kinds = find_namespaces() if socket_obstacle() is None else None
    if kinds is None:
        raise VcanError(f"native: {find_obstacle()}; `hilsat vcan status` tells more")
    write_job(job, request, {}, "native")
    return Machine(
        "this kernel",
        [*in_namespaces(*kinds), str(job / "init")],
        dict(os.environ),
        copies_streams=False,
        boot_limit_s=20.0,
    )


def main(job_dir: str) -> None:
    """Inside the namespace: make the interfaces, run the plan's command, note its exit code."""
    if job_dir == PROBE:
        start_network(["vcan0"])
        return
    job = Path(job_dir)
    todo = plan.read(job)
    results = os.open(job, os.O_RDONLY | os.O_DIRECTORY)
    try:
        start_network(todo["can"])
    except OSError as error:
        (job / plan.GUEST_LOG).write_text(f"namespace: {error}\n")
        raise SystemExit(1) from error
    plan.write_result(results, plan.STARTED, "")
    become_subreaper()
    os.umask(todo["umask"])
    code = supervise(Command(todo["argv"], todo["env"], todo["cwd"], 1, 2), 0)
    os.umask(0o022)
    end_descendants()
    plan.write_result(results, plan.EXIT_CODE, str(code))
