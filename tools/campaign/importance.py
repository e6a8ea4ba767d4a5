"""Which axis matters for what: rank correlations for numbers, shares of variance for words.

Why not Sobol's indices: they need runs in Saltelli's pattern, (axes + 2) runs for each point of it, which no plan of lists
or random draws has. These figures can be had of any results, and are honest where the effect is monotonic (numbers) or
anything at all (words); an effect that rises and falls again along a number shows in the scatter, not here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from tools.campaign.results import AxisInfo, RunResult
from tools.campaign.summary import key_of, label_of

Floats = NDArray[np.float64]
FEWEST: Final = 10  # runs, below which nothing is said
RESAMPLED: Final = 200  # bootstrap samples, of few runs
RESAMPLED_LARGE: Final = 100  # of many
MOST_RESAMPLED: Final = 2000  # runs are few; of more a correlation has the interval of Fisher's transform
SEED: Final = 20140317  # of the bootstrap: the same results give the same page
SPEARMAN: Final = 1.06  # variance of Fisher's transform of a rank correlation, times n - 3 (Fieller et al. 1957)


@dataclass(frozen=True, slots=True)
class Importance:
    """How much one axis has to do with one result."""

    axis: str
    target: str
    kind: Literal["rank correlation", "share"]  # partial, -1 to 1; of the variance of ranks, 0 to 1
    effect: float
    low: float
    high: float
    runs: int

    @property
    def weight(self) -> float:
        """The share of variance of either kind, to sort by."""
        return self.effect * self.effect if self.kind == "rank correlation" else self.effect


def list_targets(results: Sequence[RunResult], metrics: Sequence[str]) -> dict[str, Floats]:
    """What axes may have to do with, one number a run, NaN where there is none: passing, margins, metrics."""
    nan = math.nan
    targets = {
        "passing": np.array([nan if r.outcome == "infra" else float(r.outcome == "pass") for r in results]),
    }
    margins: dict[str, Floats] = {}
    for i, result in enumerate(results):
        for verdict in result.verdicts:
            if verdict.margin is not None:
                key = f"margin of {key_of(verdict)}"
                margins.setdefault(key, np.full(len(results), nan))[i] = verdict.margin
    for name in metrics:
        values = [result.metrics.get(name) for result in results]
        targets[name] = np.array([nan if value is None else value for value in values], np.float64)
    return targets | margins


def weigh_axes(results: Sequence[RunResult], axes: Sequence[AxisInfo], targets: dict[str, Floats]) -> list[Importance]:
    """Every axis against every target where both vary in enough runs, the weightiest of each target first."""
    numbers, words = read_axes(results, axes)
    found: list[Importance] = []
    for target, values in targets.items():
        valid = np.isfinite(values)
        for column in numbers.values():
            valid &= np.isfinite(column)
        if valid.sum() < FEWEST or np.ptp(values[valid]) == 0.0:
            continue
        y = _rank(values[valid])
        some = _correlate({name: _rank(x[valid]) for name, x in numbers.items()}, words, valid, y, target)
        some += [_share(name, target, codes[valid], y) for name, codes in words.items() if np.ptp(codes[valid]) > 0]
        found += sorted(some, key=lambda item: -item.weight)
    return found


def read_axes(
    results: Sequence[RunResult], axes: Sequence[AxisInfo]
) -> tuple[dict[str, Floats], dict[str, NDArray[np.int64]]]:
    """The axes whose values are drawn numbers, NaN where a run has none; and the listed ones, as numbers of labels."""
    numbers: dict[str, Floats] = {}
    words: dict[str, NDArray[np.int64]] = {}
    for axis in axes:
        if axis.labels:
            codes: dict[str, int] = {}
            words[axis.name] = np.array([codes.setdefault(label_of(r, axis.name), len(codes)) for r in results])
            continue
        values = [_number(result.values.get(axis.name)) for result in results]
        column = np.array(values, np.float64)
        if np.isfinite(column).any():
            numbers[axis.name] = column
    return numbers, words


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan


def _rank(values: Floats) -> Floats:
    """Ranks from 1, equal values sharing the mean of theirs."""
    _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(counts)
    mean: Floats = (last - 0.5 * (counts - 1))[inverse]
    return mean


def _correlate(
    numbers: dict[str, Floats], words: dict[str, NDArray[np.int64]], valid: Any, y: Floats, target: str
) -> list[Importance]:
    """Partial rank correlations: of each number, the other numbers and all words held fixed (PRCC)."""
    varied = {name: x for name, x in numbers.items() if np.ptp(x) > 0.0}
    if not varied:
        return []
    fixed = [codes[valid] == code for codes in words.values() for code in np.unique(codes[valid])[1:]]
    columns = np.column_stack([*varied.values(), *(column.astype(np.float64) for column in fixed), y])
    effects = _partial(columns, len(varied))
    if len(y) > MOST_RESAMPLED:
        reach = 1.96 * math.sqrt(SPEARMAN / (len(y) - columns.shape[1] - 2))
        middle = np.arctanh(np.clip(effects, -1.0 + 1e-12, 1.0 - 1e-12))
        low, high = np.tanh(middle - reach), np.tanh(middle + reach)
    else:
        rng = np.random.Generator(np.random.PCG64(SEED))
        drawn = [_partial(columns[rng.integers(0, len(y), len(y))], len(varied)) for _ in range(RESAMPLED)]
        low, high = np.percentile(drawn, [2.5, 97.5], axis=0)
    return [
        Importance(name, target, "rank correlation", float(effects[i]), float(low[i]), float(high[i]), len(y))
        for i, name in enumerate(varied)
    ]


def _partial(columns: Floats, count: int) -> Floats:
    """Correlation of each of the first `count` columns with the last one, all others held fixed."""
    centred = columns - columns.mean(axis=0)
    inverse = np.linalg.pinv(centred.T @ centred / _spread(centred), hermitian=True)
    scale = np.sqrt(np.maximum(np.diag(inverse), 1e-300))
    found: Floats = np.clip(-inverse[:count, -1] / (scale[:count] * scale[-1]), -1.0, 1.0)
    return found


def _spread(centred: Floats) -> Floats:
    size = np.sqrt((centred * centred).sum(axis=0))
    size[size == 0.0] = 1.0
    spread: Floats = np.outer(size, size)
    return spread


def _share(axis: str, target: str, codes: NDArray[np.int64], y: Floats) -> Importance:
    """Share of the variance of ranks between the labels: H / (n - 1) of Kruskal & Wallis, eta squared of ranks."""
    rng = np.random.Generator(np.random.PCG64(SEED))
    drawn = []
    for _ in range(RESAMPLED if len(y) <= MOST_RESAMPLED else RESAMPLED_LARGE):
        picked = rng.integers(0, len(y), len(y))
        drawn.append(_eta_squared(codes[picked], y[picked]))
    low, high = np.percentile(drawn, [2.5, 97.5])
    return Importance(axis, target, "share", _eta_squared(codes, y), float(low), float(high), len(y))


def _eta_squared(codes: NDArray[np.int64], y: Floats) -> float:
    centred = y - y.mean()
    total = float(centred @ centred)
    counts = np.bincount(codes)
    sums = np.bincount(codes, weights=centred)
    used = counts > 0
    return float((sums[used] ** 2 / counts[used]).sum() / total) if total > 0.0 else 0.0
