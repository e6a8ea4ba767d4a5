"""The same measurements of the plain build, where the compiled one runs: in a process of its own, in the same minutes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

from bus.build import CHOICE, CURRENT
from bus.errors import UsageError

BOTH = (
    "in-process",
    "lock-step",
    "set-up",
    "codec",
    "detection",
    "algorithms",
    "wheels",
    "instructions",
)  # what depends on the build
RATIO = "compiled / plain"


def has_other() -> bool:
    """Whether this process runs the compiled build and nobody has said which one is to be measured."""
    return CURRENT.compiled and CHOICE not in os.environ


def measure_plain(name: str, seconds: float) -> dict[str, Any]:
    """Return what the plain build measures. Raises UsageError when it fails."""
    command = [sys.executable, "-P", "-m", "tools.cli", "bench", "--only", name, "--seconds", str(seconds), "--json"]
    environment = {**os.environ, CHOICE: "plain"}
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False, env=environment)
    if done.returncode:
        raise UsageError(
            f"hilsat bench: the plain build's measurement of {name} ended with exit code {done.returncode}"
        )
    results: dict[str, Any] = json.loads(done.stdout)[name]
    return results


def set_beside(compiled: dict[str, Any], plain: dict[str, Any]) -> dict[str, Any]:
    """Each figure of both builds, and compiled over plain; groups of figures group by group."""
    beside: dict[str, Any] = {}
    for key, value in compiled.items():
        other = plain.get(key)
        if isinstance(value, dict) and isinstance(other, dict):
            beside[key] = set_beside(value, other)
        elif isinstance(value, int | float) and isinstance(other, int | float) and other:
            beside[key] = {"compiled": value, "plain": other, RATIO: value / other}
        else:
            beside[key] = value
    return beside
