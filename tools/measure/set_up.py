"""What a run costs beside its ticks, in a process that has made runs before: what a campaign pays for every flight.

CPU time of this process. Every run has one tick: what is packed and written of more of them is not set-up. The scenario
is read again with another seed each time, as a campaign does it.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tools.config.loader import load_scenario
from tools.config.scenario_files import find_scenario
from tools.run.bench import Bench

ROUNDS = 20


def measure_set_up(name: str, settings: Sequence[str]) -> dict[str, float]:
    """Median of ROUNDS runs of one tick, after one that fills what is kept between runs."""
    _fly(name, settings, 0)
    loading, opening, closing = zip(*(_fly(name, settings, seed) for seed in range(1, ROUNDS + 1)), strict=True)
    both = [first + last for first, last in zip(opening, closing, strict=True)]
    return {
        "set-up and close, cpu-ms, median": statistics.median(both),
        "set-up and close, cpu-ms, best": min(both),
        "close alone, cpu-ms, median": statistics.median(closing),
        "reading with another seed, cpu-ms, median": statistics.median(loading),
    }


def _fly(name: str, settings: Sequence[str], seed: int) -> tuple[float, float, float]:
    """CPU time of reading the scenario, of what comes before the first tick, and of what comes after the last [ms]."""
    with tempfile.TemporaryDirectory(prefix="hilsat-bench-") as directory:
        times = [time.process_time()]
        resolved = load_scenario(find_scenario(name), [*settings, "clock.mode=inprocess", f"seed={seed}"])
        times.append(time.process_time())
        bench = Bench(resolved, log=Path(directory) / "run.mcap")
        times.append(time.process_time())
        bench.step()
        times.append(time.process_time())
        bench.close("done")
        times.append(time.process_time())
    return 1e3 * (times[1] - times[0]), 1e3 * (times[2] - times[1]), 1e3 * (times[4] - times[3])
