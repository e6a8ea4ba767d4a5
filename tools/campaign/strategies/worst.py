"""Find the run that comes off worst."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from tools.campaign.plan import Evaluate
from tools.campaign.results import RunResult
from tools.campaign.strategies.answers import Space, count_dimensions, find_scales, require_known, smallest_margin
from tools.campaign.strategies.settings import WorstSettings


class _FoundFail(Exception):
    """A run failed, and no more was asked for."""


@dataclass(slots=True)
class _Record:
    """What has been seen so far."""

    best: RunResult | None = None
    score: float = math.inf
    runs: int = 0
    failed: int = 0
    infra: int = 0
    scales: dict[str, float] = field(default_factory=dict)  # usual size of each requirement's margins
    trace: list[float | None] = field(default_factory=list)  # best score after each generation

    def add(self, result: RunResult, score: float) -> None:
        self.runs += 1
        self.failed += result.outcome == "fail"
        self.infra += result.outcome == "infra"
        if score < self.score:
            self.best, self.score = result, score


class WorstSearch:
    """Differential evolution over the unit cube of the drawn axes; a generation is a batch."""

    def __init__(self, settings: WorstSettings, space: Space) -> None:
        self._settings = settings
        self._space = space

    def run(self, evaluate: Evaluate) -> Mapping[str, Any]:
        """Search; return the worst run, its score and how the search went."""
        import numpy as np
        from scipy.optimize import differential_evolution
        from scipy.stats import qmc

        settings, record = self._settings, _Record()
        size = count_dimensions(self._space)
        rng = np.random.Generator(np.random.PCG64(self._space.seed))
        first = qmc.LatinHypercube(size, seed=rng).random(settings.population)

        def score_generation(places: Any) -> Any:
            results = evaluate([self._space.sample([float(u) for u in place]) for place in places.T])
            require_known(results, settings.requirement)
            if not record.trace:  # of the first generation and kept: the same margin is to score the same throughout
                record.scales = find_scales(results)
            scores = [self.score(result, record.scales) for result in results]
            for result, score in zip(results, scores, strict=True):
                record.add(result, score)
            record.trace.append(record.score if math.isfinite(record.score) else None)
            if settings.stop_at_fail and record.failed:
                raise _FoundFail
            return np.array(scores)

        with suppress(_FoundFail):
            differential_evolution(
                score_generation,
                [(0.0, 1.0)] * size,
                maxiter=settings.generations,
                init=first,
                tol=0.0,
                polish=False,
                updating="deferred",
                vectorized=True,
                seed=rng,
            )
        return self._describe(record)

    def score(self, result: RunResult, scales: Mapping[str, float]) -> float:
        """What is minimised; infinity for a run that was not judged, which is never the worst."""
        settings = self._settings
        if settings.metric:
            value = None if result.outcome == "infra" else result.metrics.get(settings.metric)
            if value is None:
                return math.inf
            return -value if settings.sense == "largest" else value
        margin = smallest_margin(result, scales, settings.requirement)
        return math.inf if margin is None else margin

    def _describe(self, record: _Record) -> dict[str, Any]:
        settings, best = self._settings, record.best
        what = settings.metric or f"margin of {settings.requirement or 'all requirements'}"
        sign = -1.0 if settings.metric and settings.sense == "largest" else 1.0
        found: dict[str, Any] = {
            "kind": settings.kind,
            "objective": what,
            "runs": record.runs,
            "failed": record.failed,
            "infra": record.infra,
            "generations": len(record.trace),
            "trace": [None if score is None else sign * score for score in record.trace],
        }
        if best is None:
            return {**found, "worst": None, "summary": ["worst case: no run could be judged"]}
        value = sign * record.score
        place = ", ".join(f"{axis} {label}" for axis, label in best.labels.items())
        words = f"worst case of {record.runs} runs: run {best.number}, {what} {value:.4g}, {best.outcome}: {place}"
        if not record.failed:
            words += "; no run failed: that is no proof that none can"
        return {
            **found,
            "worst": {"number": best.number, "value": value, "outcome": best.outcome, "values": dict(best.values)},
            "summary": [words],
        }
