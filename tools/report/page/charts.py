"""Charts of a report as SVG text: drawn by matplotlib, with the page's own colour for text and axes.

Fonts are the reader's, and whatever matplotlib draws black takes the colour of the text around it: so the same picture is
right on light, dark and printed pages.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from tools.config.expect import (
    Above,
    Below,
    Count,
    Detects,
    Equals,
    Expectation,
    Isolates,
    Mean,
    NoFalseAlarm,
    Percentile,
    RmsBelow,
    RmsEquals,
    Settles,
    Within,
)  # fmt: skip
from tools.grading.expressions import Series
from tools.report.info import FaultStory
from tools.report.thinning import thin

MAX_POINTS: Final = 1500  # of a line: more cannot be seen on a page
SIZE: Final = (4.8, 2.1)  # inches: the letters are to be read on a telephone too
LINE, BOUND, FAULT, WINDOW = "#2563a8", "#b3261e", "#b45f06", "#8888aa"
PAGE_COLOURS: Final = {LINE: "--chart-line", BOUND: "--chart-bound", FAULT: "--chart-fault", WINDOW: "--chart-window"}
STYLE: Final[dict[Any, Any]] = {
    "svg.fonttype": "none", "svg.hashsalt": "hilsat", "font.size": 8.5, "axes.spines.top": False,
    "axes.spines.right": False, "text.parse_math": False, "axes.formatter.use_mathtext": False,
}  # fmt: skip
MODE_COLOURS: Final = ("#5c626b", "#7a5c00", "#2e7d4f", "#a8221b", "#9c4f08")  # white letters are to be read on them
MODE_NAMES: Final = ("standby", "detumble", "point", "safe", "degraded")


def _paint(draw: Callable[[Any], None], title: str, height: float = SIZE[1], left: float = 0.62) -> str:
    """Return the SVG of one panel; `title` is what a screen reader says of it. Places in inches, `left` for the labels.

    Neither pyplot nor a layout engine: they take longer than the drawing.
    """
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(SIZE[0], height))
        FigureCanvasSVG(figure)
        width = SIZE[0]
        axis = figure.add_axes((left / width, 0.42 / height, 1.0 - (left + 0.12) / width, 1.0 - 0.68 / height))
        draw(axis)
        text = io.StringIO()
        figure.savefig(text, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    return _adopt(text.getvalue(), title)


def _adopt(svg: str, title: str) -> str:
    """Make a file's SVG part of a page: no prolog, the page's colours and fonts, a name for who cannot see it."""
    body = svg[svg.index("<svg") :]
    head_end = body.index(">")
    view = re.search(r'viewBox="[^"]*"', body[:head_end])
    body = body[head_end + 1 :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r"<!--.*?-->\s*", "", body, flags=re.DOTALL)
    body = re.sub(r"font: ([\d.]+px)[^;\"]*", r"font: \1 sans-serif", body)
    body = body.replace("#000000", "currentColor").replace("stroke: black", "stroke: currentColor")
    for colour, name in PAGE_COLOURS.items():
        body = body.replace(colour, f"var({name})")
    body = re.sub(r"<text(?=[ >])", '<text fill="currentColor"', body)
    label = title.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {view[0] if view else ""} role="img" aria-label="{label}">'
    return f"{head}<title>{label}</title>{body}"


def number_ids(svg: str, number: int) -> str:
    """The picture with ids that no other picture of the page has."""
    return re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>c{number}-", svg)


def _use_log_scale(axis: Any) -> None:
    """A logarithmic y axis with plain labels: a formula for each takes a tenth of a second."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    axis.set_yscale("log")
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.yaxis.set_minor_formatter(NullFormatter())


def draw_signal(series: Series, name: str, unit: str, items: list[Expectation], faults: tuple[FaultStory, ...]) -> str:
    """Return a signal over time, with what is asked of it and the faults."""
    t_s, values = series.t_s, series.values
    assert t_s is not None

    def draw(axis: Any) -> None:
        pick = thin(values, MAX_POINTS)
        shown = values[pick]
        bounds = [bound for item in items for bound in _bounds_of(item)]
        largest = float(np.nanmax(np.abs(values), initial=0.0))
        # what settles, and what starts far beyond its bounds: on a straight scale nothing is to be seen of them
        is_log = largest > 0.0 and (
            any(isinstance(item, Settles) for item in items)
            or bool(
                np.nanmin(values, initial=0.0) >= 0.0 and bounds and min(bounds) > 0.0 and largest > 20.0 * max(bounds)
            )
        )
        axis.plot(t_s[pick], np.maximum(np.abs(shown), 1e-12) if is_log else shown, color=LINE, lw=1.2)
        if is_log:
            _use_log_scale(axis)
        for bound in bounds:
            axis.axhline(bound, color=BOUND, lw=0.9, ls="--")
        for item in items:
            end = item.until_s if item.until_s is not None else float(t_s[-1])
            if item.from_s > 0.0 or item.until_s is not None:
                axis.axvspan(item.from_s, end, color=WINDOW, alpha=0.10, lw=0)
        for fault in faults:
            if fault.onset_s is not None:
                axis.axvline(fault.onset_s, color=FAULT, lw=0.8, ls=":")
                end = float(t_s[-1]) if fault.end_s is None else fault.end_s
                axis.axvspan(fault.onset_s, max(end, fault.onset_s), color=FAULT, alpha=0.06, lw=0)
        axis.set_xlim(float(t_s[0]), float(t_s[-1]) if t_s.size > 1 else float(t_s[0]) + 1.0)
        axis.set_title(f"[{unit}]" if unit else "", loc="left", fontsize="medium", pad=3.0, parse_math=False)
        axis.set_xlabel("simulated time [s]")

    ranges = (
        f"from {np.nanmin(values):.4g} to {np.nanmax(values):.4g} {unit}"
        if np.isfinite(values).any()
        else "no number in it"
    )
    return _paint(draw, f"{name} over time, {ranges}")


