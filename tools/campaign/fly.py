"""Flies one run of a campaign and judges it. Whatever goes wrong on the way is its result, and no exception."""

from __future__ import annotations

import contextlib
import math
import os
import platform
import tempfile
import time
import traceback
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from bus.errors import HilsatError
from fsw.telemetry import SOURCE as FSW_SOURCE
from plant_server.truth import SOURCE as PLANT_SOURCE
from tools.campaign.job import IN_PROCESS, Job
from tools.campaign.kept_run import Keeper
from tools.campaign.metrics import list_signals, measure_run
from tools.campaign.plan import RunPlan
from tools.campaign.results import Judged, RunResult, Timing
from tools.config.expect import Expectation, expressions_of
from tools.config.scenario import Resolved
from tools.grading.expressions import name_signals
from tools.grading.grade import Grade, grade_run, to_json
from tools.grading.verdict import Verdict
from tools.log.mcap_reader import Run, read_run
from tools.log.mcap_writer import McapWriter
from tools.run.bench import Bench

FASTEST_RAD_S: Final = 1e6  # of a body: beyond that it is the arithmetic that turns
LONGEST_REASON: Final = 2000  # characters


@dataclass(frozen=True, slots=True)
class Flown:
    """What came of one run, what it cost, and what nobody needs unless it went wrong."""

    result: RunResult
    timing: Timing
    trace: str = ""  # traceback of what was not foreseen
    log: bytes | None = None  # a log that was made where the campaign's directory is not


class DivergedError(HilsatError):
    """The numbers of a run went beyond what can be computed with."""


class LateError(HilsatError):
    """A run took longer than it may."""


class Interruption(Exception):
    """A run was cut short by a signal; carries its number."""

    @property
    def number(self) -> int:
        """The signal's number."""
        return int(self.args[0])


def fly(job: Job, plan: RunPlan, log: Path | None = None, named: str = "", limit_s: float | None = None) -> Flown:
    """Fly one run and judge it.

    log     : where its log is to be; None: none is made. The file appears when the run has ended.
    named   : what the result calls the log
    limit_s : wall time after which it ends by itself, between two ticks; None: it goes on
    Raises Interruption where a signal cut it short.
    """
    wall_s, cpu_s, ticks, trace = time.perf_counter(), time.process_time(), 0, ""
    try:
        resolved = job.resolve(plan)
        ticks = resolved.ticks
        result = _fly(job, plan, resolved, log, named, None if limit_s is None else time.monotonic() + limit_s)
    except LateError:
        result = fail(plan, describe_late(limit_s))
    except HilsatError as error:
        result = fail(plan, str(error))
    except Exception as error:
        trace = "".join(traceback.format_exception(error))
        result = fail(plan, f"unforeseen {type(error).__name__}: {error}")
    wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    worker = f"{platform.node()}:{os.getpid()}"
    return Flown(result, Timing(number=plan.number, wall_s=wall_s, cpu_s=cpu_s, ticks=ticks, worker=worker), trace)


def fly_for_bytes(job: Job, plan: RunPlan, named: str = "", limit_s: float | None = None) -> Flown:
    """The same where the campaign's directory is out of reach: the log comes back with the result; none if not `named`."""
    if not named:
        return fly(job, plan, limit_s=limit_s)
    with tempfile.TemporaryDirectory(prefix="hilsat-campaign-", ignore_cleanup_errors=True) as directory:
        path = Path(directory) / "run.mcap"
        flown = fly(job, plan, path, named, limit_s)
        data = path.read_bytes() if path.is_file() else None
    return Flown(flown.result, flown.timing, flown.trace, data)


def describe_late(limit_s: float | None) -> str:
    """What is said of a run that took too long."""
    return f"the run took more than {limit_s or 0.0:g} s of wall time and was ended; see --limit"


def _fly(job: Job, plan: RunPlan, resolved: Resolved, log: Path | None, named: str, until_s: float | None) -> RunResult:
    more = job.more.get(plan.base, ())
    if job.clock != IN_PROCESS:
        return _fly_processes(job, plan, resolved, log, named)
    if log is None:
        return judge_run(job, plan, keep_run(resolved, list_wanted(job, resolved, more), until_s), resolved)
    part = log.with_name(f".{log.name}.part")
    with contextlib.suppress(FileNotFoundError):
        part.unlink()
    try:
        with Bench(resolved, log=part) as bench:
            step_to_end(bench, until_s)
            bench.close("done")
        result = judge_log(job, plan, part, resolved, named)
        os.replace(part, log)
    finally:
        with contextlib.suppress(OSError):
            part.unlink()
    return result


def _fly_processes(job: Job, plan: RunPlan, resolved: Resolved, log: Path | None, named: str) -> RunResult:
    """In processes of its own, over a bus: from the log that they leave."""
    from tools.run.runner import run_processes

    with tempfile.TemporaryDirectory(prefix="hilsat-campaign-", ignore_cleanup_errors=True) as directory:
        report = run_processes(resolved, Path(directory), lambda tick: None)
        if report.exit_code > 128:
            raise Interruption(report.exit_code - 128)
        if report.exit_code:
            return fail(plan, "; ".join(report.problems) or f"the run ended with exit code {report.exit_code}")
        result = judge_log(job, plan, report.log, resolved, named if log is not None else "")
        if log is not None:
            _move(report.log, log)
    return result


