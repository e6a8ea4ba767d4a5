"""Fly until a pass rate is known well enough."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import count, islice
from typing import Any

from tools.campaign.plan import Evaluate, Point
from tools.campaign.results import Outcome
from tools.campaign.statistics import Interval, Tally, clopper_pearson, confidence_sequence, half_width
from tools.campaign.strategies.answers import Space, describe_tally, outcome_of, require_known, tally_outcomes
from tools.campaign.strategies.settings import UntilSettings


class UntilKnown:
    """Batches of the plan in a shuffled order, round after round with new repeats, until the interval is narrow.

    Shuffled, because the first batch of a plan in its own order would be that of the first axis' first value, and the
    rate is meant of the whole plan.
    """

    def __init__(self, settings: UntilSettings, space: Space) -> None:
        self._settings = settings
        self._space = space

    def run(self, evaluate: Evaluate) -> Mapping[str, Any]:
        """Fly; return rate, interval, how often it was looked at and whether it became as narrow as asked."""
        settings = self._settings
        points = self._draw()
        outcomes: list[Outcome] = []
        looks = 0
        while len(outcomes) < settings.most:
            batch = list(islice(points, min(settings.batch, settings.most - len(outcomes))))
            if not batch:
                break
            results = evaluate(batch)
            require_known(results, settings.pass_rate)
            outcomes += [outcome_of(result, settings.pass_rate) for result in results]
            looks += 1
            if is_known(settings, tally_outcomes(outcomes)):
                break
        return self._describe(tally_outcomes(outcomes), looks)

    def _draw(self) -> Iterator[Point]:
        plan = self._space.points()
        rounds = 1 + max((point.repeat for point in plan), default=0)
        shuffle = random.Random(self._space.seed)
        for turn in count() if plan else ():
            for i in shuffle.sample(range(len(plan)), len(plan)):
                yield replace(plan[i], repeat=plan[i].repeat + turn * rounds)

    def _describe(self, tally: Tally, looks: int) -> dict[str, Any]:
        settings = self._settings
        low, high = interval_of(settings, tally)
        is_reached = is_known(settings, tally)
        rate = "no rate" if tally.rate is None else f"{100.0 * tally.rate:.2f} % pass"
        words = (
            f"{settings.pass_rate}: {rate}, {100.0 * settings.confidence:g} % interval {100.0 * low:.2f} to "
            f"{100.0 * high:.2f} %, of {tally.judged} judged runs in {looks} batches"
        )
        if not is_reached:
            words += f"; not within {100.0 * settings.half_width:g} % to either side after {settings.most} runs"
        if settings.interval == "clopper_pearson" and looks > 1:
            words += f"; the interval was looked at {looks} times (docs/campaigns.md: what that costs)"
        return {
            **describe_tally(tally, settings.confidence),
            "kind": settings.kind,
            "pass_rate": settings.pass_rate,
            "interval": [low, high],
            "interval_kind": settings.interval,
            "confidence": settings.confidence,
            "half_width": settings.half_width,
            "looks": looks,
            "reached": is_reached,
            "summary": [words],
        }


def interval_of(settings: UntilSettings, tally: Tally) -> Interval:
    """The interval that the settings ask for."""
    if settings.interval == "confidence_sequence":
        return confidence_sequence(tally.passed, tally.judged, settings.confidence)
    return clopper_pearson(tally.passed, tally.judged, settings.confidence)


def is_known(settings: UntilSettings, tally: Tally) -> bool:
    """Whether the interval reaches no further than asked to either side of the rate."""
    return tally.rate is not None and half_width(interval_of(settings, tally), tally.rate) <= settings.half_width
