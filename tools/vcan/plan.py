"""The job directory: what the host tells a guest, and what the guest tells the host, as files."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

PLAN = "plan.json"
STREAMS = ("stdout", "stderr")
STARTED = "started"
EXIT_CODE = "exit_code"
GUEST_LOG = "guest.log"
CONSOLE_LOG = "console.log"
MOUNT_POINT = "mnt"


def write(job: Path, todo: dict[str, Any]) -> None:
    """Leave the plan in the job directory. Bytes that are no text survive (surrogateescape)."""
    (job / PLAN).write_text(json.dumps(todo), encoding="ascii")


def read(job: Path) -> dict[str, Any]:
    """Return the plan that is in the job directory."""
    todo: dict[str, Any] = json.loads((job / PLAN).read_text(encoding="ascii"))
    return todo


def write_result(directory_fd: int, name: str, text: str) -> None:
    """Leave a result that the reader sees whole or not at all."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
    descriptor = os.open(f"{name}.part", flags, 0o644, dir_fd=directory_fd)
    os.write(descriptor, text.encode())
    os.close(descriptor)
    os.rename(f"{name}.part", name, src_dir_fd=directory_fd, dst_dir_fd=directory_fd)


def read_result(job: Path, name: str) -> str | None:
    """Return a result's text, None while it is not there."""
    try:
        return (job / name).read_text()
    except FileNotFoundError:
        return None
