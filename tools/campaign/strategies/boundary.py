"""Find where along an axis a requirement begins to fail."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Literal

from tools.campaign.plan import Evaluate, Point
from tools.campaign.results import Outcome
from tools.campaign.statistics import Tally
from tools.campaign.strategies.answers import (
    Space,
    describe_tally,
    outcome_of,
    require_known,
    round_value,
    tally_outcomes,
)
from tools.campaign.strategies.settings import BoundarySettings

Answer = Literal["pass", "fail", "unknown"]  # unknown: not one of its runs could be judged


@dataclass(slots=True)
class Level:
    """One value of the axis, and what came of its repeats."""

    value: float
    outcomes: list[Outcome] = field(default_factory=list)
    answer: Answer | None = None
    is_sure: bool = True  # the interval decided, or was not asked

    @property
    def tally(self) -> Tally:
        """What came of its repeats so far."""
        return tally_outcomes(self.outcomes)


@dataclass(slots=True)
class Line:
    """The search for one combination of the list axes."""

    labels: dict[str, str]
    points: list[Point]  # of the plan, whose other values the repeats take in turn
    levels: list[Level] = field(default_factory=list)  # ascending

    def changes(self) -> list[tuple[Level, Level]]:
        """Neighbours with different answers."""
        known = [level for level in self.levels if level.answer in ("pass", "fail")]
        return [(a, b) for a, b in pairwise(known) if a.answer != b.answer]

    def add(self, value: float) -> None:
        """One more level, unless it is there."""
        if all(level.value != value for level in self.levels):
            self.levels.append(Level(value))
            self.levels.sort(key=lambda level: level.value)


class BoundarySearch:
    """Bisection with repeats, for all combinations at once."""

    def __init__(self, settings: BoundarySettings, space: Space) -> None:
        self._settings = settings
        self._space = space

    def run(self, evaluate: Evaluate) -> Mapping[str, Any]:
        """Search; return for each combination between which two values the answer changes, and all answers."""
        settings = self._settings
        lines = self._make_lines()
        step = (settings.upper - settings.lower) / (settings.levels - 1)
        for line in lines:
            for i in range(settings.levels):
                line.add(round_value(settings.upper if i == settings.levels - 1 else settings.lower + i * step))
        while True:
            self._answer(lines, evaluate)
            grown = [self._halve(line) for line in lines]
            if not any(grown):
                break
        found = [self._describe(line) for line in lines]
        return {
            "kind": settings.kind,
            "axis": settings.axis,
            "unit": next((axis.unit for axis in self._space.axes if axis.name == settings.axis), ""),
            "requirement": settings.requirement,
            "tolerance": settings.tolerance,
            "decide": settings.decide,
            "pass_share": settings.pass_share,
            "boundaries": found,
            "summary": [item["words"] for item in found],
        }

    def _make_lines(self) -> list[Line]:
        listed = [axis.name for axis in self._space.axes if axis.labels and axis.name != self._settings.axis]
        lines: dict[tuple[str, ...], Line] = {}
        for point in self._space.points():
            labels = {name: point.labels[name] for name in listed if name in point.labels}
            line = lines.setdefault(tuple(labels.values()), Line(labels, []))
            if point.repeat == 0:
                line.points.append(point)
        return list(lines.values())

    def _answer(self, lines: list[Line], evaluate: Evaluate) -> None:
        """Fly all levels without an answer until each has one."""
        while asked := [(line, level) for line in lines for level in line.levels if level.answer is None]:
            batch: list[Point] = []
            shares: list[tuple[Level, int]] = []
            for line, level in asked:
                points = self._list_repeats(line, level)
                batch += points
                shares.append((level, len(points)))
            results = evaluate(batch)
            require_known(results, self._settings.requirement)
            at = 0
            for level, share in shares:
                level.outcomes += [outcome_of(item, self._settings.requirement) for item in results[at : at + share]]
                at += share
                self._decide(level)

    def _list_repeats(self, line: Line, level: Level) -> list[Point]:
        axis, settings = self._settings.axis, self._settings
        first = len(level.outcomes)
        last = first + settings.repeats
        if settings.decide == "interval":
            last = min(last, settings.most_repeats)
        found = []
        for repeat in range(first, last):
            point = line.points[repeat % len(line.points)]
            values = {**point.values, axis: level.value}
            found.append(
                replace(point, values=values, labels={**point.labels, axis: f"{level.value:.6g}"}, repeat=repeat)
            )
        return found

    def _decide(self, level: Level) -> None:
        settings, tally = self._settings, level.tally
        if settings.decide == "interval":
            low, high = tally.interval(settings.confidence)
            level.is_sure = low > settings.pass_share or high < settings.pass_share
            if not level.is_sure and len(level.outcomes) < settings.most_repeats:
                return
        if tally.rate is None:
            level.answer = "unknown"
        else:
            level.answer = "pass" if tally.rate >= settings.pass_share else "fail"

    def _halve(self, line: Line) -> bool:
        """Add the middle of each stretch that is too long; False when there is none."""
        before = len(line.levels)
        for a, b in line.changes():
            between = [level for level in line.levels if a.value < level.value < b.value]
            if (
                b.value - a.value > self._settings.tolerance and not between
            ):  # else: unknown in the middle, no more to learn
                line.add(round_value(0.5 * (a.value + b.value)))
        return len(line.levels) > before

    def _describe(self, line: Line) -> dict[str, Any]:
        changes = line.changes()
        return {
            "labels": line.labels,
            "monotonic": len(changes) < 2,
            "changes": [{"lower": a.value, "upper": b.value, "below": a.answer, "above": b.answer} for a, b in changes],
            "levels": [
                {
                    **describe_tally(level.tally, self._settings.confidence),
                    "value": level.value,
                    "answer": level.answer,
                    "sure": level.is_sure,
                }
                for level in line.levels
            ],
            "words": f"{', '.join(line.labels.values()) or self._settings.axis}: {self._say(line, changes)}",
        }

    def _say(self, line: Line, changes: list[tuple[Level, Level]]) -> str:
        settings = self._settings
        unknown = [f"{level.value:g}" for level in line.levels if level.answer == "unknown"]
        unsure = [f"{level.value:g}" for level in line.levels if not level.is_sure and level.answer != "unknown"]
        answers = {level.answer for level in line.levels} - {"unknown"}
        if not answers:
            words = "no run could be judged"
        elif not changes:
            words = (
                f"no boundary inside: {settings.requirement} is a {answers.pop()} at every value flown from "
                f"{settings.lower:g} to {settings.upper:g}"
            )
        else:
            places = [f"{a.answer} at {a.value:.6g}, {b.answer} at {b.value:.6g}" for a, b in changes]
            words = f"{settings.requirement} along {settings.axis}: {'; '.join(places)}"
            if len(changes) > 1:
                words += f"; NOT MONOTONIC, the answer changes {len(changes)} times (or the repeats are too few)"
        if unsure:
            words += f"; the interval did not decide at {', '.join(unsure)}, the majority did"
        if unknown:
            words += f"; not to be judged at {', '.join(unknown)}"
        return words
