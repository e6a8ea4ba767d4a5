"""What is asked of `vcan exec`, and what a backend answers: the process to start and how its inside is set up."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tools
from tools.vcan import plan
from tools.vcan.namespaces import OPTIONAL

REQUIRED_VARIABLE = "HILSAT_REQUIRE_VCAN"
VIRTUAL_TIME_VARIABLE = "HILSAT_VIRTUAL_TIME"


@dataclass(frozen=True, slots=True)
class Request:
    """One command to run where CAN exists. `timeout_s` 0 means no limit; `memory_mb` is the guest's."""

    argv: Sequence[str]
    can: Sequence[str] = ("vcan0",)
    own_dirs: Sequence[str] = ()
    backend: str = "auto"
    virtual_time: bool = False
    real_time: bool = False
    timeout_s: float = 0.0
    memory_mb: int = 2048
    verbose: bool = False


@dataclass(frozen=True, slots=True)
class Machine:
    """The process that runs a command with CAN, and the backend's own entries of the plan for its inside.

    `copies_streams`: the command's output arrives in files of the job directory, rather than on inherited descriptors.
    `one_cpu`: it gains from staying on one processor.
    """

    name: str
    argv: Sequence[str]
    env: Mapping[str, str]
    todo: Mapping[str, Any] = field(default_factory=dict)
    copies_streams: bool = True
    one_cpu: bool = False
    boot_limit_s: float = 60.0


def write_job(job: Path, request: Request, todo: Mapping[str, Any], entry: str) -> None:
    """Leave the plan, the empty streams and the start script of `tools.vcan.<entry>` in the job directory."""
    umask = os.umask(0o022)
    os.umask(umask)
    common: dict[str, Any] = {
        "argv": list(request.argv),
        "env": command_environment(request),
        "cwd": os.getcwd(),
        "umask": umask,
        "can": list(request.can),
        "own_dirs": list(own_directories(request)),
    }
    plan.write(job, {**common, **todo})
    for name in plan.STREAMS:
        (job / name).touch()
    (job / plan.MOUNT_POINT).mkdir(exist_ok=True)
    script = job / "init"
    script.write_text(f"#!/bin/sh\nexec {shlex.join(inside_command(job, entry))}\n")
    script.chmod(0o755)


def inside_command(job: Path, entry: str) -> list[str]:
    """Return the argument vector that runs `tools.vcan.<entry>` on a job directory, standard library only."""
    return python_command(f"from tools.vcan.{entry} import main; main({str(job)!r})")


def python_command(code: str) -> list[str]:
    """Return the argument vector that runs code on this interpreter, with the standard library and this package."""
    source = str(Path(tools.__file__).resolve().parent.parent)
    start = f"import sys; sys.path.append({source!r}); {code}"
    return [os.path.realpath(sys.executable), "-I", "-S", "-c", start]


def command_environment(request: Request) -> dict[str, str]:
    """Return the caller's environment plus what tells the command that CAN is required and how time runs."""
    env = {**os.environ, REQUIRED_VARIABLE: "1"}
    if request.virtual_time:
        env[VIRTUAL_TIME_VARIABLE] = "1"
        env.setdefault("PYTHONHASHSEED", "0")
    return env


def own_directories(request: Request) -> list[str]:
    """Return the directories that are the host's own inside a guest, outer before inner.

    They are the current one and those asked for. The root directory itself stays copy-on-write.
    """
    paths = {os.path.realpath(path) for path in (os.getcwd(), *request.own_dirs)} - {"/"}
    return sorted(paths, key=lambda path: (path.count("/"), path))


def in_namespaces(*kinds: str) -> list[str]:
    """Return the words that, put before a program, run it in new namespaces; see tools.vcan.namespaces."""
    return [*python_command("from tools.vcan.namespaces import run_wrapped; run_wrapped()"), ",".join(kinds)]


def in_process_namespace() -> list[str]:
    """Return the words that put a program into a PID namespace that ends with it, wherever the host allows one."""
    return in_namespaces("pid", OPTIONAL)


def try_command(argv: Sequence[str]) -> bool:
    """Return whether a command can be started and ends with 0 within ten seconds."""
    quiet = subprocess.DEVNULL
    try:
        return not subprocess.run(argv, stdin=quiet, stdout=quiet, stderr=quiet, timeout=10, check=False).returncode
    except (OSError, subprocess.TimeoutExpired):
        return False