def _bounds_of(item: Expectation) -> list[float]:
    match item:
        case Settles() | Below() | Above() | RmsBelow() | Percentile() | Count():
            return [item.bound]
        case Detects() | Isolates() | NoFalseAlarm():
            return [item.bound]
        case Within():
            return [item.lower, item.upper]
        case Equals():
            return [item.value]
        case RmsEquals():
            return [item.value]
        case Mean():
            return [bound for bound in (item.lower, item.upper) if bound is not None]
        case _:  # an integral, a variation and what is held against another log have no bound on the signal itself
            return []


def draw_faults(faults: tuple[FaultStory, ...], end_s: float) -> str:
    """Return when which fault was there, a bar each."""
    rows = [fault for fault in faults if fault.onset_s is not None][:40]

    def draw(axis: Any) -> None:
        for row, fault in enumerate(rows):
            onset = fault.onset_s or 0.0
            axis.barh(
                row, (fault.end_s if fault.end_s is not None else end_s) - onset, left=onset, color=FAULT, height=0.6
            )
        axis.set_yticks(range(len(rows)), [f"{fault.unit} {fault.kind}" for fault in rows], parse_math=False)
        axis.invert_yaxis()
        axis.set_xlim(0.0, max(end_s, 1e-3))
        axis.set_xlabel("simulated time [s]")

    words = "; ".join(f"{fault.unit} {fault.kind} from {fault.onset_s:g} s" for fault in rows)
    longest = max((len(f"{fault.unit} {fault.kind}") for fault in rows), default=0)
    return _paint(draw, f"Faults over time: {words}", 0.6 + 0.28 * len(rows), min(0.2 + 0.068 * longest, 2.2))


def draw_modes(t_s: Any, modes: Any, end_s: float) -> str:
    """Return the mode of the flight software over time."""
    starts = np.flatnonzero(np.diff(modes, prepend=modes[0] - 1))
    ends = [*t_s[starts[1:]], end_s]
    spans = [(float(t_s[at]), float(end), int(modes[at])) for at, end in zip(starts, ends, strict=True)]

    def draw(axis: Any) -> None:
        for start, end, mode in spans[:500]:
            axis.barh(0, end - start, left=start, color=MODE_COLOURS[mode % 5], height=0.6)
            if (end - start) > 0.08 * end_s:
                axis.text((start + end) / 2, 0, _name_mode(mode), ha="center", va="center", color="white")
        axis.set_yticks([])
        axis.set_xlim(0.0, max(end_s, 1e-3))
        axis.set_xlabel("simulated time [s]")

    words = ", ".join(f"{_name_mode(mode)} from {start:g} s" for start, _, mode in spans[:12])
    return _paint(draw, f"Modes over time: {words}", 1.0, 0.2)


def _name_mode(mode: int) -> str:
    return MODE_NAMES[mode] if 0 <= mode < len(MODE_NAMES) else f"mode {mode}"


def draw_cycle_times(cycle_us: Any) -> str:
    """Return how long the cycles took."""
    top = float(np.percentile(cycle_us, 99.9)) if cycle_us.size else 1.0

    def draw(axis: Any) -> None:
        counts, edges = np.histogram(np.minimum(cycle_us, top), bins=60)
        axis.stairs(np.maximum(counts, 0.5), edges, baseline=0.5, fill=True, color=LINE)
        _use_log_scale(axis)
        axis.set_ylim(0.5)
        axis.set_xlabel("time of a cycle [us], the longest 0.1 % in the last bar")
        axis.set_title("cycles", loc="left", fontsize="medium", pad=3.0)

    return _paint(
        draw, f"Histogram of cycle times: median {np.median(cycle_us):.0f} us, longest {cycle_us.max():.0f} us"
    )
