"""Find which drawn axis a number of the runs depends on: Sobol's indices."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from tools.campaign.plan import Evaluate
from tools.campaign.results import RunResult
from tools.campaign.strategies.answers import Space, count_dimensions, find_verdict, require_known
from tools.campaign.strategies.settings import IndicesSettings

RESAMPLED: Final = 200  # bootstrap samples of the intervals


class SobolIndices:
    """Runs in Saltelli's pattern (2010), `samples` * (axes + 2) of them, by scipy.stats.sobol_indices."""

    def __init__(self, settings: IndicesSettings, space: Space) -> None:
        self._settings = settings
        self._space = space

    def run(self, evaluate: Evaluate) -> Mapping[str, Any]:
        """Fly; return for each axis the share of variance it makes alone, and with all others, with intervals."""
        import numpy as np
        import scipy.stats

        settings = self._settings
        size = count_dimensions(self._space)
        unknown: list[int] = []
        seen: set[float] = set()

        def measure(places: Any) -> Any:
            results = evaluate([self._space.sample([float(u) for u in place]) for place in places.T])
            require_known(results, settings.requirement)
            values = [self._value(result) for result in results]
            unknown.extend(r.number for r, value in zip(results, values, strict=True) if not math.isfinite(value))
            known = [value for value in values if math.isfinite(value)]
            seen.update(known)
            middle = float(np.median(known)) if known else 0.0
            return np.array([[value if math.isfinite(value) else middle for value in values]])

        rng = np.random.Generator(np.random.PCG64(self._space.seed))
        with np.errstate(all="ignore"):
            found = scipy.stats.sobol_indices(
                func=measure, n=settings.samples, dists=[scipy.stats.uniform()] * size, random_state=rng
            )
            varies = len(seen) > 1
            spread = found.bootstrap(confidence_level=settings.confidence, n_resamples=RESAMPLED) if varies else None
        return self._describe(found, spread, unknown, settings.samples * (size + 2))

    def _value(self, result: RunResult) -> float:
        if result.outcome == "infra":
            return math.nan
        if self._settings.metric:
            value = result.metrics.get(self._settings.metric)
        else:
            verdict = find_verdict(result, self._settings.requirement)
            value = verdict.margin if verdict else None
        return math.nan if value is None else value

    def _describe(self, found: Any, spread: Any, unknown: Sequence[int], runs: int) -> dict[str, Any]:
        settings = self._settings
        what = settings.metric or f"margin of {settings.requirement}"
        rows = []
        for i, name in enumerate(name_dimensions(self._space) if spread is not None else ()):
            row: dict[str, Any] = {"axis": name}
            for key in ("first_order", "total_order"):
                interval = getattr(spread, key).confidence_interval
                row[key] = float(getattr(found, key).flat[i])
                row[f"{key}_interval"] = [_finite(interval.low.flat[i]), _finite(interval.high.flat[i])]
            rows.append(row)
        words = [
            f"{what}: {row['axis']} alone makes {row['first_order']:.2f} of the variance, with the others "
            f"{row['total_order']:.2f}"
            for row in sorted(rows, key=lambda row: -row["total_order"])
        ] or [f"{what}: it does not vary, or no run could be judged"]
        if unknown:
            words.append(
                f"NOT TRUE OF ALL RUNS: {len(unknown)} of {runs}, such as #{unknown[0]}, have no such number and were "
                "taken as the median"
            )
        return {
            "kind": settings.kind,
            "objective": what,
            "runs": runs,
            "unknown": len(unknown),
            "indices": rows,
            "summary": words,
        }


def name_dimensions(space: Space) -> list[str]:
    """What each dimension of the unit cube is: the names of drawn axes where each takes one."""
    names = [axis.name for axis in space.axes if not axis.labels or axis.kind == "categorical"]
    size = count_dimensions(space)
    return names if len(names) == size else [f"dimension {i}" for i in range(size)]


def _finite(value: Any) -> float | None:
    return float(value) if math.isfinite(value) else None
