"""Where a log comes from: what is written into every log before the first tick."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from bus.build import CURRENT
from bus.icd.messages import dbc_path
from tools.config.scenario import Resolved
from tools.log.recorder import RunAttachment

NAMED_PACKAGES = ("hilsat", "numpy", "python-can", "cantools", "mcap", "pyyaml")


def describe_run(resolved: Resolved, address: str) -> dict[str, str]:
    """The `run` metadata record of a log."""
    scenario = resolved.scenario
    start = datetime.now(UTC)
    return {
        "run_id": f"{scenario.name}-{start:%Y%m%dT%H%M%S}-{os.getpid()}",
        "scenario": scenario.name,
        "seed": str(scenario.seed),
        "run_hash": f"{resolved.run_hash:#010x}",
        "clock": scenario.clock.mode,
        "tick_hz": str(scenario.clock.tick_hz),
        "bus": address,
        "start_utc": start.isoformat(timespec="seconds"),
        **describe_program(),
    }


@cache
def describe_program() -> dict[str, str]:
    """What runs, and where: looked up once in a process, for asking git alone takes longer than a short run.

    The revision is that of the first run. Whoever commits or edits later does not change the code that is loaded already.
    """
    return {
        "host": platform.node(),
        "platform": platform.platform(),
        "python": sys.version.split()[0],
        "versions": ", ".join(f"{name} {_version(name)}" for name in NAMED_PACKAGES),
        "git_rev": read_revision(),
        "build": CURRENT.words,
    }


def list_attachments(resolved: Resolved) -> list[RunAttachment]:
    """The scenario as resolved and the DBC."""
    return [
        RunAttachment("scenario.yaml", "application/yaml", resolved.to_yaml().encode()),
        RunAttachment("icd.dbc", "text/plain", _read_dbc()),
    ]


@cache
def _read_dbc() -> bytes:
    return dbc_path().read_bytes()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def read_revision() -> str:
    """Revision of the source tree that runs, with +dirty when it has changes; empty unless it is a checkout of its own.

    An installed copy inside somebody else's repository has no revision, and neither has a tree that git does not track.
    """
    home = Path(__file__).resolve().parents[2]
    top = _ask_git(home, "rev-parse", "--show-toplevel")
    if not top or Path(top).resolve() != home or not _ask_git(home, "ls-files", "--error-unmatch", "tools/cli.py"):
        return ""
    return _ask_git(home, "describe", "--always", "--dirty=+dirty")


def _ask_git(home: Path, *words: str) -> str:
    """What git says of the tree; empty when it refuses. Whoever runs us may be inside another one: GIT_DIR and the like."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("GIT_")}
    environment["GIT_OPTIONAL_LOCKS"] = "0"  # to look is not to write
    try:
        done = subprocess.run(
            ["git", "-C", str(home), *words],
            capture_output=True, timeout=5, check=False, env=environment, stdin=subprocess.DEVNULL,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return os.fsdecode(done.stdout).strip() if done.returncode == 0 else ""
