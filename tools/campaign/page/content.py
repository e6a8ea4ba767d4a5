"""What a campaign's page says, gathered from its results; numbers of any size come to a page of one size."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tools.campaign.coverage import Coverage, cover
from tools.campaign.importance import Importance, list_targets, read_axes, weigh_axes
from tools.campaign.page import charts
from tools.campaign.results import RunResult, read_timings
from tools.campaign.statistics import Tally
from tools.campaign.strategies.settings import OUTCOME
from tools.campaign.summary import (
    Loaded,
    Matrix,
    Requirement,
    key_of,
    make_matrix,
    tally_by_axis,
)
from tools.campaign.table import list_reasons

MOST_CHARTS: Final = 16  # distributions
MOST_SCATTERS: Final = 9
MOST_SHOWN: Final = 60  # rows or columns of a matrix, labels of an axis
MOST_IMPORTANCES: Final = 8  # targets
WORST: Final = 10
_NUMBER: Final = r"(-?[\d.]+(?:e[+-]?\d+)?)"
_BOUNDS: Final = (  # how bounds are said, see tools/grading/judge.py
    re.compile(rf"[<>]= {_NUMBER}"),
    re.compile(rf"{_NUMBER} \.\. {_NUMBER}"),
)
_AROUND: Final = re.compile(rf"{_NUMBER} \+- {_NUMBER}")


@dataclass(slots=True)
class Chart:
    """One picture with its caption."""

    title: str
    svg: str
    note: str = ""


@dataclass(frozen=True, slots=True)
class AxisTable:
    """Requirements by the labels of one axis."""

    axis: str
    labels: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Tally, ...]], ...]  # requirement, how each label came off
    left_out: int = 0  # labels beyond what a page shows


@dataclass(slots=True)
class Page:
    """Everything that is said of a campaign."""

    loaded: Loaded
    tally: Tally
    matrix: Matrix
    requirements: list[Requirement]
    worst: list[RunResult]
    reasons: list[tuple[str, str, str]]
    coverage: Coverage
    axis_tables: list[AxisTable] = field(default_factory=list)
    distributions: list[Chart] = field(default_factory=list)
    importances: dict[str, list[Importance]] = field(default_factory=dict)  # by target
    scatters: list[Chart] = field(default_factory=list)
    search: list[Chart] = field(default_factory=list)
    cost: str = ""


def gather(loaded: Loaded, rows: str | None = None, columns: str | None = None) -> Page:
    """Everything that the page says. Raises UsageError for axes that cannot be those of the matrix."""
    page = Page(
        loaded,
        loaded.tally,
        make_matrix(loaded, rows, columns),
        loaded.requirements,
        loaded.worst_first[:WORST],
        list_reasons(loaded),
        cover(loaded.results),
    )
    page.axis_tables = list(_list_axis_tables(loaded, page.requirements))
    page.distributions = list(_draw_distributions(loaded, page.requirements))
    targets = list_targets(loaded.results, list(loaded.info.metrics))
    weighed = weigh_axes(loaded.results, loaded.info.axes, targets)
    for item in weighed:
        if item.target in page.importances or len(page.importances) < MOST_IMPORTANCES:
            page.importances.setdefault(item.target, []).append(item)
    page.scatters = list(_draw_scatters(loaded, targets, weighed))
    if trace := loaded.found.get("trace"):
        name = str(loaded.found.get("objective", ""))
        page.search.append(Chart(f"The search, by generation: {name}", charts.draw_trace(trace, name)))
    page.cost = _say_cost(loaded)
    return page


def _say_cost(loaded: Loaded) -> str:
    timings = read_timings(loaded.directory)
    if not timings:
        return ""
    cpu_s = sum(timing.cpu_s for timing in timings)
    workers = len({timing.worker for timing in timings})
    return f"{cpu_s:.1f} s of processor time, {cpu_s / len(timings):.3g} s a run, {workers} workers"


# -- requirements by axis ------------------------------------------------------------------------------------------


def _list_axis_tables(loaded: Loaded, requirements: Sequence[Requirement]) -> Iterator[AxisTable]:
    for axis in loaded.list_axes:
        if len(axis.labels) < 2:
            continue
        by_label = tally_by_axis(loaded, axis.name)
        keys = [(OUTCOME, "the whole run"), *((item.key, item.title) for item in requirements)]
        shown = list(by_label)[:MOST_SHOWN]
        rows = tuple((title, tuple(by_label[label].get(key, Tally()) for label in shown)) for key, title in keys)
        yield AxisTable(axis.name, tuple(shown), rows, len(by_label) - len(shown))


# -- distributions -------------------------------------------------------------------------------------------------


def _draw_distributions(loaded: Loaded, requirements: Sequence[Requirement]) -> Iterator[Chart]:
    """Of each requirement's value with its bounds, and of each metric."""
    values: dict[str, list[tuple[float, float | None, bool, str]]] = {}
    for result in loaded.results:
        for verdict in result.verdicts:
            if verdict.value is not None and verdict.margin is not None:
                item = (verdict.value, verdict.margin, verdict.outcome == "pass", verdict.bound)
                values.setdefault(key_of(verdict), []).append(item)
    drawn = 0
    for requirement in requirements:
        found = values.get(requirement.key)
        if not found or drawn >= MOST_CHARTS:
            continue
        drawn += 1
        bounds = find_bounds(found)
        numbers = np.array([item[0] for item in found])
        passed = np.array([item[2] for item in found])
        without = requirement.tally.judged - len(found)
        yield Chart(
            requirement.title,
            charts.draw_distribution(numbers, passed, requirement.unit, bounds, requirement.title),
            f"must be {', '.join(requirement.bounds[:3])}" + (f"; {without} runs without a value" if without else ""),
        )
    for name, unit in list(loaded.info.metrics.items())[: max(0, MOST_CHARTS - drawn)]:
        yield from _draw_metric(loaded, name, unit)


