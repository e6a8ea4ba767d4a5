"""Charts of a campaign's page, as SVG text.

Written here and not by matplotlib, which takes 0.2 s a picture: a page may have thirty of them. Text and axes have the
colour of the text around them, so that the same picture is right on light, dark and printed pages.
"""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
BARS: Final = 40
WIDTH, HEIGHT = 340.0, 210.0
LEFT, RIGHT, TOP, BOTTOM = 62.0, 332.0, 8.0, 168.0  # of the panel
LINE, GOOD, BAD, PAPER = "var(--chart-line)", "var(--good)", "var(--bad)", "var(--paper)"  # of the page's style
TICKS: Final = 6  # about so many
GRID: Final = 2.0  # points that fall on one half of a unit of the picture are one
LONGEST: Final = 44  # characters of a label


class Panel:
    """Two linear scales with their ticks and labels, and what is drawn between them."""

    def __init__(self, x: tuple[float, float], y: tuple[float, float], x_label: str, y_label: str, title: str) -> None:
        self.x, self.y = _widen(*x), _widen(*y)
        self.x_label, self.y_label, self.title = x_label, y_label, title
        self.parts: list[str] = []

    def place_x(self, values: Any) -> Floats:
        """Horizontal place in the picture."""
        found: Floats = LEFT + (RIGHT - LEFT) * (np.asarray(values, np.float64) - self.x[0]) / (self.x[1] - self.x[0])
        return found

    def place_y(self, values: Any) -> Floats:
        """Vertical place in the picture, downwards."""
        found: Floats = BOTTOM - (BOTTOM - TOP) * (np.asarray(values, np.float64) - self.y[0]) / (self.y[1] - self.y[0])
        return found

    def add(self, path: str, style: str) -> None:
        """A path in places of the picture."""
        if path:
            self.parts.append(f'<path d="{path}" {style}/>')

    def render(self) -> str:
        """The picture; `title` is what a screen reader says of it."""
        label = html.escape(self.title)
        head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" aria-label="{label}">'
        frame = f'<path d="M{LEFT} {TOP}V{BOTTOM}H{RIGHT}" fill="none" stroke="currentColor"/>'
        return "".join([head, f"<title>{label}</title>", *self.parts, frame, *self._list_ticks(), "</svg>"])

    def _list_ticks(self) -> list[str]:
        texts = []
        for value, words in make_ticks(*self.x):
            at = float(self.place_x(value))
            texts.append(f'<path d="M{at:.1f} {BOTTOM}v4" stroke="currentColor"/>{_text(at, BOTTOM + 16, words)}')
        for value, words in make_ticks(*self.y):
            at = float(self.place_y(value))
            texts.append(
                f'<path d="M{LEFT} {at:.1f}h-4" stroke="currentColor"/>{_text(LEFT - 7, at + 4, words, "end")}'
            )
        middle = 0.5 * (TOP + BOTTOM)
        texts.append(_text(0.5 * (LEFT + RIGHT), HEIGHT - 8, self.x_label))
        turned = _text(0.0, 0.0, self.y_label)
        return [*texts, f'<g transform="translate(12 {middle:g}) rotate(-90)">{turned}</g>']


def _text(x: float, y: float, words: str, anchor: str = "middle") -> str:
    shown = words if len(words) <= LONGEST else f"{words[: LONGEST - 3]}..."
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-size="11" font-family="sans-serif" '
        f'fill="currentColor">{html.escape(shown)}</text>'
    )


def _widen(low: float, high: float) -> tuple[float, float]:
    if high > low:
        return low, high
    reach = 0.5 * abs(low) or 0.5
    return low - reach, high + reach