def _move(source: Path, target: Path) -> None:
    """Put a file in its place, from another file system too; it is there whole or not at all."""
    import shutil

    part = target.with_name(f".{target.name}.part")
    shutil.copyfile(source, part)
    os.replace(part, target)


def keep_run(resolved: Resolved, wanted: Iterable[tuple[str, str]], until_s: float | None = None) -> Run:
    """Fly a scenario in this process; return what was wanted of it (topic and field of each signal)."""
    keeper = Keeper(wanted)
    with Bench(resolved, keeper.link(PLANT_SOURCE), keeper.link(FSW_SOURCE)) as bench:
        step_to_end(bench, until_s)
        bench.close("done")
    return keeper.finish(resolved.scenario.name)


def step_to_end(bench: Bench, until_s: float | None = None) -> None:
    """Run all ticks.

    until_s : of the monotonic clock: when to give up; None: never
    Raises DivergedError where body and wheels go beyond what can be computed with, LateError where it took too long.
    """

    def look(tick: int) -> None:
        if until_s is not None and time.monotonic() >= until_s:
            raise LateError

    try:
        bench.step(bench.ticks - bench.tick, None if until_s is None else look)
    except (ArithmeticError, ValueError) as error:
        if is_sound(bench):
            raise
        raise DivergedError(f"the run diverged: {error} at tick {bench.tick}, t = {bench.t_s:g} s") from error
    if not is_sound(bench):
        raise DivergedError(f"the run diverged: at its end, t = {bench.t_s:g} s, attitude or rate is not a number")


def is_sound(bench: Bench) -> bool:
    """Whether attitude, rate and momentum are numbers, and the rate one that a body can have."""
    truth = bench.truth
    numbers = (*truth.q_ib, *truth.omega_bi_b_rad_s, *truth.h_total_i_nms, *truth.speed_rad_s)
    return all(map(math.isfinite, numbers)) and max(map(abs, truth.omega_bi_b_rad_s)) < FASTEST_RAD_S


def list_wanted(job: Job, resolved: Resolved, more: Iterable[Expectation]) -> list[tuple[str, str]]:
    """Topic and field of every signal that requirements and metrics name."""
    items = (*resolved.scenario.expect, *more)
    words = [expression for item in items for expression in expressions_of(item)]
    return [*(name for expression in words for name in name_signals(expression)), *list_signals(job.metrics)]


def judge_log(job: Job, plan: RunPlan, path: Path, resolved: Resolved, named: str) -> RunResult:
    """What came of a run, from its log, which gets its grade as an attachment. named: what the result calls the log."""
    run = read_run(path)
    grade = grade_run(run, resolved, job.more.get(plan.base, ()))
    result = make_result(plan, grade, measure_run(run, job.metrics), run.digest() if named else "", named)
    writer = McapWriter.resume(path)
    writer.add_attachment("grade.json", "application/json", to_json(grade).encode())
    writer.close()
    return result


def judge_run(job: Job, plan: RunPlan, run: Run, resolved: Resolved) -> RunResult:
    """What came of a run that was kept in memory."""
    return make_result(plan, grade_run(run, resolved, job.more.get(plan.base, ())), measure_run(run, job.metrics))


def make_result(
    plan: RunPlan, grade: Grade, metrics: dict[str, float | None], digest: str = "", log: str = ""
) -> RunResult:
    """The result of a run that was judged."""
    return RunResult(
        number=plan.number, values=plan.point.values, labels=plan.point.labels, repeat=plan.point.repeat, base=plan.base,
        overrides=plan.overrides, seed=plan.seed, outcome=grade.outcome,
        reason=_explain(grade),
        verdicts=tuple(map(_note, grade.verdicts)), metrics=metrics, digest=digest, log=log,
    )  # fmt: skip


def _explain(grade: Grade) -> str:
    """What the verdicts do not say of an outcome."""
    if not grade.complete:
        return "the run did not go to its end"
    return "" if grade.required else "nothing is required of it: the scenario expects nothing and has no faults"


def fail(plan: RunPlan, reason: str) -> RunResult:
    """The result of a run that could not be flown or judged."""
    return RunResult(
        number=plan.number, values=plan.point.values, labels=plan.point.labels, repeat=plan.point.repeat, base=plan.base,
        overrides=plan.overrides, seed=plan.seed, outcome="infra", reason=reason[:LONGEST_REASON],
    )  # fmt: skip


def _note(verdict: Verdict) -> Judged:
    return Judged(
        name=verdict.name, outcome=verdict.outcome, value=_finite(verdict.value), margin=_finite(verdict.margin),
        id=verdict.id, bound=verdict.bound, unit=verdict.unit, detail=verdict.detail,
    )  # fmt: skip


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None
