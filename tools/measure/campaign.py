"""What campaigns cost: runs per second of processor time beside Basilisk's own Monte-Carlo, idle workers, overhead, memory.

Real frames, the real flight software, no logs. Turn about with Basilisk where that is installed (see
tools/measure/basilisk.py), for a machine's minutes differ.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from tools.campaign.crew import Halt, Order
from tools.campaign.fly import Flown, fly
from tools.campaign.job import Job, make_job
from tools.campaign.plan import Point, RunPlan, derive_seed
from tools.campaign.pool import Pool

BASE: Final = "zhang2018"  # the published scenario: 300 s
PAIRS: Final = 5
RUNS: Final = 12  # of a pair
WORKERS: Final = 2
SMALL_RUNS: Final = 2000
SMALL: Final = ("duration_s=1", "faults=[]", "expect=[]")
ONE_TICK: Final = ("duration_s=0.1", "faults=[]", "expect=[]")
ROUNDS: Final = 60


@dataclass(slots=True)
class _Flight:
    """What flying some runs took."""

    wall_s: float  # from the first run that began to the last that ended
    busy_s: float = 0.0  # of the workers' wall time, that was spent on runs
    cpu_s: float = 0.0  # of the workers and of who leads them
    memory_mb: list[float] = field(default_factory=list)  # resident, of one worker, after each run

    @property
    def idle(self) -> float:
        """Share of the workers' wall time."""
        return 1.0 - self.busy_s / (WORKERS * self.wall_s)


def measure_campaign() -> dict[str, Any]:
    """All figures; those beside Basilisk only where it is installed."""
    job = make_job("measured", [BASE])
    results: dict[str, Any] = {"workers": WORKERS}
    results |= _compare(job)
    results |= _measure_overhead(job)
    small = _fly(job, SMALL_RUNS, SMALL, 1)
    at = [100, SMALL_RUNS // 2, SMALL_RUNS]
    results |= {f"memory of a worker after {count} runs, MB": small.memory_mb[count - 1] for count in at}
    return results


def _compare(job: Job) -> dict[str, Any]:
    """Runs of 300 s a second of processor time: ours, Basilisk's, and the ratio of each pair."""
    ours, theirs, idle = [], [], []
    for _ in range(PAIRS):
        flight = _fly(job, RUNS, (), WORKERS)
        ours.append(RUNS / flight.cpu_s)
        idle.append(flight.idle)
        if (other := _ask_basilisk()) is not None:
            theirs.append(other)
    found = {
        "runs of 300 s per cpu-s, median": statistics.median(ours),
        "runs of 300 s per cpu-s, best": max(ours),
        "idle share of the workers, median": statistics.median(idle),
    }
    if len(theirs) < PAIRS:
        return found | {"Basilisk": "not measured: pip install bsk, or set HILSAT_BSK_PYTHON"}
    ratios = [mine / other for mine, other in zip(ours, theirs, strict=True)]
    return found | {
        "Basilisk Monte-Carlo, runs of 300 s per cpu-s, median": statistics.median(theirs),
        "Basilisk Monte-Carlo, best": max(theirs),
        f"ours / Basilisk, median of {PAIRS} pairs": statistics.median(ratios),
        "ours / Basilisk, pairs": " ".join(f"{ratio:.2f}" for ratio in sorted(ratios)),
    }


def _measure_overhead(job: Job) -> dict[str, Any]:
    """A run of one tick, judged and all, in a process that has flown before."""
    again = [fly(job, _plan(number, ONE_TICK)).timing.cpu_s for number in range(ROUNDS)]
    other = [
        fly(job, _plan(number, (*ONE_TICK, f"fsw.target_q=[1,0,0,{number}e-3]"))).timing.cpu_s
        for number in range(ROUNDS)
    ]
    return {
        "a run of one tick, another seed, cpu-ms, median": 1e3 * statistics.median(again[3:]),
        "a run of one tick, other settings, cpu-ms, median": 1e3 * statistics.median(other[3:]),
    }


def _plan(number: int, overrides: tuple[str, ...]) -> RunPlan:
    return RunPlan(
        number=number, point=Point(values={}, labels={}), base=BASE, overrides=overrides, seed=derive_seed(1, number)
    )


def _fly(job: Job, runs: int, overrides: tuple[str, ...], workers: int) -> _Flight:
    """Fly so many runs in a pool, after one for each worker to get warm."""
    halt = Halt()
    with tempfile.TemporaryDirectory(prefix="hilsat-bench-") as directory:
        pool = Pool(job, Path(directory), workers, None, halt)
        try:
            pool.fly([Order(_plan(number, ONE_TICK)) for number in range(4 * workers)], lambda flown: None)
            return _count(pool, [Order(_plan(number, overrides)) for number in range(runs)])
        finally:
            pool.close()
            halt.close()


def _count(pool: Pool, orders: list[Order]) -> _Flight:
    flight = _Flight(0.0)

    def note(flown: Flown) -> None:
        if flown.result.outcome == "infra":
            raise AssertionError(flown.result.reason)
        flight.busy_s += flown.timing.wall_s
        flight.cpu_s += flown.timing.cpu_s
        flight.memory_mb.append(_read_memory_mb(pool.pids[0]))

    started_s, started_cpu_s = time.perf_counter(), time.process_time()
    pool.fly(orders, note)
    flight.wall_s = time.perf_counter() - started_s
    flight.cpu_s += time.process_time() - started_cpu_s
    return flight


def _read_memory_mb(pid: int) -> float:
    """Resident memory of a process now [MB]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def _ask_basilisk() -> float | None:
    """Its runs a second of processor time, from a process of its own; None where it is not installed."""
    python = os.environ.get("HILSAT_BSK_PYTHON", sys.executable)
    done = subprocess.run(
        [python, "-P", str(Path(__file__).with_name("basilisk_pool.py"))],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    if done.returncode:
        return None
    speed: float = json.loads(done.stdout.splitlines()[-1])["runs_per_cpu_s"]
    return speed
