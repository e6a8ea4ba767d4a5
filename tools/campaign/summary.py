"""A campaign's results as tables and reports need them: counted by requirement, by cell and by axis, worst runs first."""

from __future__ import annotations

import gc
import json
import shlex
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from bus.errors import RecordError, UsageError
from bus.words import suggest
from tools.campaign.results import (
    FOUND_FILE,
    OUTCOMES,
    AxisInfo,
    CampaignInfo,
    Judged,
    Outcome,
    RunResult,
    read_info,
    read_results,
)
from tools.campaign.statistics import Tally
from tools.campaign.strategies.answers import find_scales, smallest_margin, tally_outcomes
from tools.campaign.strategies.settings import OUTCOME

WORDS: Final[dict[Outcome, str]] = {
    "pass": "PASS", "fail": "FAIL", "not executed": "NOT EXECUTED", "infra": "INFRA",
}  # fmt: skip
BITTEN: Final = (
    "fault took effect: "  # how the verdicts on the faults themselves begin, each with its own unit and kind
)
BITTEN_ALL: Final = "faults took effect"
MOST_CELLS: Final = 10_000  # of a matrix: more is nobody's table
WORST_FIRST: Final = ("fail", "not executed", "pass", "infra")


@dataclass(frozen=True)
class Loaded:
    """A campaign's directory, read; what several tables need is counted once."""

    directory: Path
    info: CampaignInfo
    results: Sequence[RunResult]
    found: Mapping[str, Any]  # by its strategy
    outcomes: Sequence[Mapping[str, Outcome]]  # of each run: what came of each requirement

    @cached_property
    def tally(self) -> Tally:
        """Of the outcomes of the runs."""
        return tally_outcomes(result.outcome for result in self.results)

    @cached_property
    def worst_first(self) -> list[RunResult]:
        """All runs that were judged."""
        return rank_worst(self.results)

    @cached_property
    def requirements(self) -> list[Requirement]:
        """Every requirement that any run was judged by, in the order of their first appearance."""
        return list_requirements(self)

    @property
    def list_axes(self) -> tuple[AxisInfo, ...]:
        """The axes that cells are made of: those whose values are listed."""
        return tuple(axis for axis in self.info.axes if axis.labels)

    @property
    def missing(self) -> int:
        """Planned runs that have no result yet."""
        return max(0, (self.info.runs or 0) - len(self.results))

    def command(self, result: RunResult) -> str:
        """The command that repeats a run."""
        return f"hilsat run {_quote(f'{self.directory}#{result.number}')}"


def _quote(word: str) -> str:
    """The word for a shell, which leaves a # within a word alone."""
    return word if shlex.quote(word.replace("#", "")) == word.replace("#", "") else shlex.quote(word)


@dataclass(frozen=True, slots=True)
class Requirement:
    """What came of one requirement in all runs."""

    key: str  # its id, or its name
    name: str
    bounds: tuple[str, ...]  # in words; several where it differs from run to run
    unit: str
    tally: Tally
    smallest: float | None  # margin
    worst: RunResult | None  # the run that has it

    @property
    def title(self) -> str:
        """Name of the requirement behind its id."""
        return f"{self.key} {self.name}" if self.key != self.name else self.name


@dataclass(frozen=True, slots=True)
class Cell:
    """The runs that have the same values on the axes of a matrix."""

    tally: Tally
    worst: RunResult | None  # the one to look at first; None without a run

    @property
    def outcome(self) -> Outcome:
        """The worst that came of them; infra when not one could be judged."""
        if self.tally.failed:
            return "fail"
        if not self.tally.judged:
            return "infra"
        return "not executed" if self.tally.not_executed else "pass"


@dataclass(frozen=True, slots=True)
class Matrix:
    """Cells by the labels of two axes; an axis of one label where the campaign has no more."""

    rows: str
    columns: str
    row_labels: tuple[str, ...]
    column_labels: tuple[str, ...]
    cells: Mapping[tuple[str, str], Cell]


def load(directory: Path) -> Loaded:
    """Read a campaign's directory. Raises RecordError when it is none, or has no result."""
    info = read_info(directory)
    with _without_collector():
        results = read_results(directory)
    if not results:
        raise RecordError(f"{directory}: no run of this campaign has ended yet; fly it, or go on with --resume")
    outcomes = [outcomes_by_requirement(result) for result in results]
    return Loaded(directory, info, results, _read_found(directory / FOUND_FILE), outcomes)