def make_ticks(low: float, high: float) -> list[tuple[float, str]]:
    """Round numbers between two, with their words: steps of 1, 2 or 5 times a power of ten."""
    raw = (high - low) / TICKS
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= raw * (1.0 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    largest = max(abs(low), abs(high))
    is_plain = 1e-4 <= largest < 1e6 and decimals <= 6
    return [(i * step, f"{i * step:.{decimals}f}" if is_plain else f"{i * step:.3g}") for i in range(first, last + 1)]


def draw_distribution(values: Floats, passed: Bools, unit: str, bounds: Sequence[float], name: str) -> str:
    """Return a histogram: runs that passed, others striped on top of them, bounds dashed.

    The outermost 0.5 % on either side are counted in the first and the last bar, or one run would hide the others.
    """
    low, high = (float(x) for x in np.percentile(values, [0.5, 99.5]))
    near = [bound for bound in bounds if low - (high - low) <= bound <= high + (high - low)]
    low, high = _widen(min([low, *near]), max([high, *near]))
    edges = np.linspace(low, high, BARS + 1)
    shown = np.clip(values, low, high)
    good, bad = np.histogram(shown[passed], edges)[0], np.histogram(shown[~passed], edges)[0]
    reach = 0.02 * (high - low)
    words = f"from {values.min():.4g} to {values.max():.4g} {unit}, median {np.median(values):.4g}".strip()
    panel = Panel(
        (low - reach, high + reach), (0.0, float((good + bad).max()) or 1.0), f"[{unit}]" if unit else "", "runs",
        f"Distribution of {name}: {words}, {len(values)} runs, {int((~passed).sum())} of them did not pass",
    )  # fmt: skip
    nothing = np.zeros_like(good)
    panel.add(_outline(panel, edges, nothing, good), f'style="fill:{GOOD}"')
    panel.add(_outline(panel, edges, good, good + bad), f'style="fill:{BAD}"')
    panel.add(_stripes(panel, edges, good, good + bad), f'style="stroke:{PAPER}" fill="none"')
    for bound in bounds:
        if low <= bound <= high:
            at = float(panel.place_x(bound))
            panel.add(f"M{at:.1f} {TOP}V{BOTTOM}", f'style="stroke:{BAD}" stroke-width="1.5" stroke-dasharray="5 3"')
    return panel.render()


def _outline(panel: Panel, edges: Floats, lower: NDArray[np.int64], upper: NDArray[np.int64]) -> str:
    """Bars between two steps, those of no height left out."""
    x, bottom, top = panel.place_x(edges), panel.place_y(lower), panel.place_y(upper)
    return "".join(
        f"M{x[i]:.1f} {bottom[i]:.1f}V{top[i]:.1f}H{x[i + 1]:.1f}V{bottom[i]:.1f}z"
        for i in range(len(upper))
        if upper[i] > lower[i]
    )


def _stripes(panel: Panel, edges: Floats, lower: NDArray[np.int64], upper: NDArray[np.int64]) -> str:
    """Lines across the same bars: what did not pass is told by more than colour."""
    x, bottom, top = panel.place_x(edges), panel.place_y(lower), panel.place_y(upper)
    return "".join(
        f"M{x[i]:.1f} {y:.1f}H{x[i + 1]:.1f}"
        for i in range(len(upper))
        if upper[i] > lower[i]
        for y in np.arange(bottom[i] - 2.0, top[i], -4.0)
    )


def draw_scatter(x: Floats, y: Floats, passed: Bools, names: tuple[str, str], units: tuple[str, str]) -> str:
    """Return one axis against one result, a point a run; those that did not pass are crosses, in front.

    The outermost 0.5 % are drawn on the edge where they are far away. Points that fall on each other are one.
    """
    low, high = (float(v) for v in np.percentile(y, [0.5, 99.5]))
    reach = 0.2 * (high - low)
    if y.max() - y.min() <= 5.0 * (high - low) or reach == 0.0:
        low, high, reach = float(y.min()), float(y.max()), 0.03 * float(y.max() - y.min())
    x_reach = 0.03 * float(x.max() - x.min())
    panel = Panel(
        (float(x.min()) - x_reach, float(x.max()) + x_reach), (low - reach, high + reach),
        _say(names[0], units[0]), _say(names[1], units[1]),
        f"{names[1]} against {names[0]}: {len(x)} runs, {int((~passed).sum())} of them did not pass",
    )  # fmt: skip
    shown = np.clip(y, low - reach, high + reach)
    size = 4.0 if len(x) < 1000 else 2.5
    dots = "".join(f"M{a:g} {b:g}h0" for a, b in _merge(panel, x[passed], shown[passed]))
    panel.add(dots, f'style="stroke:{LINE}" stroke-width="{size}" stroke-linecap="round" stroke-opacity="0.6"')
    arm = 0.6 * size
    crosses = "".join(
        f"M{a - arm:g} {b - arm:g}l{2 * arm:g} {2 * arm:g}m0 {-2 * arm:g}l{-2 * arm:g} {2 * arm:g}"
        for a, b in _merge(panel, x[~passed], shown[~passed])
    )
    panel.add(crosses, f'style="stroke:{BAD}" stroke-width="0.9" fill="none"')
    return panel.render()


def _merge(panel: Panel, x: Floats, y: Floats) -> list[tuple[float, float]]:
    places = np.column_stack([panel.place_x(x), panel.place_y(y)])
    rows: list[tuple[float, float]] = [tuple(row) for row in np.unique(np.round(places * GRID), axis=0) / GRID]
    return rows


def _say(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def draw_trace(trace: Sequence[float | None], name: str) -> str:
    """Return the worst that was found after each generation of a search."""
    known = [(i, value) for i, value in enumerate(trace) if value is not None]
    words = f"from {known[0][1]:.4g} to {known[-1][1]:.4g}" if known else "nothing judged"
    values = [value for _, value in known] or [0.0]
    panel = Panel(
        (0.0, max(1.0, len(trace) - 1.0)), (min(values), max(values)), "generation", "worst so far",
        f"Worst {name} by generation: {words}",
    )  # fmt: skip
    places = [(float(panel.place_x(i)), float(panel.place_y(value))) for i, value in known]
    line = "".join(f"H{x:.1f}V{y:.1f}" if i else f"M{x:.1f} {y:.1f}" for i, (x, y) in enumerate(places))
    panel.add(line, f'style="stroke:{LINE}" stroke-width="1.5" fill="none"')
    panel.add(
        "".join(f"M{x:.1f} {y:.1f}h0" for x, y in places),
        f'style="stroke:{LINE}" stroke-width="5" stroke-linecap="round"',
    )
    return panel.render()
