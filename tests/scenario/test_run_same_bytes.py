"""Determinism: one scenario and seed give the same telemetry and the same frames, whoever carries them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tools.log.mcap_reader import read_run

SHORT = ["--set", "duration_s=101", "--set", "expect=[]", "--no-plot", "--json", "-q"]


def fly(out: Path, *words: str, scenario: str = "zhang2018", hash_seed: str = "0") -> dict[str, Any]:
    command = [sys.executable, "-P", "-m", "tools.cli", "run", scenario, "--out", str(out), *SHORT, *words]
    environment = {**os.environ, "PYTHONHASHSEED": hash_seed}
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment, check=False)
    assert done.stdout, done.stderr
    result: dict[str, Any] = json.loads(done.stdout)
    assert result["run"]["exit_code"] == 0, done.stderr
    return result


@pytest.mark.parametrize("scenario", ["zhang2018", pytest.param("zhang2018-flight", marks=pytest.mark.slow)])
def test_in_process_and_lock_step_give_the_same_bytes(tmp_path: Path, scenario: str) -> None:
    """Two processes over the embedded bus log exactly what one process logs, frames included."""
    for name, clock in (("a", "inprocess"), ("b", "lockstep")):
        fly(tmp_path / name, "--clock", clock, scenario=scenario, hash_seed=name.encode().hex()[:2])
    one, two = (read_run(tmp_path / name / "run.mcap") for name in "ab")
    assert one.frames().tobytes() == two.frames().tobytes()
    assert one.digest() == two.digest()


@pytest.mark.slow
def test_another_seed_gives_other_bytes(tmp_path: Path) -> None:
    """The digest does depend on the noise: two seeds of a noisy scenario differ."""
    digests = []
    for seed in ("1", "2"):
        fly(tmp_path / seed, "--clock", "inprocess", "--seed", seed, scenario="zhang2018-flight")
        digests.append(read_run(tmp_path / seed / "run.mcap").digest())
    assert digests[0] != digests[1]
