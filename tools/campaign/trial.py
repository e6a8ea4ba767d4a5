"""Runs of a campaign tried out before any is flown: their scenarios are loaded; what is wrong is found in the campaign."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from bus.errors import UsageError
from bus.settings import KeyPath, join_key
from tools.campaign.campaign import Campaign
from tools.campaign.formulas import FormulaError
from tools.campaign.job import find_base
from tools.campaign.plan import Point, RunPlan
from tools.campaign.strategies.settings import BoundarySettings, WorstSettings
from tools.campaign.template import TemplateError, find_node, name_whole
from tools.config.findings import Finding, Place
from tools.config.loader import examine
from tools.config.merge import parse_key
from tools.config.yaml_nodes import Node

_NUMBER = re.compile(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?")
MOST_SHOWN = 3  # axes that a message names


@dataclass(slots=True)
class _Seen:
    """One thing that is wrong, and how many of the runs that were tried have it."""

    finding: Finding
    first: str
    runs: int = 1


@dataclass(slots=True)
class _Trial:
    campaign: Campaign
    root: Node
    seen: dict[tuple[str, str], _Seen] = field(default_factory=dict)

    def note(self, finding: Finding, plan: RunPlan | None, number: int, point: Point) -> None:
        key = (str(finding.place), _NUMBER.sub("#", finding.message))  # a drawn value is another one in every run
        if key in self.seen:
            self.seen[key].runs += 1
            return
        self.seen[key] = _Seen(finding, describe_run(number, point))

    def list_findings(self, tried: int) -> list[Finding]:
        found = []
        for seen in self.seen.values():
            where = f" ({seen.first}" + (f"; so are {seen.runs} of the {tried} tried)" if seen.runs > 1 else ")")
            found.append(Finding(seen.finding.place, seen.finding.key, seen.finding.message + where))
        return found


def try_out(campaign: Campaign, root: Node, most: int) -> tuple[int, list[Finding]]:
    """Load the scenarios of at most so many runs: how many were loaded, and what is wrong."""
    trial = _Trial(campaign, root)
    numbered = choose_points(campaign, most)
    for number, point in numbered:
        _try_one(trial, number, point)
    return len(numbered), trial.list_findings(len(numbered))


def _try_one(trial: _Trial, number: int, point: Point) -> None:
    campaign, root = trial.campaign, trial.root
    try:
        plan = campaign.plan(number, point)
    except TemplateError as error:
        path = ("set", *error.path)
        trial.note(Finding(root.locate(path), join_key(path), str(error)), None, number, point)
        return
    except FormulaError as error:
        trial.note(Finding(root.locate(("axes",)), "axes", str(error)), None, number, point)
        return
    try:
        path_of_base = find_base(plan.base, campaign.path.parent)
    except UsageError as error:
        at: KeyPath = ("base",) if len(campaign.bases) == 1 else ("base", campaign.bases.index(plan.base))
        trial.note(Finding(root.locate(at), join_key(at), str(error)), plan, number, point)
        return
    words = list(plan.overrides)
    if not any(word.startswith("seed=") for word in words):
        words.append(f"seed={plan.seed}")
    for finding in examine(path_of_base, words).findings:
        trial.note(_translate(trial, finding, point), plan, number, point)


def _translate(trial: _Trial, finding: Finding, point: Point) -> Finding:
    """A finding of a scenario as one of the campaign: at the value of the axis that led to it, where one did."""
    path = parse_key(finding.key) if finding.key else None
    if not finding.place.source.overrides:
        if finding.place.line:
            return Finding(finding.place, finding.key, finding.message)
        base = Place(trial.root.place.source)
        return Finding(base, "base", f"{finding.place.source.name}: {finding.message}")
    key = finding.place.source.name.removeprefix("--set ").partition("=")[0].strip()
    words = f"{finding.key}: {finding.message}" if finding.key else finding.message
    settings = trial.campaign.settings
    for name, axis in settings.axes.by_name.items():
        if axis.key == key and key not in settings.set.by_key:
            place, shown = _locate_value(trial, name, point, _rest_of(path, key))
            return Finding(place, shown, words)
    node = trial.root.value["set"].value.get(key) if "set" in trial.root.value else None
    if node is None:
        return Finding(trial.root.place, "set", words)
    if path is not None and len(path) < len(parse_key(key) or ()):  # it is the key that is wrong
        return Finding(node.key_place or node.place, f"set.{key}", words)
    rest = _rest_of(path, key)
    inner, left = find_node(node, rest)
    used = name_whole(inner.value)
    if used is not None and used in settings.axes.by_name:
        place, shown = _locate_value(trial, used, point, left)
        return Finding(place, shown, words)
    return Finding(inner.key_place or inner.place, f"set.{key}", words)


def _rest_of(path: KeyPath | None, key: str) -> KeyPath:
    """What of a path is behind a key."""
    head = parse_key(key) or ()
    return path[len(head) :] if path is not None and path[: len(head)] == head else ()


def _locate_value(trial: _Trial, name: str, point: Point, left: KeyPath) -> tuple[Place, str]:
    """Where the value of an axis stands that a point has, and its key."""
    axis = trial.root.value["axes"].value[name]
    label, value = point.labels.get(name), point.values.get(name)
    path: KeyPath = ("axes", name)
    listed = axis.value if isinstance(axis.value, list) else None
    if listed is None and "values" in axis.value and isinstance(axis.value["values"].value, list):
        listed, path = axis.value["values"].value, (*path, "values")
    if listed is not None:
        index = next((i for i, item in enumerate(listed) if item.plain() == value), None)
        path = path if index is None else (*path, index)
    elif "cases" in axis.value:
        path = (*path, "cases", str(label))
    path = (*path, *left)
    return trial.root.locate(path), join_key(path)


def describe_run(number: int, point: Point) -> str:
    """A run in words: its number and what it has on the axes."""
    labels = [f"{name} {label}" for name, label in point.labels.items()]
    more = ", ..." if len(labels) > MOST_SHOWN else ""
    return f"run {number}: {', '.join(labels[:MOST_SHOWN])}{more}" if labels else f"run {number}"


def choose_points(campaign: Campaign, most: int) -> list[tuple[int, Point]]:
    """Number and point of the runs that are tried: every combination of lists, then the ends of what is drawn, then others.

    For a search along an axis, or over all of them, the ends of the search too.
    """
    points = campaign.points()
    chosen: dict[int, Point] = {}
    listed = [axis.name for axis in campaign.axes if axis.labels]
    values: dict[tuple[str, str], int] = {}  # every value, however many there are
    combinations: dict[tuple[str, ...], int] = {}
    for number, point in enumerate(points):
        for name in listed:
            values.setdefault((name, point.labels[name]), number)
        combinations.setdefault(tuple(point.labels[name] for name in listed), number)
    wanted = [*values.values(), *combinations.values()]
    for axis in campaign.axes:
        if not axis.labels and points and isinstance(points[0].values[axis.name], int | float):
            by_value = sorted(range(len(points)), key=lambda i, name=axis.name: points[i].values[name])  # type: ignore[misc]
            wanted += [by_value[0], by_value[-1]]
    step = max(1, len(points) // most)
    for number in (*wanted, *range(0, len(points), step)):
        if len(chosen) >= most:
            break
        chosen[number] = points[number]
    return [*chosen.items(), *((0, point) for point in _list_ends(campaign, points))]


def _list_ends(campaign: Campaign, points: list[Point]) -> Iterator[Point]:
    """Points at the ends of what a strategy searches."""
    strategy = campaign.strategy
    if isinstance(strategy, BoundarySettings) and points:
        for value in (strategy.lower, strategy.upper):
            labels = {**points[0].labels, strategy.axis: f"{value:g}"}
            yield Point(values={**points[0].values, strategy.axis: value}, labels=labels)
    if isinstance(strategy, WorstSettings):
        for u in (0.0, 0.5, 1.0 - 2.0**-30):
            yield campaign.sample([u] * campaign.dimensions)
