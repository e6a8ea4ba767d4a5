"""The engine of campaigns: the same results whoever flies, and none lost whatever happens on the way."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import resource
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from bus.errors import RecordError, UsageError
from tools.campaign.chosen_logs import check_keeping, choose_logs, rank_worst
from tools.campaign.crew import Halt, Order
from tools.campaign.engine import Conclusion
from tools.campaign.fly import Flown, fly
from tools.campaign.job import Job, Metric, make_job
from tools.campaign.keeping import Store, lock
from tools.campaign.launch import Options, fly_campaign
from tools.campaign.plan import Point, RunPlan, derive_seed
from tools.campaign.pool import Pool, Solo
from tools.campaign.progress import Lines, Silence
from tools.campaign.results import Judged, RunResult, read_info, read_results, read_timings
from tools.campaign.strategies.settings import PlanSettings
from tools.log.mcap_reader import read_run
from tools.run.bench import Bench

BASE = "zhang2018-flight"
PLAN = PlanSettings()
COMMON = (
    "duration_s=1",
    "faults=[]",
    "expect=[{name: rate, check: below, signal: norm(fsw.attitude.omega_bi_b_hat_rad_s), bound: 0.010335, unit: rad/s}]",
)
ENDLESS = ("duration_s=100000", "faults=[]", "expect=[]")
METRICS = {"effort": Metric(statistic="integral", signal="norm(fsw.control.tau_cmd_b_nm)", unit="N m s")}


@dataclasses.dataclass
class HandMade:
    """A campaign without a file: so many runs, `odd` has the overrides of those that are not like the others."""

    runs: int | None = 6
    seed: int = 7
    odd: dict[int, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    name: str = "hand-made"
    title: str = "made by hand"
    text: str = "name: hand-made\n"
    bases: tuple[str, ...] = (BASE,)
    axes: tuple[Any, ...] = ()
    keep_logs: str = "none"
    limit_s: float | None = None
    metrics: Any = ()
    strategy: Any = PLAN

    def points(self) -> list[Point]:
        return [Point(values={"case": case}, labels={"case": str(case)}) for case in range(self.runs or 0)]

    def plan(self, number: int, point: Point) -> RunPlan:
        words = self.odd.get(number, COMMON)
        return RunPlan(number=number, point=point, base=BASE, overrides=words, seed=derive_seed(self.seed, number))


@pytest.fixture(scope="module")
def job() -> Job:
    return make_job("hand-made", [BASE], metrics=METRICS)


def fly_all(campaign: HandMade, job: Job, out: Path, jobs: int = 2, resume: bool = False, **options: Any) -> Conclusion:
    return fly_campaign(campaign, job, out, Options(jobs=jobs, **options), Silence(), resume=resume)


def fly_here(job: Job, directory: Path, jobs: int, limit_s: float | None, halt: Halt) -> Solo:
    """In place of a pool: for what has nothing to do with workers, whose start takes a second."""
    return Solo(job, directory, halt)


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs are flown in this process."""
    monkeypatch.setattr("tools.campaign.launch.Pool", fly_here)


