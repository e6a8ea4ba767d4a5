"""The samples of a signal that an expectation looks at: those of its window on which its condition holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tools.config.expect import Judged
from tools.grading.expressions import Series, evaluate
from tools.grading.moments import SLACK_S
from tools.log.mcap_reader import Run

Floats = NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True)
class Window:
    """Samples that count. Never empty, and every value is a number."""

    t_s: Floats  # from the moment from which the expectation counts
    values: Floats  # shape (n,), of a vector (n, width)
    joined: NDArray[np.bool_]  # n - 1: no sample that does not count lies between this one and the next
    start_s: float  # that moment, from the start of the run
    from_s: float  # start of the window, from that moment
    until_s: float  # its end; infinite: that of the run


def select_samples(
    run: Run, item: Judged, series: Series, span: tuple[float, float, float], inclusive: bool
) -> Window | str:
    """The samples that count, or why there is nothing to judge.

    span      : from when the expectation counts, from the start of the run, and start and end of the window from there [s]
    inclusive : whether a sample at the end of the window is in it
    Raises ConfigError where the condition cannot be evaluated.
    """
    assert series.t_s is not None
    start_s, from_s, until_s = span
    since_s = series.t_s - start_s if start_s else series.t_s
    last_s = until_s + SLACK_S if inclusive else until_s - SLACK_S
    inside = (since_s >= from_s - SLACK_S) & (since_s <= last_s)
    where = f"between {from_s:g} s and {until_s:g} s"
    if not inside.any():
        return f"no sample {where}"
    counted = inside
    if item.when is not None:
        holds, known = _hold_condition(evaluate(run, item.when), series.t_s)
        unknown = inside & known & ~np.isfinite(holds)
        if unknown.any():
            return f"{item.when}: not a number at t = {since_s[unknown][0]:g} s"
        counted = inside & known & (holds == 1.0)
        if not counted.any():
            return f"no sample {where} on which {item.when}"
    t_s, values = since_s[counted], series.values[counted]
    sound = np.isfinite(values) if values.ndim == 1 else np.isfinite(values).all(axis=1)
    if not sound.all():
        return f"not a number at t = {t_s[~sound][0]:g} s"
    return Window(t_s, values, np.diff(np.flatnonzero(counted)) == 1, start_s, from_s, until_s)


def _hold_condition(condition: Series, t_s: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """The condition's last value before or at each stamp, and where there is one."""
    assert condition.t_s is not None
    index = np.searchsorted(condition.t_s, t_s, side="right") - 1
    known = index >= 0
    if not condition.values.size:
        return np.zeros(t_s.size), known
    return condition.values[np.maximum(index, 0)], known
