"""Charts of a report, as SVG text."""

from __future__ import annotations

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
from tools.report.page.drawing import BOUND, FAULT, LINE, WINDOW, paint, use_log_scale
from tools.report.thinning import thin

MAX_POINTS: Final = 1500  # of a line: more cannot be seen on a page
MODE_COLOURS: Final = ("#5c626b", "#7a5c00", "#2e7d4f", "#a8221b", "#9c4f08")  # white letters are to be read on them
MODE_NAMES: Final = ("standby", "detumble", "point", "safe", "degraded")


def draw_signal(series: Series, name: str, unit: str, items: list[Expectation], faults: tuple[FaultStory, ...]) -> str:
    """Return a signal over time, with what is asked of it and the faults."""
    t_s, values = series.t_s, series.values
    assert t_s is not None

    def draw(axis: Any) -> None:
        bounds = [bound for item in items for bound in _bounds_of(item)]
        largest = float(np.nanmax(np.abs(values), initial=0.0))
        # what settles, and what starts far beyond its bounds: on a straight scale nothing is to be seen of them
        is_log = largest > 0.0 and (
            any(isinstance(item, Settles) for item in items)
            or bool(
                np.nanmin(values, initial=0.0) >= 0.0 and bounds and min(bounds) > 0.0 and largest > 20.0 * max(bounds)
            )
        )
        for column in values.reshape(len(values), -1).T:  # one, but for alarms of several units
            pick = thin(column, MAX_POINTS)
            shown = np.maximum(np.abs(column[pick]), 1e-12) if is_log else column[pick]
            axis.plot(t_s[pick], shown, color=LINE, lw=1.2)
        if is_log:
            use_log_scale(axis)
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
    return paint(draw, f"{name} over time, {ranges}")


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
    return paint(draw, f"Faults over time: {words}", 0.6 + 0.28 * len(rows), min(0.2 + 0.068 * longest, 2.2))


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
    return paint(draw, f"Modes over time: {words}", 1.0, 0.2)


def _name_mode(mode: int) -> str:
    return MODE_NAMES[mode] if 0 <= mode < len(MODE_NAMES) else f"mode {mode}"


def draw_cycle_times(cycle_us: Any) -> str:
    """Return how long the cycles took."""
    top = float(np.percentile(cycle_us, 99.9)) if cycle_us.size else 1.0

    def draw(axis: Any) -> None:
        counts, edges = np.histogram(np.minimum(cycle_us, top), bins=60)
        axis.stairs(np.maximum(counts, 0.5), edges, baseline=0.5, fill=True, color=LINE)
        use_log_scale(axis)
        axis.set_ylim(0.5)
        axis.set_xlabel("time of a cycle [us], the longest 0.1 % in the last bar")
        axis.set_title("cycles", loc="left", fontsize="medium", pad=3.0)

    return paint(
        draw, f"Histogram of cycle times: median {np.median(cycle_us):.0f} us, longest {cycle_us.max():.0f} us"
    )
