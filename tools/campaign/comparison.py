"""Two campaigns compared: which cells got better or worse by more than chance would have it.

A cell is a combination of labels of the list axes that both have; `all runs` is one more. Each cell is tested for the
outcome of the runs and for every requirement that both judge:

    Fisher's exact test     of the two shares that passed
    McNemar's exact test    where all runs of the cell match one to one (number, seed and values are the same): stronger,
                            because what makes a run hard is the same on both sides

All p-values of a comparison are corrected together (Holm 1979): with a probability of 95 % there is no false alarm among
them, however many cells there are.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

from bus.errors import UsageError
from tools.campaign.results import OUTCOMES, Outcome, RunResult
from tools.campaign.statistics import (
    CONFIDENCE,
    Interval,
    Tally,
    adjust_holm,
    difference_interval,
    fisher_exact,
    mcnemar_exact,
)
from tools.campaign.strategies.settings import OUTCOME
from tools.campaign.summary import Loaded

ALL_RUNS: Final = "all runs"
Verdict = Literal["worse", "better", "no difference", "lost", "untested"]
Place = tuple[str, ...]


@dataclass(slots=True)
class Change:
    """One requirement in one cell, before and after."""

    cell: str
    labels: Mapping[str, str]
    requirement: str  # `outcome`, or its id or name
    before: Tally
    after: Tally
    test: Literal["fisher", "mcnemar", ""]  # empty: one side has no judged run
    p_value: float
    changed: tuple[int, int] | None = None  # of matching runs: passed before and not now, and the other way round
    adjusted: float = 1.0
    verdict: Verdict = "no difference"

    @property
    def interval(self) -> Interval | None:
        """Of the difference of the rates, after less before, by Newcombe; None where one is not known."""
        return difference_interval(self.before, self.after)

    def as_dict(self) -> dict[str, Any]:
        """In JSON types."""
        interval = self.interval
        return {
            "cell": self.cell,
            "labels": dict(self.labels),
            "requirement": self.requirement,
            "verdict": self.verdict,
            "before": _count(self.before),
            "after": _count(self.after),
            "difference": None if interval is None else (self.after.rate or 0.0) - (self.before.rate or 0.0),
            "interval": None if interval is None else list(interval),
            "test": self.test,
            "changed": None if self.changed is None else list(self.changed),
            "p_value": self.p_value,
            "adjusted": self.adjusted,
        }


@dataclass(slots=True)
class Comparison:
    """All changes, and what could not be compared."""

    before: str
    after: str
    alpha: float
    axes: tuple[str, ...]  # that cells are made of
    changes: list[Change] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def by_verdict(self, *verdicts: Verdict) -> list[Change]:
        """Changes of these verdicts, the least probable first."""
        found = [change for change in self.changes if change.verdict in verdicts]
        return sorted(found, key=lambda change: (change.adjusted, change.p_value))

    @property
    def is_worse(self) -> bool:
        """Something got worse beyond chance, or is not judged any more."""
        return any(change.verdict in ("worse", "lost") for change in self.changes)

    def as_dict(self) -> dict[str, Any]:
        """In JSON types."""
        return {
            "before": self.before,
            "after": self.after,
            "alpha": self.alpha,
            "axes": list(self.axes),
            "worse": self.is_worse,
            "notes": self.notes,
            "changes": [change.as_dict() for change in self.changes],
        }


def _count(tally: Tally) -> dict[str, Any]:
    return {"passed": tally.passed, "judged": tally.judged, "infra": tally.infra, "rate": tally.rate}


@dataclass(slots=True)
class _Side:
    """One campaign, counted: cell -> requirement -> outcomes; and its runs by number, for pairs."""

    counts: dict[Place, dict[str, Counter[Outcome]]] = field(default_factory=dict)
    runs: dict[Place, dict[int, tuple[RunResult, Mapping[str, Outcome]]]] = field(default_factory=dict)

    def tally(self, cell: Place, requirement: str) -> Tally:
        count = self.counts.get(cell, {}).get(requirement, Counter())
        return Tally(*(count[outcome] for outcome in OUTCOMES))


def compare(before: Loaded, after: Loaded, confidence: float = CONFIDENCE) -> Comparison:
    """Compare two campaigns. Raises UsageError when they have no requirement or no cell in common."""
    axes = _find_axes(before, after)
    a, b = _count_side(before, axes), _count_side(after, axes)
    requirements = [OUTCOME, *(key for key in _list_keys(a) if key in set(_list_keys(b)))]
    cells = [cell for cell in a.counts if cell in b.counts]
    if len(cells) < 2:  # the one is that of all runs
        raise UsageError(
            f"{before.directory} and {after.directory} have no cell in common: the axes {', '.join(axes)} have no "
            "combination of labels that both flew; compare campaigns of one file, or of files with the same axes"
        )
    if len(requirements) == 1 and _list_keys(a) and _list_keys(b):
        raise UsageError(
            f"{before.directory} and {after.directory} are judged by different requirements: {_list_keys(a)[0]!r} and "
            f"{_list_keys(b)[0]!r}, for example; there is nothing to compare"
        )
    found = Comparison(str(before.directory), str(after.directory), 1.0 - confidence, axes)
    if len(cells) == 2:  # one cell is all runs: once is enough
        cells = [()]
    for cell in cells:
        found.changes += [_test(a, b, axes, cell, requirement) for requirement in requirements]
    _decide(found)
    found.notes = list(_list_notes(before, after, a, b, requirements))
    return found


def _find_axes(before: Loaded, after: Loaded) -> tuple[str, ...]:
    known = {axis.name for axis in after.list_axes}
    return tuple(axis.name for axis in before.list_axes if axis.name in known)


def _count_side(loaded: Loaded, axes: Sequence[str]) -> _Side:
    side = _Side()
    for result, judged in zip(loaded.results, loaded.outcomes, strict=True):
        own = (result.base, *(result.labels.get(axis, "-") for axis in axes))
        outcomes = {OUTCOME: result.outcome, **judged}
        for cell in ((), own):
            if cell not in side.counts:
                side.counts[cell], side.runs[cell] = defaultdict(Counter), {}
            counts = side.counts[cell]
            for key, outcome in outcomes.items():
                counts[key][outcome] += 1
            side.runs[cell][result.number] = (result, outcomes)
    return side


def _list_keys(side: _Side) -> list[str]:
    return [key for key in side.counts.get((), {}) if key != OUTCOME]


def _test(a: _Side, b: _Side, axes: Sequence[str], cell: Place, requirement: str) -> Change:
    before, after = a.tally(cell, requirement), b.tally(cell, requirement)
    labels = dict(zip(("base", *axes), cell, strict=True)) if cell else {}
    words = ", ".join(list(labels.values())[1:] or labels.values()) if cell else ALL_RUNS
    change = Change(words, labels, requirement, before, after, "", 1.0)
    if not before.judged or not after.judged:
        change.verdict = "lost" if before.judged else "untested"
        return change
    change.changed = _pair(a.runs[cell], b.runs[cell], requirement)
    if change.changed is None:
        change.test, change.p_value = "fisher", fisher_exact(before, after)
    else:
        change.test, change.p_value = "mcnemar", mcnemar_exact(*change.changed)
    return change


def _pair(a: Mapping[int, Any], b: Mapping[int, Any], requirement: str) -> tuple[int, int] | None:
    """How many matching runs passed before alone, and after alone; None when the runs do not all match.

    A pair of which one could not be judged says nothing.
    """
    if a.keys() != b.keys():
        return None
    lost = won = 0
    for number, (run, outcomes) in a.items():
        other, others = b[number]
        if run.seed != other.seed or run.values != other.values:
            return None
        now, then = others.get(requirement, "infra"), outcomes.get(requirement, "infra")
        if "infra" in (now, then):
            continue
        lost += then == "pass" and now != "pass"
        won += then != "pass" and now == "pass"
    return lost, won


def _decide(found: Comparison) -> None:
    tested = [change for change in found.changes if change.test]
    for change, adjusted in zip(tested, adjust_holm([change.p_value for change in tested]), strict=True):
        change.adjusted = adjusted
        if adjusted < found.alpha:
            change.verdict = "worse" if _fell(change) else "better"


def _fell(change: Change) -> bool:
    if change.changed is not None:
        return change.changed[0] > change.changed[1]
    return (change.after.rate or 0.0) < (change.before.rate or 0.0)


def _list_notes(before: Loaded, after: Loaded, a: _Side, b: _Side, requirements: Sequence[str]) -> Any:
    """What a reader should know beside the tests."""
    for name, side, other in ((before.directory, a, b), (after.directory, b, a)):
        alone = [key for key in _list_keys(side) if key not in requirements]
        if alone:
            yield f"only {name} is judged by: {', '.join(alone)}"
        cells = [cell for cell in side.counts if cell not in other.counts]
        if cells:
            yield f"only {name} has {len(cells)} cells, such as {', '.join(cells[0])}"
    infra = [loaded.tally.infra for loaded in (before, after)]
    if any(infra):
        yield f"infra runs, which are in no rate: {infra[0]} before, {infra[1]} after"
    missing = [loaded.missing for loaded in (before, after)]
    if any(missing):
        yield f"runs of the plan without a result: {missing[0]} before, {missing[1]} after"
