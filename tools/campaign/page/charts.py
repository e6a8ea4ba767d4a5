"""Charts of a campaign's page, as SVG text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tools.report.page.drawing import BOUND, LINE, paint

Floats = NDArray[np.float64]
BARS: Final = 40
GOOD, BAD = "#2e7d4f", "#b3261e"
HEIGHT, WIDTH = 2.3, 3.6  # inches
MARGINS: Final = (0.18, 0.97, 0.2, 0.96)


def draw_distribution(values: Floats, passed: NDArray[np.bool_], unit: str, bounds: Sequence[float], name: str) -> str:
    """Return a histogram: runs that passed and others stacked, bounds dashed.

    The outermost 0.5 % on either side are counted in the first and the last bar, or one run would hide the others.
    """
    low, high = np.percentile(values, [0.5, 99.5])
    near = [bound for bound in bounds if low - (high - low) <= bound <= high + (high - low)]
    low, high = min(low, *near) if near else low, max(high, *near) if near else high
    if high <= low:
        low, high = low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0)
    edges = np.linspace(low, high, BARS + 1)
    shown = np.clip(values, low, high)
    good, _ = np.histogram(shown[passed], edges)
    bad, _ = np.histogram(shown[~passed], edges)

    def draw(axis: Any) -> None:
        width = edges[1] - edges[0]
        axis.bar(edges[:-1], good, width, align="edge", color=GOOD, label="passed")
        axis.bar(
            edges[:-1], bad, width, bottom=good, align="edge", color=BAD, hatch="///", ec="white", lw=0.0, label="not"
        )
        for bound in bounds:
            if low <= bound <= high:
                axis.axvline(bound, color=BOUND, lw=1.2, ls="--")
        axis.set_xlim(low - 0.02 * (high - low), high + 0.02 * (high - low))
        axis.set_xlabel(f"[{unit}]" if unit else "", parse_math=False)
        axis.set_ylabel("runs")

    words = f"from {values.min():.4g} to {values.max():.4g} {unit}, median {np.median(values):.4g}".strip()
    return paint(draw, f"Distribution of {name}: {words}, {len(values)} runs", HEIGHT, width=WIDTH, margins=MARGINS)


def draw_scatter(
    x: Floats, y: Floats, passed: NDArray[np.bool_], names: tuple[str, str], units: tuple[str, str]
) -> str:
    """Return one axis against one result, a point a run; those that failed are crosses, in front."""

    def draw(axis: Any) -> None:
        # points as pixels: ten thousand of them as lines of SVG would be a megabyte
        style = {"ls": "", "rasterized": True, "ms": 3.0 if len(x) < 2000 else 1.8}
        axis.plot(x[passed], y[passed], marker="o", color=LINE, mew=0.0, alpha=0.5, **style)
        axis.plot(x[~passed], y[~passed], marker="x", color=BAD, mew=0.8, **style)
        low, high = np.percentile(y, [0.5, 99.5])
        if y.max() - y.min() > 5.0 * (high - low) > 0.0:
            axis.set_ylim(low - 0.2 * (high - low), high + 0.2 * (high - low))
        axis.set_xlabel(_say(names[0], units[0]), parse_math=False)
        axis.set_ylabel(_say(names[1], units[1]), parse_math=False)

    words = f"{names[1]} against {names[0]}: {len(x)} runs, {int((~passed).sum())} of them did not pass"
    return paint(draw, words, HEIGHT, width=WIDTH, margins=MARGINS)


def _say(name: str, unit: str) -> str:
    words = f"{name} [{unit}]" if unit else name
    return words if len(words) <= 44 else f"{words[:41]}..."


def draw_trace(trace: Sequence[float | None], name: str) -> str:
    """Return the worst that was found after each generation of a search."""
    known = [(i, value) for i, value in enumerate(trace) if value is not None]

    def draw(axis: Any) -> None:
        axis.step([i for i, _ in known], [value for _, value in known], where="post", color=LINE, marker="o", ms=3)
        axis.set_xlabel("generation")
        axis.set_ylabel("worst so far")

    words = f"from {known[0][1]:.4g} to {known[-1][1]:.4g}" if known else "nothing judged"
    return paint(draw, f"Worst {name} by generation: {words}", HEIGHT, width=WIDTH, margins=MARGINS)
