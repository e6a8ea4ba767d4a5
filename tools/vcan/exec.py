"""`vcan exec`: choose where the command can have CAN, run it there, come back with its exit code."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tools.vcan import native, plan, qemu, uml
from tools.vcan.cache import say
from tools.vcan.errors import GuestError, VcanError
from tools.vcan.machine import Machine, Request
from tools.vcan.session import Session, job_directory, require_real_time

Prepare = Callable[[Path, Request], Machine]
BACKENDS: dict[str, Prepare] = {"native": native.prepare, "uml": uml.prepare, "qemu": qemu.prepare}


def run_command(request: Request) -> int:
    """Return the exit code of the request's command, run with CAN interfaces. Raises VcanError, GuestError.

    With backend `auto` the next backend is tried when one cannot be prepared or does not come up, never once the
    command has begun.
    """
    if request.real_time:
        require_real_time()
    names = choose_backends(request)
    reasons = []
    for name in names:
        try:
            return run_on(name, request)
        except VcanError as error:
            if name == names[-1] or (isinstance(error, GuestError) and error.command_began):
                reasons.append(str(error))
                raise GuestError("\n".join(reasons)) from error
            reasons.append(f"{name}: {error}")
            if name != "native" or request.verbose:
                say(f"{error}\nhilsat vcan: trying the next backend")
    raise AssertionError("there is always one backend")


def choose_backends(request: Request) -> list[str]:
    """Return the backends to try, in order."""
    if request.backend != "auto":
        return [request.backend]
    return ["uml"] if request.virtual_time else list(BACKENDS)


def run_on(backend: str, request: Request) -> int:
    """Return the exit code of the command under one backend. Raises VcanError, with `command_began` set if it had."""
    with job_directory() as job:
        machine = BACKENDS[backend](job, request)
        if request.verbose:
            say(f"on {machine.name}: {' '.join(machine.argv)}")
        session = Session(job, machine, real_time=request.real_time, timeout_s=request.timeout_s)
        try:
            return session.run()
        except GuestError as error:
            error.command_began = plan.read_result(job, plan.STARTED) is not None
            raise
