"""Numbers of a run beside its verdicts: one statistic of one signal, over the run or a part of it.

    max, min, mean, rms, median, last   of the samples
    integral                            over time, by trapezoids
    variation                           sum of the changes from sample to sample, without their sign
    percentile                          of the samples, linear between two of them

What a run does not show is None: a signal that it has not, no sample in the window, a sample that is no number.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bus.errors import ConfigError
from tools.campaign.job import Metric
from tools.grading.expressions import evaluate, name_signals
from tools.log.mcap_reader import Run

Floats = NDArray[np.floating[Any]]

STATISTICS: Final[dict[str, Callable[[Floats, Floats, float], Any]]] = {
    "max": lambda t_s, x, percent: np.max(x),
    "min": lambda t_s, x, percent: np.min(x),
    "mean": lambda t_s, x, percent: np.mean(x),
    "rms": lambda t_s, x, percent: np.sqrt(np.mean(x * x)),
    "median": lambda t_s, x, percent: np.median(x),
    "last": lambda t_s, x, percent: x[-1],
    "integral": lambda t_s, x, percent: np.sum(0.5 * (x[1:] + x[:-1]) * np.diff(t_s)),
    "variation": lambda t_s, x, percent: np.sum(np.abs(np.diff(x))),
    "percentile": lambda t_s, x, percent: np.percentile(x, percent),
}


def measure_run(run: Run, metrics: Mapping[str, Metric]) -> dict[str, float | None]:
    """Every metric of a run, in their order."""
    return {name: measure(run, metric) for name, metric in metrics.items()}


def measure(run: Run, metric: Metric) -> float | None:
    """One metric of a run in its unit; None where the run does not show it."""
    try:
        series = evaluate(run, metric.signal)
    except ConfigError:
        return None
    assert series.t_s is not None
    until_s = math.inf if metric.until_s is None else metric.until_s
    inside = (series.t_s >= metric.from_s - 1e-9) & (series.t_s <= until_s + 1e-9)
    t_s, values = series.t_s[inside], series.values[inside]
    if not values.size or not np.all(np.isfinite(values)):
        return None
    with np.errstate(all="ignore"):
        found = float(STATISTICS[metric.statistic](t_s, values, 50.0 if metric.percent is None else metric.percent))
    return found if math.isfinite(found) else None


def list_signals(metrics: Mapping[str, Metric]) -> list[tuple[str, str]]:
    """Topic and field of every signal that the metrics name."""
    return [name for metric in metrics.values() for name in name_signals(metric.signal)]