def _draw_metric(loaded: Loaded, name: str, unit: str) -> Iterator[Chart]:
    known = [(value, r.outcome == "pass") for r in loaded.results if (value := r.metrics.get(name)) is not None]
    if known:
        numbers, passed = np.array([item[0] for item in known]), np.array([item[1] for item in known])
        without = len(loaded.results) - len(known)
        note = "metric, without a bound" + (f"; {without} runs without a value" if without else "")
        yield Chart(name, charts.draw_distribution(numbers, passed, unit, (), name), note)


def find_bounds(found: Sequence[tuple[float, float | None, bool, str]]) -> list[float]:
    """The bounds that the words name and the margins confirm: a value and its margin reach exactly to one of them."""
    named: dict[float, None] = {}
    for words in dict.fromkeys(item[3] for item in found):
        for number in _read_bounds(words.rpartition(": ")[2]):
            named[number] = None
    sample = found[:: max(1, len(found) // 200)]
    return [
        bound
        for bound in list(named)[:8]
        if any(
            margin is not None
            and abs(abs(value - bound) - abs(margin)) <= 1e-5 * max(abs(bound), abs(value), abs(margin))
            for value, margin, _, _ in sample
        )
    ]


def _read_bounds(words: str) -> Iterator[float]:
    for pattern in _BOUNDS:
        for match in pattern.finditer(words):
            yield from (float(number) for number in match.groups())
    for match in _AROUND.finditer(words):
        middle, reach = (float(number) for number in match.groups())
        yield from (middle - reach, middle + reach)


# -- axes against results ------------------------------------------------------------------------------------------


def _draw_scatters(loaded: Loaded, targets: dict[str, Any], weighed: Sequence[Importance]) -> Iterator[Chart]:
    """The pairs of a drawn axis and a number that have most to do with each other."""
    numbers, _ = read_axes(loaded.results, loaded.info.axes)
    axis_units = {axis.name: axis.unit for axis in loaded.info.axes}
    units = {f"margin of {item.key}": item.unit for item in loaded.requirements}
    units |= loaded.info.metrics
    passed: NDArray[np.bool_] = np.array([result.outcome == "pass" for result in loaded.results])
    pairs = [item for item in weighed if item.axis in numbers and item.target != "passing"]
    for item in sorted(pairs, key=lambda item: -item.weight)[:MOST_SCATTERS]:
        x, y = numbers[item.axis], targets[item.target]
        valid = np.isfinite(x) & np.isfinite(y)
        svg = charts.draw_scatter(
            x[valid],
            y[valid],
            passed[valid],
            (item.axis, item.target),
            (axis_units.get(item.axis, ""), units.get(item.target, "")),
        )
        yield Chart(f"{item.target} by {item.axis}", svg, f"partial rank correlation {item.effect:+.2f}")
