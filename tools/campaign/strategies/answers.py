"""What strategies read out of results: whether a run passes what is asked, and how badly it came off."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from statistics import median
from typing import Any, Final, Protocol

from bus.errors import ConfigError
from bus.words import suggest
from tools.campaign.plan import Point
from tools.campaign.results import AxisInfo, Judged, Outcome, RunResult
from tools.campaign.statistics import Tally
from tools.campaign.strategies.settings import OUTCOME

DIGITS: Final = 12  # significant digits of a value that a strategy chooses: no last bit that differs between machines
LOST: Final = -1.0  # normalised margin of a fail without a number, the worst there is
UNKNOWN: Final = 1.0  # normalised margin of what was not executed: nothing was learnt


class Space(Protocol):
    """What a strategy needs to know of a campaign."""

    @property
    def seed(self) -> int:
        """Of the campaign; what a strategy draws comes from it."""
        ...

    @property
    def axes(self) -> Sequence[AxisInfo]:
        """In the order of the file."""
        ...

    def points(self) -> list[Point]:
        """The whole plan, in order."""
        ...

    def sample(self, u: Sequence[float]) -> Point:
        """The point at a place of the unit cube, one number an axis that is drawn."""
        ...


def outcome_of(result: RunResult, requirement: str) -> Outcome:
    """What came of one requirement (by id or name) in a run; the whole run's outcome for `outcome`."""
    if requirement == OUTCOME or result.outcome == "infra":
        return result.outcome
    verdict = find_verdict(result, requirement)
    return verdict.outcome if verdict else "not executed"


def find_verdict(result: RunResult, requirement: str) -> Judged | None:
    """The verdict of that id, or else of that name; None when the run was not judged by it."""
    named = None
    for verdict in result.verdicts:
        if verdict.id and verdict.id == requirement:
            return verdict
        if verdict.name == requirement and named is None:
            named = verdict
    return named


def require_known(results: Iterable[RunResult], requirement: str) -> None:
    """Raise ConfigError when runs were judged, and none of them by a requirement of that id or name."""
    if requirement in (OUTCOME, ""):
        return
    judged = [result for result in results if result.verdicts]
    if not judged or any(find_verdict(result, requirement) for result in judged):
        return
    known = list(dict.fromkeys(verdict.id or verdict.name for result in judged for verdict in result.verdicts))
    raise ConfigError(
        f"strategy: no run was judged by a requirement {requirement!r}; {suggest(requirement, known)}give one of: "
        f"{OUTCOME}, {', '.join(known)}"
    )


def tally_outcomes(outcomes: Iterable[Outcome]) -> Tally:
    """How many of each."""
    count = Counter(outcomes)
    return Tally(count["pass"], count["fail"], count["not executed"], count["infra"])


def find_scales(results: Iterable[RunResult]) -> dict[str, float]:
    """For each requirement the size of its margins: the median of their magnitudes (1 where that is 0).

    Margins come in degrees, seconds and newton metres; as shares of their usual size they can be compared.
    """
    sizes: dict[str, list[float]] = {}
    for result in results:
        for verdict in result.verdicts:
            if verdict.margin is not None:
                sizes.setdefault(verdict.name, []).append(abs(verdict.margin))
    return {name: median(found) or 1.0 for name, found in sizes.items()}


def normalise_margin(verdict: Judged, scales: Mapping[str, float]) -> float:
    """margin / (|margin| + scale), between -1 and 1 and rising with the margin.

    -1 for a fail without a margin, 1 for what was not executed.
    """
    if verdict.outcome == "not executed":
        return UNKNOWN
    if verdict.margin is None:
        return LOST if verdict.outcome == "fail" else UNKNOWN
    return verdict.margin / (abs(verdict.margin) + scales.get(verdict.name, 1.0))


def smallest_margin(result: RunResult, scales: Mapping[str, float], requirement: str = "") -> float | None:
    """The smallest normalised margin of a run, or that of one requirement; None for a run that was not judged."""
    if result.outcome == "infra":
        return None
    if requirement:
        verdict = find_verdict(result, requirement)
        return normalise_margin(verdict, scales) if verdict else None
    smallest = min((normalise_margin(verdict, scales) for verdict in result.verdicts), default=None)
    if smallest is None:
        return LOST if result.outcome == "fail" else None
    return min(smallest, 0.0) if result.outcome == "fail" else smallest


def round_value(value: float) -> float:
    """To the digits that go into a run's settings."""
    return float(f"{value:.{DIGITS}g}")


def describe_tally(tally: Tally, confidence: float) -> dict[str, Any]:
    """In JSON types, with rate and interval."""
    return {
        "passed": tally.passed,
        "failed": tally.failed,
        "not_executed": tally.not_executed,
        "infra": tally.infra,
        "judged": tally.judged,
        "rate": tally.rate,
        "interval": list(tally.interval(confidence)),
    }


def count_dimensions(space: Space) -> int:
    """How many numbers `sample` takes: as the campaign says, where an attitude takes three; else one a drawn axis."""
    given: int | None = getattr(space, "dimensions", None)
    return sum(not axis.labels for axis in space.axes) if given is None else given
