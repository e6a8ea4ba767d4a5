"""Flies a campaign: asks its strategy for points, has them flown, keeps what comes, and stops as it is told.

Numbers are given in the order in which the strategy asks; it asks the same when it is answered the same. So a campaign gives
the same results whoever flies it, and one that was stopped goes on where it was.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol

from bus.errors import RecordError
from tools.campaign.chosen_logs import ALL, NONE, choose_logs
from tools.campaign.crew import Crew, Halt, Order
from tools.campaign.fly import Flown
from tools.campaign.job import IN_PROCESS, Job
from tools.campaign.keeping import TRACE_DIR, Store
from tools.campaign.plan import Point, RunPlan, Strategy
from tools.campaign.progress import Progress
from tools.campaign.results import LOG_DIR, RunResult

OTHERWISE: Final = (
    "flown again for its log, it came out otherwise: this machine does not repeat runs (see hilsat verify)"
)


class Planner(Protocol):
    """What is asked of a campaign while it is flown."""

    @property
    def runs(self) -> int | None:
        """Number of planned runs; None: the strategy decides."""

    def plan(self, number: int, point: Point) -> RunPlan:
        """The run of this number at this point."""


class Halted(Exception):
    """The campaign was stopped by a signal."""


@dataclass(slots=True)
class Conclusion:
    """How a campaign ended."""

    counts: Counter[str] = field(default_factory=Counter)
    flown: int = 0  # now, not before
    signal: int = 0  # that stopped it
    logs: int = 0  # that were kept
    found: Mapping[str, Any] = field(default_factory=dict)

    @property
    def exit_code(self) -> int:
        """0 all passed; 1 some did not; 3 some could not be flown or judged; 130 or 143 stopped."""
        if self.signal:
            return 128 + self.signal
        if self.counts["infra"]:
            return 3
        return 0 if self.counts["pass"] and not self.counts["fail"] and not self.counts["not executed"] else 1


class Engine:
    """One campaign on its way."""

    def __init__(
        self, planner: Planner, job: Job, store: Store, crew: Crew, halt: Halt, progress: Progress, keep_logs: str
    ) -> None:
        self._planner, self._job, self._store, self._crew = planner, job, store, crew
        self._halt, self._progress, self._keep_logs = halt, progress, keep_logs
        self._next = 0
        self.conclusion = Conclusion()
        # A run that cannot be repeated to the bit has its log made when it is flown, and lost where it is not wanted.
        self._logs_first = keep_logs == ALL or (keep_logs != NONE and job.clock != IN_PROCESS)

    def run(self, strategy: Strategy) -> Conclusion:
        """Fly all that the strategy asks for. Raises RecordError when results cannot be written."""
        conclusion = self.conclusion
        self._progress.expect(self._planner.runs, len(self._store.results))
        try:
            conclusion.found = dict(strategy.run(self.evaluate))
            if conclusion.found:
                self._store.write_found(conclusion.found)
            self._keep_chosen()
        except Halted:
            conclusion.signal = self._halt.number
        conclusion.counts = Counter(result.outcome for result in self._store.results.values())
        conclusion.logs = sum(bool(result.log) for result in self._store.results.values())
        if self._store.traces:
            place = self._store.directory / TRACE_DIR
            self._progress.say(f"{self._store.traces} runs ended in what nobody foresaw; please report it: {place}")
        return conclusion

    def evaluate(self, points: Sequence[Point]) -> list[RunResult]:
        """Fly these points, but those that were flown before; see tools.campaign.plan.Evaluate."""
        plans = [self._planner.plan(self._next + place, point) for place, point in enumerate(points)]
        self._next += len(plans)
        missing = [plan for plan in plans if self._store.find(plan) is None]
        self._fly([Order(plan, _name_log(plan.number) if self._logs_first else "") for plan in missing], self._take)
        return [self._store.results[plan.number] for plan in plans]

    def _fly(self, orders: Sequence[Order], on_done: Callable[[Flown], None]) -> None:
        done = 0

        def count(flown: Flown) -> None:
            nonlocal done
            done += 1
            on_done(flown)

        if orders and not self._halt.asked:
            self._crew.fly(orders, count)
        if done < len(orders):
            raise Halted

    def _take(self, flown: Flown) -> None:
        self._store.add(flown)
        self.conclusion.flown += 1
        self._progress.note(flown.result)

    # -- logs ------------------------------------------------------------------------------------------------------

    def _keep_chosen(self) -> None:
        """Have the logs that are to be kept, and no others."""
        results = self._store.results
        chosen = choose_logs(self._keep_logs, results)
        for number in sorted(number for number, result in results.items() if result.log and number not in chosen):
            self._drop_log(results[number])
        missing = [results[number] for number in sorted(chosen) if not self._has_log(results[number])]
        if not missing:
            return
        if self._job.clock != IN_PROCESS:
            self._progress.say(f"{len(missing)} runs have no log: on this clock they cannot be flown again alike")
            return
        plans = [
            RunPlan(
                number=result.number,
                point=Point(values=result.values, labels=result.labels, repeat=result.repeat),
                base=result.base,
                overrides=tuple(result.overrides),
                seed=result.seed,
            )
            for result in missing
        ]
        self._fly([Order(plan, _name_log(plan.number)) for plan in plans], self._take_log)

    def _take_log(self, flown: Flown) -> None:
        """A run was flown again for its log: it must have come out as it did."""
        before, now = self._store.results[flown.result.number], flown.result
        if now.outcome == "infra":
            self._progress.say(f"run {now.number}: no log: {now.reason}")
        elif dataclasses.replace(now, digest=before.digest, log=before.log) != before:
            self._store.add(
                dataclasses.replace(flown, result=dataclasses.replace(now, outcome="infra", reason=OTHERWISE))
            )
        else:
            self._store.add(flown)

    def _has_log(self, result: RunResult) -> bool:
        return bool(result.log) and (self._store.directory / result.log).is_file()

    def _drop_log(self, result: RunResult) -> None:
        with contextlib.suppress(FileNotFoundError):
            try:
                (self._store.directory / result.log).unlink()
            except OSError as error:
                if not isinstance(error, FileNotFoundError):
                    raise RecordError(f"{result.log}: cannot be removed: {error.strerror}") from None
        self._store.replace(dataclasses.replace(result, log="", digest=""))


def _name_log(number: int) -> str:
    return f"{number:06d}.mcap"


def log_place(directory: Path, number: int) -> Path:
    """Where the log of a run is, if it was kept."""
    return directory / LOG_DIR / _name_log(number)
