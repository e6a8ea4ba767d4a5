"""A Dask cluster of real processes flies what the pool flies, and loses nothing when one of them is killed."""

from __future__ import annotations

import dataclasses
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import distributed
import psutil
import pytest

from bus.errors import UsageError
from tools.campaign.crew import Halt, Order
from tools.campaign.dask_crew import DaskCrew
from tools.campaign.fly import Flown, fail
from tools.campaign.job import Job, Metric, make_job
from tools.campaign.launch import Options, fly_campaign
from tools.campaign.plan import Point, RunPlan, derive_seed
from tools.campaign.progress import Silence
from tools.campaign.results import RunResult, Timing, read_results, read_timings
from tools.campaign.strategies.settings import PlanSettings

RUNS = 24
BASE = "zhang2018-flight"
PLAN = PlanSettings()
COMMON = (
    "duration_s=2",
    "faults=[]",
    "expect=[{name: rate, check: below, signal: norm(fsw.attitude.omega_bi_b_hat_rad_s), bound: 0.010335, unit: rad/s}]",
)


@dataclasses.dataclass
class HandMade:
    """A campaign without a file."""

    runs: int | None = RUNS
    seed: int = 3
    name: str = "hand-made"
    title: str = ""
    text: str = "name: hand-made\n"
    bases: tuple[str, ...] = (BASE,)
    axes: tuple[Any, ...] = ()
    keep_logs: str = "none"
    limit_s: float | None = None
    metrics: Any = ()
    strategy: Any = PLAN
    slow: int = -1  # number of a run that never ends

    def points(self) -> list[Point]:
        return [Point(values={"case": case}, labels={"case": str(case)}) for case in range(self.runs or 0)]

    def plan(self, number: int, point: Point) -> RunPlan:
        words = ("duration_s=100000", "faults=[]", "expect=[]") if number == self.slow else COMMON
        return RunPlan(number=number, point=point, base=BASE, overrides=words, seed=derive_seed(self.seed, number))


@pytest.fixture(scope="module")
def job() -> Job:
    return make_job(
        "hand-made", [BASE], metrics={"effort": Metric(statistic="integral", signal="norm(fsw.control.tau_cmd_b_nm)")}
    )


class KillOne(Silence):
    """Kills a worker of the cluster once so many runs are done."""

    def __init__(self, pids: list[int], after: int) -> None:
        self.pids, self.left = pids, after

    def note(self, result: RunResult) -> None:
        self.left -= 1
        if not self.left:
            os.kill(self.pids[0], signal.SIGKILL)


@pytest.mark.slow
def test_a_killed_worker_loses_nothing(job: Job, tmp_path: Path) -> None:
    """Two workers, one killed half-way: the results are the pool's byte for byte, each run once; kept logs come home."""
    fly_campaign(HandMade(), job, tmp_path / "pool", Options(jobs=2, keep_logs="worst 2"), Silence())
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        pids = list(client.run(os.getpid).values())
        assert len(set(pids)) == 2
        assert os.getpid() not in pids
        options = Options(dask=cluster.scheduler_address, keep_logs="worst 2")
        out, watch = tmp_path / "dask", KillOne(pids, RUNS // 2)
        conclusion = fly_campaign(HandMade(), job, out, options, watch)
        after = set(client.run(os.getpid).values())
    assert watch.left <= 0
    assert pids[0] not in after
    assert conclusion.flown == RUNS
    assert (out / "results.jsonl").read_bytes() == (tmp_path / "pool/results.jsonl").read_bytes()
    assert sorted(timing.number for timing in read_timings(out))[:3] == [0, 1, 2]
    for name in (path.name for path in (tmp_path / "pool/logs").iterdir()):
        assert (out / "logs" / name).is_file()


@pytest.mark.slow
def test_local_cluster_and_limit(job: Job, tmp_path: Path) -> None:
    """A cluster that is made for the campaign: the same results, a run over the limit ended, no process left."""
    campaign = HandMade(runs=4, slow=2)
    out = tmp_path / "out"
    fly_campaign(campaign, job, out, Options(jobs=2, dask="local", limit_s=3.0), Silence())
    results = read_results(out)
    assert [result.outcome == "infra" for result in results] == [False, False, True, False]
    assert "more than 3 s" in results[2].reason
    left = [" ".join(process.cmdline()) for process in psutil.Process().children(recursive=True)]
    assert [words for words in left if "resource_tracker" not in words] == []  # one of multiprocessing's own


def test_no_scheduler(job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nobody listens that is said, with the address."""
    monkeypatch.setattr("tools.campaign.dask_crew.CONNECT_S", 1)
    with pytest.raises(UsageError, match=r"tcp://127\.0\.0\.1:9"):
        fly_campaign(HandMade(), job, tmp_path / "out", Options(dask="tcp://127.0.0.1:9"), Silence())
    assert not (tmp_path / "out").exists()


class GoneFuture:
    """A task that is done, whose result can be fetched only when its worker did not die in between."""

    def __init__(self, key: str, flown: Flown | None) -> None:
        self.key, self._flown = key, flown

    def add_done_callback(self, put: Callable[[Any], None]) -> None:
        put(self)

    def result(self, timeout: float) -> Flown:
        if self._flown is None:
            raise TimeoutError(f"timed out after {timeout} s")
        return self._flown

    def release(self) -> None:
        """Nothing is held."""


class GoneClient:
    """A cluster of one worker that loses the first so many results."""

    status = "running"

    def __init__(self, losses: int) -> None:
        self.losses, self.asked = losses, 0

    def nthreads(self) -> dict[str, int]:
        return {"worker": 1}

    def submit(self, task: Any, job: Job, plan: RunPlan, *_: Any, key: str, pure: bool) -> GoneFuture:
        assert not pure
        self.asked += 1
        timing = Timing(number=plan.number, wall_s=0.0, cpu_s=0.0, ticks=1, worker="fake")
        return GoneFuture(key, None if self.asked <= self.losses else Flown(fail(plan, "flown"), timing))


@pytest.mark.parametrize(
    ("losses", "reason"), [(1, "flown"), (3, "flown"), (4, "the cluster gave it up: TimeoutError")]
)
def test_a_result_that_went_with_its_worker_is_flown_again(
    job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, losses: int, reason: str
) -> None:
    """The run is flown again up to three times, told once, and given up then."""
    client, halt = GoneClient(losses), Halt()
    monkeypatch.setattr(DaskCrew, "_connect", lambda self, *_: setattr(self, "_client", client))
    monkeypatch.setattr(DaskCrew, "_check_versions", lambda self, address: None)
    crew = DaskCrew(job, tmp_path, "tcp://127.0.0.1:1", 1, None, halt)
    told: list[Flown] = []
    crew.fly([Order(HandMade().plan(0, Point(values={}, labels={})))], told.append)
    halt.close()
    assert [flown.result.reason.startswith(reason) for flown in told] == [True]
    assert client.asked == min(losses, 3) + 1
