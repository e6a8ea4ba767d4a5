"""The flights of a shootout: each pair in a bench of its own, one after the other or in several processes."""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import signal
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from bus.errors import HilsatError, UsageError
from bus.process import Interrupted
from bus.trace import describe_unforeseen
from tools.run.bench import Bench
from tools.shootout.figures import Figures, Series, find_figures, list_unknown, read_series
from tools.shootout.pairs import Contest, Pair

FLEW, REFUSED, FAILED, NOT_FLOWN = "flew", "refused", "failed", "not flown"
MOST_POINTS: Final = 1500  # of an error curve; more cannot be seen
Curve = tuple[tuple[float, ...], tuple[float, ...]]  # times [s] and errors [deg]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of one pair."""

    pair: Pair
    state: str  # FLEW; REFUSED: its settings cannot be flown; FAILED on the way; NOT_FLOWN: cut short before its end
    reason: str = ""  # why it did not fly
    observer: str = ""  # kinds that flew with it
    wheel_health: str = ""
    figures: Figures | None = None
    curve: Curve = ((), ())


class _Stopped(Exception):
    """The shootout is being cut short."""


def fly(contest: Contest, pair: Pair, on_progress: Callable[[int], None] = lambda tick: None) -> Outcome:
    """Fly one pair. What it cannot be flown with, and what fails on the way, is its outcome and no exception."""
    outcome = Outcome(pair, REFUSED)
    try:
        resolved = contest.load(pair)
        fsw = resolved.scenario.fsw
        outcome = replace(outcome, state=FAILED, observer=fsw.observer.kind, wheel_health=fsw.wheel_health.kind)
        with Bench(resolved, log="memory") as bench:
            bench.step(resolved.ticks, on_progress)
            limits = bench.flight.vehicle.wheels.max_torque_nm
            series = read_series(bench.log, resolved.ticks * bench.tick_s, limits)
    except UsageError as error:
        return replace(outcome, state=REFUSED, reason=str(error))
    except HilsatError as error:
        return replace(outcome, reason=str(error))
    except _Stopped:
        return replace(outcome, state=NOT_FLOWN)
    except Exception as error:
        return replace(outcome, reason=describe_unforeseen("hilsat shootout", error))
    figures = find_figures(series)
    if unknown := list_unknown(figures):
        return replace(outcome, reason=f"no number: {', '.join(unknown)}")
    return replace(outcome, state=FLEW, figures=figures, curve=_thin(series))


def _thin(series: Series) -> Curve:
    step = max(1, math.ceil(series.t_s.size / MOST_POINTS))
    known = np.nan_to_num(series.error_deg[::step], nan=180.0)
    return tuple(series.t_s[::step].tolist()), tuple(known.tolist())


def fly_all(
    contest: Contest, pairs: Sequence[Pair], jobs: int, on_outcome: Callable[[Outcome], None]
) -> tuple[list[Outcome], int]:
    """Fly all pairs, `jobs` at a time; return what came of each, in their order, and the number of the signal that came.

    on_outcome : called as each is done, in whatever order that is
    A signal (or Ctrl-C) cuts the shootout short: what is done stays, the rest is NOT_FLOWN. 0: none came.
    """
    done: dict[Pair, Outcome] = {}
    number = 0
    try:
        with contextlib.closing(
            _fly_here(contest, pairs) if jobs == 1 else _fly_apart(contest, pairs, jobs)
        ) as flights:
            for outcome in flights:
                done[outcome.pair] = outcome
                on_outcome(outcome)
    except KeyboardInterrupt as stop:
        number = stop.number if isinstance(stop, Interrupted) else signal.SIGINT
    return [done.get(pair, Outcome(pair, NOT_FLOWN)) for pair in pairs], number


def _fly_here(contest: Contest, pairs: Sequence[Pair]) -> Generator[Outcome, None, None]:
    for pair in pairs:
        yield fly(contest, pair)


def _fly_apart(contest: Contest, pairs: Sequence[Pair], jobs: int) -> Generator[Outcome, None, None]:
    """In processes of their own, which the terminal's Ctrl-C does not reach: they stop when they are told."""
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    workers = min(jobs, len(pairs))
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(stop,)) as pool:
        waiting: dict[Future[Outcome], Pair] = {pool.submit(_fly_there, contest, pair): pair for pair in pairs}
        try:
            while waiting:
                for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                    yield _take(future, waiting.pop(future))
        finally:
            stop.set()
            pool.shutdown(cancel_futures=True)


def _take(future: Future[Outcome], pair: Pair) -> Outcome:
    try:
        return future.result()
    except BrokenProcessPool:
        return Outcome(pair, FAILED, "a process of the shootout was ended from outside")


_stop: Any = None  # of this process: the event that says that the shootout is being cut short


def _begin(stop: Any) -> None:
    global _stop
    _stop = stop
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _fly_there(contest: Contest, pair: Pair) -> Outcome:
    return fly(contest, pair, _look_up)


def _look_up(tick: int) -> None:
    if _stop.is_set():
        raise _Stopped