@contextmanager
def _without_collector() -> Iterator[None]:
    """Nothing of what is read can be garbage yet, and looking for some takes as long as the reading."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def _read_found(path: Path) -> Mapping[str, Any]:
    if not path.is_file():
        return {}
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise RecordError(f"{path}: is not what `hilsat campaign` writes")
    return found


# -- requirements --------------------------------------------------------------------------------------------------


def key_of(verdict: Judged) -> str:
    """How a requirement is called over all runs; one key for what is asked of the faults themselves."""
    if not verdict.id and verdict.name.startswith(BITTEN):
        return BITTEN_ALL
    return verdict.id or verdict.name


def outcomes_by_requirement(result: RunResult) -> dict[str, Outcome]:
    """What came of each requirement in a run; of several with one key the worst."""
    found: dict[str, Outcome] = {}
    for verdict in result.verdicts:
        key = key_of(verdict)
        known = found.get(key)
        if known is None or WORST_FIRST.index(verdict.outcome) < WORST_FIRST.index(known):
            found[key] = verdict.outcome
    return found


def list_requirements(loaded: Loaded) -> list[Requirement]:
    """Every requirement that any run was judged by, in the order of their first appearance."""
    counts: dict[str, Counter[Outcome]] = defaultdict(Counter)
    first: dict[str, Judged] = {}
    bounds: dict[str, dict[str, None]] = defaultdict(dict)
    worst: dict[str, tuple[float, RunResult]] = {}
    for result, outcomes in zip(loaded.results, loaded.outcomes, strict=True):
        for key, outcome in outcomes.items():
            counts[key][outcome] += 1
        for verdict in result.verdicts:
            key = key_of(verdict)
            first.setdefault(key, verdict)
            bounds[key][verdict.bound] = None
            if verdict.margin is not None and (key not in worst or verdict.margin < worst[key][0]):
                worst[key] = (verdict.margin, result)
    infra = loaded.tally.infra
    return [
        Requirement(
            key=key,
            name=BITTEN_ALL if key == BITTEN_ALL else first[key].name,
            bounds=tuple(bounds[key]) if key != BITTEN_ALL else ("each at its time",),
            unit=first[key].unit,
            tally=Tally(count["pass"], count["fail"], count["not executed"], infra),
            smallest=worst[key][0] if key in worst else None,
            worst=worst[key][1] if key in worst else None,
        )
        for key, count in counts.items()
    ]


# -- worst runs ----------------------------------------------------------------------------------------------------


def rank_worst(results: Sequence[RunResult]) -> list[RunResult]:
    """Worst first: what failed, what was not executed, what passed; infra runs are left out.

    Each by its smallest margin, to three digits; of equal ones those first that do not meet more requirements.
    """
    scales = find_scales(results)

    def key(result: RunResult) -> tuple[int, float, int, int]:
        margin = smallest_margin(result, scales)
        met = sum(verdict.outcome == "pass" for verdict in result.verdicts)
        return WORST_FIRST.index(result.outcome), 1.0 if margin is None else round(margin, 3), met, result.number

    return sorted((result for result in results if result.outcome != "infra"), key=key)


def name_troubles(result: RunResult, most: int = 3) -> str:
    """In words: which requirements a run did not meet, and by how much."""
    troubles = [verdict for verdict in result.verdicts if verdict.outcome != "pass"]
    words = [_name_trouble(verdict) for verdict in troubles[:most]]
    if len(troubles) > most:
        words.append(f"and {len(troubles) - most} more")
    return "; ".join(words) or result.reason


def _name_trouble(verdict: Judged) -> str:
    head = f"{verdict.id} {verdict.name}".strip()
    if verdict.outcome == "not executed":
        return f"{head}: not executed"
    if verdict.value is None:
        return f"{head}: {verdict.detail or verdict.bound}"
    return f"{head}: {verdict.value:.4g}, must be {verdict.bound}"


# -- cells ---------------------------------------------------------------------------------------------------------


def make_matrix(loaded: Loaded, rows: str | None = None, columns: str | None = None) -> Matrix:
    """Cells by two axes: those that are named, or the two whose cells differ most in how often they pass.

    Raises UsageError for an axis that is not there or whose values are not listed.
    """
    axes = {axis.name: axis for axis in loaded.list_axes}
    for name in (rows, columns):
        if name is not None and name not in axes:
            raise UsageError(
                f"axis {name!r} has no listed values in {loaded.directory}; {suggest(name, axes)}"
                f"there are: {', '.join(axes) or 'none'}"
            )
    if rows is not None and rows == columns:
        raise UsageError(f"--rows and --columns are both {rows!r}; name two axes")
    ranked = [name for name in rank_axes(loaded) if name not in (rows, columns)]
    if rows is None:
        rows = ranked.pop(0) if ranked else ""
    if columns is None:
        columns = ranked.pop(0) if ranked else ""
    return _fill(loaded, rows, columns)


def _fill(loaded: Loaded, rows: str, columns: str) -> Matrix:
    groups = group(loaded.results, lambda result: (label_of(result, rows), label_of(result, columns)))
    ranks = {result.number: i for i, result in enumerate(loaded.worst_first)}
    cells = {}
    for place, members in groups.items():
        worst = min(members, key=lambda result: ranks.get(result.number, len(ranks)))
        cells[place] = Cell(tally_outcomes(result.outcome for result in members), worst)
    row_labels = _list_labels(loaded, rows, [place[0] for place in cells])
    column_labels = _list_labels(loaded, columns, [place[1] for place in cells])
    if len(row_labels) * len(column_labels) > MOST_CELLS:
        raise UsageError(
            f"{len(row_labels)} x {len(column_labels)} cells of {rows} and {columns} are more than {MOST_CELLS}; "
            "name other axes with --rows and --columns"
        )
    return Matrix(rows, columns, row_labels, column_labels, cells)


def _list_labels(loaded: Loaded, axis: str, seen: Iterable[str]) -> tuple[str, ...]:
    """The labels of an axis in their order, those of runs that are listed nowhere behind them."""
    listed = next((item.labels for item in loaded.list_axes if item.name == axis), ())
    return tuple(dict.fromkeys([*listed, *seen]))


def label_of(result: RunResult, axis: str) -> str:
    """The label of a run on an axis; `all` where there is no such axis."""
    return result.labels.get(axis, "-") if axis else "all"


def group(results: Iterable[RunResult], key: Callable[[RunResult], Any]) -> dict[Any, list[RunResult]]:
    """Runs by a key, in the order of their first appearance."""
    found: dict[Any, list[RunResult]] = {}
    for result in results:
        found.setdefault(key(result), []).append(result)
    return found


def rank_axes(loaded: Loaded) -> list[str]:
    """List axes by how much of the variance of passing their labels explain (eta squared), most first."""
    judged = [result for result in loaded.results if result.outcome != "infra"]
    shares = {axis.name: _explain(judged, axis.name) for axis in loaded.list_axes if len(axis.labels) > 1}
    single = [axis.name for axis in loaded.list_axes if len(axis.labels) == 1]
    return [*sorted(shares, key=lambda name: -shares[name]), *single]


def _explain(judged: Sequence[RunResult], axis: str) -> float:
    count = len(judged)
    passed = sum(result.outcome == "pass" for result in judged)
    total = passed * (count - passed) / count if count else 0.0
    if not total:
        return 0.0
    mean = passed / count
    between = 0.0
    for members in group(judged, lambda result: label_of(result, axis)).values():
        share = sum(result.outcome == "pass" for result in members) / len(members)
        between += len(members) * (share - mean) ** 2
    return between / total


def tally_by_axis(loaded: Loaded, axis: str) -> dict[str, dict[str, Tally]]:
    """For each label of an axis, and for each requirement and `outcome`: how the runs came off."""
    counts: dict[str, dict[str, Counter[Outcome]]] = defaultdict(lambda: defaultdict(Counter))
    for label in _list_labels(loaded, axis, ()):
        counts[label] = defaultdict(Counter)
    for result, outcomes in zip(loaded.results, loaded.outcomes, strict=True):
        own = counts[label_of(result, axis)]
        own[OUTCOME][result.outcome] += 1
        for key, outcome in outcomes.items():
            own[key][outcome] += 1
    return {
        label: {key: Tally(*(count[outcome] for outcome in OUTCOMES)) for key, count in own.items()}
        for label, own in counts.items()
    }
