"""The same minute on Basilisk, where it is installed: a rigid body with four reaction wheels, RK4 at 10 ms, no frames.

Basilisk (AVS Lab, `pip install bsk`) is what people would take for the physics alone. It runs in one process, in C++,
with nothing on a bus: the ratio says what the frames, the checks, the flight cycle and the log cost beside it.
Runs in a process of its own, so that its memory and imports do not count against ours; HILSAT_BSK_PYTHON names another
interpreter that has it.
"""

from __future__ import annotations

import json
import os
import runpy
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

SECONDS = 300.0
PAIRS = 9


def compare(measures: dict[str, Callable[[], float]]) -> dict[str, Any]:
    """Our speed in process at each scenario, Basilisk's, and the ratio: turn about, for a machine's minutes differ."""
    python = os.environ.get("HILSAT_BSK_PYTHON", sys.executable)
    theirs: list[float] = []
    ours: dict[str, list[float]] = {name: [] for name in measures}
    version = ""
    for _ in range(PAIRS):
        done = subprocess.run([python, "-P", __file__], capture_output=True, text=True, timeout=300, check=False)
        if done.returncode:
            return {"not measured": f"{python} has no Basilisk (pip install bsk, or set HILSAT_BSK_PYTHON)"}
        flown = json.loads(done.stdout.splitlines()[-1])
        version = flown["version"]
        theirs.append(flown["speed"])
        for name, measure in measures.items():
            ours[name].append(measure())
    results: dict[str, Any] = {
        "Basilisk version": version,
        "Basilisk, sim-s per cpu-s, median": statistics.median(theirs),
        "Basilisk, sim-s per cpu-s, best": max(theirs),
    }
    for name, speeds in ours.items():
        ratios = [speed / other for speed, other in zip(speeds, theirs, strict=True)]
        results |= {
            f"{name} / Basilisk, median of {PAIRS} pairs": statistics.median(ratios),
            f"{name} / Basilisk, best of each": max(speeds) / max(theirs),
        }
    return results


def _fly_basilisk() -> dict[str, Any]:
    """Four wheels on a rigid body for SECONDS at dt 0.01 s; CPU seconds of the run alone, without imports."""
    import Basilisk
    from Basilisk.utilities import macros

    # By its path: the interpreter that has Basilisk need not have us.
    sim = runpy.run_path(str(Path(__file__).with_name("basilisk_pool.py")))["make"]()
    sim.InitializeSimulation()
    sim.ConfigureStopTime(macros.sec2nano(SECONDS))
    started = time.process_time()
    sim.ExecuteSimulation()
    return {"version": Basilisk.__version__, "speed": SECONDS / (time.process_time() - started)}


if __name__ == "__main__":
    print(json.dumps(_fly_basilisk()))