@pytest.fixture(scope="module")
def whole(job: Job, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The directory of an undisturbed campaign, flown without workers."""
    out = tmp_path_factory.mktemp("whole") / "campaign"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tools.campaign.launch.Pool", fly_here)
        fly_all(HandMade(), job, out)
    return out


@pytest.mark.parametrize("jobs", [2, pytest.param(1, marks=pytest.mark.slow), pytest.param(4, marks=pytest.mark.slow)])
def test_same_results_whatever_the_number_of_workers(job: Job, whole: Path, tmp_path: Path, jobs: int) -> None:
    """1, 2 and 4 workers write the same bytes as this process alone, and each run is what it is when it is flown alone."""
    fly_all(HandMade(), job, tmp_path / "out", jobs)
    assert (tmp_path / "out/results.jsonl").read_bytes() == (whole / "results.jsonl").read_bytes()
    results = read_results(whole)
    assert [result.number for result in results] == list(range(6))
    assert len({result.seed for result in results}) == 6
    campaign = HandMade()
    alone = fly(job, campaign.plan(4, campaign.points()[4])).result
    assert results[4] == alone
    assert len({result.metrics["effort"] for result in results}) == 6  # noise of their own
    assert all(result.metrics["effort"] for result in results)
    assert sorted(timing.number for timing in read_timings(whole)) == list(range(6))
    assert json.loads((whole / "campaign.json").read_text())["provenance"]["build"]


@pytest.mark.usefixtures("here")
def test_a_run_that_cannot_be_flown_costs_itself_alone(job: Job, tmp_path: Path) -> None:
    """Settings that are wrong, and numbers that diverge, are INFRA with the reason; the others are judged."""
    diverging = (*COMMON, "plant.body.inertia_kgm2=[[1e-9,0,0],[0,1e-9,0],[0,0,1e-9]]")
    campaign = HandMade(odd={1: ("duration_s=-1",), 3: diverging})
    conclusion = fly_all(campaign, job, tmp_path / "out", keep_logs="all")
    results = read_results(tmp_path / "out")
    assert results[1].outcome == results[3].outcome == "infra"
    assert "duration_s" in results[1].reason
    assert "diverged" in results[3].reason
    assert {results[n].outcome for n in (0, 2, 4, 5)} <= {"pass", "fail"}
    assert conclusion.exit_code == 3
    assert sorted(path.name for path in (tmp_path / "out/logs").iterdir()) == [f"{n:06d}.mcap" for n in (0, 2, 4, 5)]


def _while_flying(out: Path, act: Callable[[list[int]], None], pool_of: list[Pool]) -> threading.Thread:
    """Do something to the workers once the campaign has begun."""

    def wait() -> None:
        until = time.monotonic() + 30.0
        while time.monotonic() < until:
            results = out / "results.jsonl"
            if pool_of and results.is_file() and results.stat().st_size:
                act(pool_of[0].pids)
                return
            time.sleep(0.01)

    thread = threading.Thread(target=wait)
    thread.start()
    return thread


@pytest.fixture
def pools(monkeypatch: pytest.MonkeyPatch) -> list[Pool]:
    """The pools that are made, so that a test can get at their processes."""
    made: list[Pool] = []
    begin_pool = Pool.__init__

    def note(self: Pool, *args: Any) -> None:
        begin_pool(self, *args)
        made.append(self)

    monkeypatch.setattr(Pool, "__init__", note)
    return made


def test_a_killed_worker_costs_the_run_it_had(job: Job, tmp_path: Path, pools: list[Pool]) -> None:
    """SIGKILL from outside: the run that never ends is INFRA and says who ended it; all others are there, once, with their
    logs, and nothing is left of its own.
    """
    out = tmp_path / "out"

    def kill_who_hangs(pids: list[int]) -> None:
        until = time.monotonic() + 30.0
        while time.monotonic() < until and len(read_results(out)) < 5:
            time.sleep(0.05)
        for worker in pools[0]._workers:
            if worker.orders:
                os.kill(worker.popen.pid, signal.SIGKILL)

    thread = _while_flying(out, kill_who_hangs, pools)
    conclusion = fly_all(HandMade(odd={0: ENDLESS}), job, out, keep_logs="all")
    thread.join()
    results = read_results(out)
    assert [result.number for result in results] == list(range(6))
    assert results[0].outcome == "infra"
    assert "SIGKILL" in results[0].reason
    assert all(result.outcome != "infra" for result in results[1:])
    assert (out / "results.jsonl").read_text().count("\n") == 6
    assert sorted(path.name for path in (out / "logs").iterdir()) == [f"{number:06d}.mcap" for number in range(1, 6)]
    assert conclusion.exit_code == 3


def test_a_run_that_hangs_is_ended(job: Job, whole: Path, tmp_path: Path) -> None:
    """A run that takes longer than the limit is INFRA; the rest is as it would be without it."""
    out = tmp_path / "out"
    fly_all(HandMade(odd={2: ENDLESS}), job, out, jobs=1, limit_s=1.5)
    results = read_results(out)
    assert results[2].outcome == "infra"
    assert "more than 1.5 s" in results[2].reason
    undisturbed = read_results(whole)
    assert [results[n] for n in (0, 1, 3, 4, 5)] == [undisturbed[n] for n in (0, 1, 3, 4, 5)]


class Stopping(Silence):
    """Has the campaign stopped as a terminal would, after so many runs."""

    def __init__(self, after: int, number: int = signal.SIGINT) -> None:
        self.left, self.number = after, number

    def note(self, result: RunResult) -> None:
        self.left -= 1
        if not self.left:
            os.kill(os.getpid(), self.number)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.usefixtures("here")
def test_stopped_and_gone_on_with(job: Job, whole: Path, tmp_path: Path, number: int) -> None:
    """Stopped after two runs and gone on with: nothing is flown twice, and the results are those of an undisturbed one."""
    out, campaign = tmp_path / "out", HandMade()
    conclusion = fly_campaign(campaign, job, out, Options(jobs=2), Stopping(2, number))
    assert conclusion.exit_code == 128 + number
    before = read_results(out)
    assert 2 <= len(before) < 6
    with open(out / "results.jsonl", "ab") as file:
        file.write(b'{"number":5,"val')  # what a kill leaves of a line
    rest = fly_all(campaign, job, out, resume=True)
    assert rest.flown == 6 - len(before)
    assert (out / "results.jsonl").read_bytes() == (whole / "results.jsonl").read_bytes()
    again = fly_all(campaign, job, out, resume=True)
    assert again.flown == 0
    assert again.counts == rest.counts
    assert len(read_timings(out)) == 6


@pytest.mark.usefixtures("here")
def test_what_could_not_be_flown_is_tried_again_when_asked(job: Job, tmp_path: Path) -> None:
    """Going on leaves an INFRA run as it is; with `retry` it is flown again, and it alone."""
    out, campaign = tmp_path / "out", HandMade(runs=3, odd={1: ("duration_s=-1",)})
    fly_all(campaign, job, out)
    assert fly_all(campaign, job, out, resume=True).flown == 0
    assert fly_all(campaign, job, out, resume=True, retry=True).flown == 1


@pytest.mark.parametrize(
    ("change", "word"),
    [({"seed": 8}, "seed"), ({"text": "name: other\n"}, "text of its file"), ({"name": "other"}, "name")],
)
@pytest.mark.usefixtures("here")
def test_another_campaign_is_not_gone_on_with(job: Job, whole: Path, change: dict[str, Any], word: str) -> None:
    """Seed, text and name are those of what was begun, or the campaign is refused and what differs is named."""
    before = (whole / "results.jsonl").read_bytes()
    with pytest.raises(UsageError, match=word):
        fly_all(dataclasses.replace(HandMade(), **change), job, whole, resume=True)
    assert (whole / "results.jsonl").read_bytes() == before


@pytest.mark.usefixtures("here")
def test_a_base_that_has_changed_is_refused(job: Job, whole: Path) -> None:
    """The scenario that is flown now is the one that was flown then."""
    other = dataclasses.replace(job, bases={BASE: job.bases[BASE] + "# more\n"})
    with pytest.raises(UsageError, match=f"text of {BASE}"):
        fly_all(HandMade(), other, whole, resume=True)


@pytest.mark.usefixtures("here")
def test_other_runs_under_the_same_numbers_are_refused(job: Job, whole: Path) -> None:
    """A plan that comes out otherwise than it did is found out, run by run."""
    with pytest.raises(UsageError, match="run 3 was flown with other settings"):
        fly_all(HandMade(odd={3: ("duration_s=2",)}), job, whole, resume=True)


@pytest.mark.usefixtures("here")
def test_one_process_at_a_time(job: Job, tmp_path: Path) -> None:
    """A directory that somebody flies into is refused to a second one, and free again when the first is gone."""
    out, campaign = tmp_path / "out", HandMade(runs=1)
    fly_all(campaign, job, out)
    child = os.fork()
    if not child:
        with lock(out):
            (tmp_path / "locked").touch()
            time.sleep(60.0)
    while not (tmp_path / "locked").exists():
        time.sleep(0.01)
    try:
        with pytest.raises(UsageError, match="another process"):
            fly_all(campaign, job, out, resume=True)
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    assert fly_all(campaign, job, out, resume=True).flown == 0


@pytest.mark.usefixtures("here")
def test_a_directory_with_something_in_it_is_left_alone(job: Job, tmp_path: Path) -> None:
    """Neither a campaign nor anything else is written over."""
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(UsageError, match="not empty"):
        fly_all(HandMade(), job, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    fly_all(HandMade(runs=1), job, tmp_path / "new")
    with pytest.raises(UsageError, match="--resume"):
        fly_all(HandMade(runs=1), job, tmp_path / "new")


@contextlib.contextmanager
def largest_file(size: int) -> Iterator[None]:
    """No file of this process may grow beyond that: what a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.usefixtures("here")
def test_a_disk_that_is_full_stops_the_campaign_and_loses_nothing(job: Job, whole: Path, tmp_path: Path) -> None:
    """Results that cannot be written end it with words; what is on the disk stays whole, and is gone on with."""
    out = tmp_path / "out"
    size = (whole / "results.jsonl").stat().st_size
    limit = max(path.stat().st_size for path in whole.glob("*.json*")) + 100
    campaign = HandMade(runs=limit // (size // 6) + 4)
    with largest_file(limit), pytest.raises(RecordError, match="--resume"):
        fly_all(campaign, job, out, jobs=1)
    kept = read_results(out)
    assert 0 < len(kept) < (campaign.runs or 0)
    assert (out / "results.jsonl").read_bytes().endswith(b"\n")
    fly_all(campaign, job, out, resume=True)
    assert read_results(out)[: len(kept)] == kept
    assert len(read_results(out)) == campaign.runs


@pytest.mark.usefixtures("here")
def test_a_log_that_has_no_room_costs_its_run(job: Job, tmp_path: Path) -> None:
    """A log that cannot be written makes that run INFRA with the reason, and leaves no half of it behind."""
    out = tmp_path / "out"
    with largest_file(60_000):
        conclusion = fly_all(HandMade(runs=2), job, out, keep_logs="all")
    assert conclusion.counts["infra"] == 2
    assert "File too large" in read_results(out)[0].reason
    assert list((out / "logs").iterdir()) == []


@pytest.mark.parametrize(("keep", "kept"), [("failures", "fails"), ("worst 2", "worst"), ("all", "all")])
@pytest.mark.usefixtures("here")
def test_logs_that_are_kept(job: Job, whole: Path, tmp_path: Path, keep: str, kept: str) -> None:
    """Those that were asked for are there; each has the digest of the same run flown by hand; all else is as without."""
    out, undisturbed = tmp_path / "out", read_results(whole)
    fly_all(HandMade(), job, out, keep_logs=keep)
    results = read_results(out)
    fails = [result.number for result in undisturbed if result.outcome == "fail"]
    assert 0 < len(fails) < 6
    margins = sorted(undisturbed, key=lambda result: result.verdicts[0].margin or 0.0)
    wanted = {"fails": fails, "worst": sorted(result.number for result in margins[:2]), "all": list(range(6))}[kept]
    assert [result.number for result in results if result.log] == wanted
    assert sorted(path.name for path in (out / "logs").iterdir()) == [f"{number:06d}.mcap" for number in wanted]
    assert [dataclasses.replace(result, log="", digest="") for result in results] == undisturbed
    first = results[wanted[0]]
    with Bench.open(BASE, [*COMMON, f"seed={first.seed}", "clock.mode=inprocess"], log="memory") as bench:
        bench.run_to_end()
        assert first.digest == bench.log.digest()
    assert read_run(out / first.log).digest() == first.digest
    assert fly_all(HandMade(), job, out, resume=True, keep_logs=keep).flown == 0


@pytest.mark.usefixtures("here")
def test_a_run_that_does_not_repeat_is_found_out(job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Flown again for its log and come out otherwise: that run is INFRA and says so, however it came out first."""
    counter = iter(range(100))
    monkeypatch.setattr("tools.campaign.fly.measure_run", lambda run, metrics: {"effort": float(next(counter))})
    out = tmp_path / "out"
    conclusion = fly_all(HandMade(runs=3), job, out, keep_logs="worst 1")
    assert conclusion.exit_code == 3
    assert conclusion.counts["infra"] == 1
    assert next(result for result in read_results(out) if result.outcome == "infra").reason.startswith("flown again")


def make_result(number: int, outcome: Any, *margins: float) -> RunResult:
    verdicts = tuple(
        Judged(name=f"r{place}", outcome="pass", value=0.0, margin=margin) for place, margin in enumerate(margins)
    )
    return RunResult(
        number=number, values={}, labels={}, repeat=0, base="", overrides=(), seed=0, outcome=outcome, verdicts=verdicts
    )


def test_worst_first() -> None:
    """Fails come first; margins count by the usual size of their requirement's; one that never changes counts nothing."""
    runs = [
        make_result(0, "pass", 5.0, 1000.0, 0.0),
        make_result(1, "pass", 4.0, 100.0, 0.0),  # a tenth of what is usual, where 4 is nearly all of it
        make_result(2, "fail", 6.0, 1000.0, 0.0),
        make_result(3, "pass", 1.0, 1000.0, 0.0),
        make_result(4, "infra"),
    ]
    assert [result.number for result in rank_worst(runs)][:4] == [2, 1, 3, 0]
    assert choose_logs("worst 1", {result.number: result for result in runs}) == {2}
    assert choose_logs("failures", {result.number: result for result in runs}) == {2}


def test_words_for_logs() -> None:
    """What is understood, and what is refused with what there is."""
    assert check_keeping("worst=10") == "worst 10"
    for words in ("worst 0", "worst", "some", ""):
        with pytest.raises(UsageError, match="failures"):
            check_keeping(words)


def test_exit_codes() -> None:
    """0 only when something was flown and all of it passed."""

    def code(**counts: int) -> int:
        conclusion = Conclusion()
        conclusion.counts.update({name.replace("_", " "): count for name, count in counts.items()})
        return conclusion.exit_code

    assert code(**{"pass": 3}) == 0
    assert code() == 1
    assert code(**{"pass": 3}, fail=1) == 1
    assert code(**{"pass": 3}, not_executed=1) == 1
    assert code(**{"pass": 3}, fail=1, infra=1) == 3


@pytest.mark.usefixtures("here")
def test_a_strategy_is_answered_in_its_order(job: Job, tmp_path: Path) -> None:
    """Batches are numbered as they are asked for, and answered in the order of their points, whoever was ready first."""
    campaign = HandMade(runs=None)
    asked: list[list[Any]] = []

    class InBatches:
        def run(self, evaluate: Callable[[Sequence[Point]], list[RunResult]]) -> dict[str, Any]:
            for first in (0, 3):
                points = [Point(values={"case": first + k}, labels={}) for k in range(3)]
                asked.append([result.values["case"] for result in evaluate(points)])
            return {"batches": 2}

    out = tmp_path / "out"
    conclusion = fly_campaign(campaign, job, out, Options(jobs=2), Silence(), InBatches())
    assert asked == [[0, 1, 2], [3, 4, 5]]
    assert [result.values["case"] for result in read_results(out)] == list(range(6))
    assert conclusion.found == json.loads((out / "found.json").read_text()) == {"batches": 2}
    assert read_info(out).runs is None


def test_workers_that_cannot_start_are_told_of(job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no worker comes up the campaign ends with their last words, and does not try for ever."""
    monkeypatch.setenv("HILSAT_BUILD", "nonsense")
    with pytest.raises(RecordError, match="nonsense"):
        fly_all(HandMade(), job, tmp_path / "out", jobs=1)


@pytest.mark.usefixtures("here")
@pytest.mark.slow
def test_memory_of_a_worker_is_flat(job: Job, tmp_path: Path) -> None:
    """800 runs in one worker: once the collector of garbage has found its pace, in some 300, it grows by less than 4 MB.

    That is 10 kB a run. The allocator takes its memory in steps: one of 3 MB was seen.
    """
    halt, used = Halt(), []

    def note(flown: Flown) -> None:
        assert flown.result.outcome in ("pass", "fail")
        used.append(int(Path(f"/proc/{pool.pids[0]}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6)

    campaign = HandMade(runs=800)
    words = ("duration_s=0.1", *COMMON[1:])
    plans = [dataclasses.replace(campaign.plan(n, point), overrides=words) for n, point in enumerate(campaign.points())]
    pool = Pool(job, tmp_path, 1, None, halt)
    pool.fly([Order(plan) for plan in plans], note)
    pool.close()
    halt.close()
    assert len(used) == 800
    assert max(used[400:]) - used[400] < 4.0


def test_progress_in_a_file(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Lines for whoever reads them later: how many of how many, how fast, how long yet, and what came of them."""
    now_s = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now_s[0])
    lines = Lines()
    lines.expect(50, 10)
    for number in range(20):
        now_s[0] += 1.0
        lines.note(make_result(number, "fail" if number == 3 else "pass"))
    lines.close()
    said = capsys.readouterr().err.splitlines()
    assert said[0] == "  20 of 50 runs, 1/s, about 30 s left: 9 pass, 1 fail"
    assert said[1] == "  30 of 50 runs, 1/s, about 20 s left: 19 pass, 1 fail"
    assert len(said) == 2


def test_store_takes_the_last_of_a_number(tmp_path: Path, job: Job) -> None:
    """A result that was replaced is there once, in its place."""
    fly_all(HandMade(runs=2), job, tmp_path / "out")
    with Store.open(tmp_path / "out") as store:
        store.replace(dataclasses.replace(store.results[0], reason="replaced"))
    results = read_results(tmp_path / "out")
    assert [result.reason for result in results] == ["replaced", ""]
    assert (tmp_path / "out/results.jsonl").read_text().count("\n") == 2


def test_a_halt_is_urgent_the_second_time() -> None:
    """The first SIGINT lets runs end; a second one, or a SIGTERM, does not."""
    for signals, urgent in (([2], False), ([2, 2], True), ([15], True)):
        halt = Halt()
        for number in signals:
            halt.ask(number)
        assert halt.asked
        assert halt.urgent is urgent
        assert halt.number == signals[0]
        halt.close()
