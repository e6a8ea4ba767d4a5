"""Instructions of a tick, counted by valgrind: the same on a busy machine and an idle one, so small gains show.

A child flies N ticks in process with its log, and another 2 N; the difference over N leaves start-up and close out.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

TICKS = 2000  # N; of a published scenario at 100 Hz ticks 2000 to 4000 have faults in them
LONGEST_S = 3600.0  # of one child
COUNTED = re.compile(r"I\s+refs:\s+([\d,]+)")


def count_instructions(name: str, settings: Sequence[str], ticks: int = TICKS) -> dict[str, Any]:
    """Instructions per tick of a scenario, or why they were not counted."""
    if shutil.which("valgrind") is None:
        return {"not measured": "valgrind is not there: sudo apt-get install valgrind"}
    try:
        _run_child([], name, settings, 1)  # or the first that is counted would compile what the second finds compiled
        once, twice = (_count(name, settings, count) for count in (ticks, 2 * ticks))
    except (RuntimeError, subprocess.TimeoutExpired) as error:
        return {"failed": str(error)}
    return {"instructions per tick": round((twice - once) / ticks), "ticks": ticks}


def _count(name: str, settings: Sequence[str], ticks: int) -> int:
    """Instructions of a whole child."""
    with tempfile.TemporaryDirectory(prefix="hilsat-bench-") as directory:
        said = Path(directory) / "valgrind.txt"
        counter = ["valgrind", "--tool=cachegrind", "--cache-sim=no", "--cachegrind-out-file=/dev/null"]
        _run_child([*counter, f"--log-file={said}"], name, settings, ticks)
        words = said.read_text() if said.exists() else ""
    if (match := COUNTED.search(words)) is None:
        raise RuntimeError("valgrind gave no count of instructions")
    return int(match[1].replace(",", ""))


def _run_child(counter: Sequence[str], name: str, settings: Sequence[str], ticks: int) -> None:
    """Fly in a process of its own, under `counter`. Raises RuntimeError with its last words when that fails."""
    # Sets and dicts in the same order every time; one thread, for those of a library would wait for each other.
    environment = os.environ | {"PYTHONHASHSEED": "0", "OPENBLAS_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory(prefix="hilsat-bench-") as directory:
        child = [sys.executable, "-P", "-m", "tools.measure.instructions", directory, str(ticks), name, *settings]
        done = subprocess.run(
            [*counter, *child], capture_output=True, text=True, timeout=LONGEST_S, check=False, env=environment,
            stdin=subprocess.DEVNULL,
        )  # fmt: skip
    if done.returncode:
        last = [line for line in done.stderr.splitlines() if line.strip()][-1:]
        raise RuntimeError(f"the counted run ended with {done.returncode}: {''.join(last)}")


def fly(directory: str, ticks: int, name: str, settings: Sequence[str]) -> None:
    """What is counted. The clock stands: under valgrind the run takes fifty times as long, and would flush as often."""
    time.monotonic = lambda: 0.0
    from tools.config.loader import load_scenario  # after that, for some take the clock as they are imported
    from tools.config.scenario_files import find_scenario
    from tools.run.bench import Bench

    resolved = load_scenario(find_scenario(name), [*settings, "clock.mode=inprocess"])
    with Bench(resolved, log=Path(directory) / "run.mcap") as bench:
        bench.step(ticks)


if __name__ == "__main__":
    fly(sys.argv[1], int(sys.argv[2]), sys.argv[3], sys.argv[4:])
