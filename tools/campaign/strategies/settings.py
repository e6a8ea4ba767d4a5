"""Settings of what a campaign looks for: the key `strategy` of its file, told apart by `kind`."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Annotated, Final, Literal

from bus.texts import Text
from bus.units import Ge, Gt, Le, Lt, Positive
from bus.words import nearest
from tools.campaign.results import AxisInfo

OUTCOME: Final = "outcome"  # of the whole run, in place of a requirement's id or name
Requirement = Annotated[str, Text(120)]
Confidence = Annotated[float, Gt(0.5), Lt(1)]
Count = Annotated[int, Ge(1), Le(1_000_000)]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanSettings:
    """Fly every run of the plan: the default."""

    kind: Literal["plan"] = "plan"


@dataclass(frozen=True, slots=True, kw_only=True)
class UntilSettings:
    """Fly the plan in batches, again and again with new seeds, until the pass rate is known well enough.

    The interval is looked at after each batch. `clopper_pearson` is exact for one look; docs/campaigns.md has what
    looking often costs (0.2 of its 95 %). `confidence_sequence` holds for any number of looks and needs more runs.
    """

    kind: Literal["until"]
    pass_rate: Requirement = OUTCOME  # of what: `outcome` of the run, or the id or name of a requirement
    half_width: Annotated[float, Gt(0), Lt(0.5)]  # stop when the interval reaches no further than this to either side
    confidence: Confidence = 0.95  # of the interval
    interval: Literal["clopper_pearson", "confidence_sequence"] = "clopper_pearson"  # which interval is looked at
    batch: Count = 50  # runs between two looks
    most: Count = 10_000  # runs at most, infra ones included


@dataclass(frozen=True, slots=True, kw_only=True)
class BoundarySettings:
    """Find where along one axis a requirement begins to fail, for each combination of the list axes.

    First `levels` values are flown, evenly from `lower` to `upper`; then the interval in which the answer changes is
    halved until it is no longer than `tolerance`. All repeats of a level, for all combinations, are one batch.
    """

    kind: Literal["boundary"]
    axis: Annotated[str, Text(80)]  # name of the axis; its own values are not used
    lower: float  # where the search begins, in the axis' unit
    upper: float  # where it ends; above `lower`
    tolerance: Positive  # how well the boundary is to be known, in the axis' unit
    levels: Annotated[int, Ge(2), Le(1000)] = (
        2  # values flown first; more than the two ends show answers that change twice
    )
    repeats: Annotated[int, Ge(1), Le(10_000)] = 5  # runs at each value, each with its own seed
    requirement: Requirement = OUTCOME  # what begins to fail: `outcome` of the run, or the id or name of a requirement
    pass_share: Annotated[float, Gt(0), Le(1)] = 0.5  # share of the judged repeats that must pass for the value to pass
    decide: Literal["majority", "interval"] = (
        "majority"  # by the share itself, or by its interval, with more repeats if need be
    )
    confidence: Confidence = 0.95  # of that interval
    most_repeats: Annotated[int, Ge(1), Le(10_000)] = 40  # at one value, where the interval decides


@dataclass(frozen=True, slots=True, kw_only=True)
class WorstSettings:
    """Search the drawn axes for the run that comes off worst, by differential evolution (Storn & Price 1997).

    Without `requirement` and `metric`: the smallest margin of all requirements, each as a share of its usual size. One
    generation is one batch.
    """

    kind: Literal["worst"]
    requirement: Annotated[str, Text(120)] = (
        ""  # id or name of the requirement whose margin is to be smallest; empty: of all
    )
    metric: Annotated[str, Text(80)] = ""  # name of a metric to search by, in place of margins
    sense: Literal["largest", "smallest"] = "largest"  # of the metric, is the worst
    generations: Annotated[int, Ge(1), Le(10_000)] = 20  # after the first one
    population: Annotated[int, Ge(5), Le(10_000)] = 16  # runs of a generation
    stop_at_fail: bool = False  # stop after the generation in which a run fails


@dataclass(frozen=True, slots=True, kw_only=True)
class IndicesSettings:
    """Find which drawn axis a number depends on, by Sobol's indices (Saltelli et al. 2010).

    Takes samples * (drawn axes + 2) runs in a pattern of its own. Exactly one of `requirement` and `metric` is given.
    """

    kind: Literal["indices"]
    samples: Annotated[int, Ge(8), Le(65_536)] = 256  # points of the pattern; a power of two
    requirement: Annotated[str, Text(120)] = ""  # id or name of the requirement whose margin is looked at
    metric: Annotated[str, Text(80)] = ""  # or the name of a metric
    confidence: Confidence = 0.95  # of the intervals, by bootstrap


StrategySettings = PlanSettings | UntilSettings | BoundarySettings | WorstSettings | IndicesSettings


def list_problems(
    settings: StrategySettings, axes: Sequence[AxisInfo], metrics: Collection[str]
) -> list[tuple[str, str]]:
    """What is wrong with a strategy beside the rest of its campaign: key, and what is wrong; empty when it is sound."""
    match settings:
        case UntilSettings():
            if settings.batch > settings.most:
                return [("batch", f"{settings.batch} runs are more than `most`, {settings.most}")]
        case BoundarySettings():
            return _check_boundary(settings, [axis.name for axis in axes])
        case WorstSettings():
            return _check_worst(settings, axes, metrics)
        case IndicesSettings():
            return _check_indices(settings, axes, metrics)
        case PlanSettings():
            pass
    return []


def _check_boundary(settings: BoundarySettings, names: Sequence[str]) -> list[tuple[str, str]]:
    found = []
    if settings.axis not in names:
        found.append(("axis", _name_unknown(settings.axis, "axis", names)))
    if settings.upper <= settings.lower:
        found.append(("upper", f"{settings.upper:g} is not above lower, {settings.lower:g}"))
    elif settings.tolerance >= settings.upper - settings.lower:
        span = settings.upper - settings.lower
        found.append(("tolerance", f"{settings.tolerance:g} is not below upper - lower, {span:g}: nothing to search"))
    if settings.decide == "interval" and settings.most_repeats < settings.repeats:
        found.append(("most_repeats", f"{settings.most_repeats} is below repeats, {settings.repeats}"))
    return found


def _check_worst(settings: WorstSettings, axes: Sequence[AxisInfo], metrics: Collection[str]) -> list[tuple[str, str]]:
    found = []
    if settings.requirement and settings.metric:
        found.append(("metric", "is given beside requirement; the search goes by one of them"))
    elif settings.metric and settings.metric not in metrics:
        found.append(("metric", _name_unknown(settings.metric, "metric", list(metrics))))
    return found + _require_drawn(settings.kind, axes)


def _check_indices(
    settings: IndicesSettings, axes: Sequence[AxisInfo], metrics: Collection[str]
) -> list[tuple[str, str]]:
    found = []
    if bool(settings.requirement) == bool(settings.metric):
        found.append(("metric", "give one of requirement and metric: what the indices are of"))
    elif settings.metric and settings.metric not in metrics:
        found.append(("metric", _name_unknown(settings.metric, "metric", list(metrics))))
    if settings.samples & (settings.samples - 1):
        near = 1 << settings.samples.bit_length()
        found.append(("samples", f"{settings.samples} is no power of two; give {near // 2} or {near}"))
    return found + _require_drawn(settings.kind, axes)


def _require_drawn(kind: str, axes: Sequence[AxisInfo]) -> list[tuple[str, str]]:
    if all(axis.labels and axis.kind != "categorical" for axis in axes):
        return [("kind", f"{kind} is about drawn axes (uniform, normal, ...), and the campaign has none")]
    return []


def _name_unknown(word: str, what: str, known: Sequence[str]) -> str:
    guess = nearest(word, known)
    near = f"; did you mean {guess!r}?" if guess else ""
    return f"no {what} is called {word!r}{near} There are: {', '.join(known) or 'none'}"
