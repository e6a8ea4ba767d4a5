"""Judges what comes to one figure of a window: rms, percentile, counts, integral, mean, variation, monotony."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tools.config.expect import (
    Count,
    EventCount,
    Integral,
    Mean,
    Measuring,
    Monotonic,
    Percentile,
    RmsBelow,
    RmsEquals,
    Variation,
)  # fmt: skip
from tools.grading.verdict import Verdict, decide
from tools.grading.window import Floats, Window


def judge_measure(item: Measuring, window: Window) -> Verdict:
    """The verdict on an expectation of one figure."""
    match item:
        case RmsBelow() | RmsEquals():
            return _judge_rms(item, window.values)
        case Percentile():
            figure = _find_percentile(window.values, item.share)
            return _judge_most(item, figure, f"{item.share:g} % <=", item.unit)
        case Count():
            return _judge_samples(item, window)
        case Monotonic():
            return _judge_monotony(item, window)
        case Integral():
            return _judge_most(item, _integrate(window), "integral <=", f"{item.unit} s".strip())
        case Mean():
            return _judge_mean(item, window.values)
        case Variation():
            return _judge_most(item, _vary(window), "variation <=", f"{item.unit or '1'}/s")


def judge_number(item: Count | EventCount, number: int, what: str, unit: str, detail: str = "") -> Verdict:
    """The verdict on how many there are."""
    words, margins = [], []
    if item.at_least is not None:
        words.append(f">= {item.at_least}")
        margins.append(number - item.at_least)
    if item.at_most is not None:
        words.append(f"<= {item.at_most}")
        margins.append(item.at_most - number)
    margin = min(margins)
    bound = f"{what}: {', '.join(words)}"
    return Verdict(item.name, decide(margin >= 0), number, bound, margin, item.unit or unit, detail, item.source)


def find_rises(up: NDArray[np.bool_], joined: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Where a flag comes up: up, and its neighbour before is not; the first sample too when it is up."""
    before = np.concatenate(([False], up[:-1]))
    apart = np.concatenate(([True], ~joined))
    return up & (~before | apart)


def _judge_most(item: Percentile | Integral | Variation, figure: float, what: str, unit: str) -> Verdict:
    detail = "" if math.isfinite(figure) else "beyond what a number holds"
    margin, bound = item.bound - figure, f"{what} {item.bound:g} {unit}".rstrip()
    return Verdict(item.name, decide(margin >= 0), figure, bound, margin, unit, detail, item.source)


def _judge_rms(item: RmsBelow | RmsEquals, values: Floats) -> Verdict:
    rms = float(np.sqrt(np.mean(values * values)))
    if isinstance(item, RmsBelow):
        margin, bound = item.bound - rms, f"rms <= {item.bound:g} {item.unit}"
    else:
        margin = item.tolerance - abs(rms - item.value)
        bound = f"rms {item.value:g} +- {item.tolerance:g} {item.unit}"
    detail = "" if math.isfinite(rms) else "the sum of squares is beyond what a number holds"
    return Verdict(item.name, decide(margin >= 0), rms, bound, margin, item.unit, detail, item.source)


def _find_percentile(values: Floats, share: float) -> float:
    """Nearest rank: the smallest sample that at least this share of all do not exceed."""
    rank = max(1, math.ceil(share / 100.0 * values.size - 1e-9))
    return float(np.partition(values, rank - 1)[rank - 1])


def _judge_samples(item: Count, window: Window) -> Verdict:
    up = window.values > item.bound
    marks = find_rises(up, window.joined) if item.of == "rises" else up
    where = window.t_s[marks]
    detail = f"first at t = {where[0]:g} s" if where.size else ""
    what = f"{item.of} over {item.bound:g}"
    return judge_number(item, int(marks.sum()), what, item.of, detail)


def _judge_monotony(item: Monotonic, window: Window) -> Verdict:
    values = window.values if item.direction == "rising" else -window.values
    back = np.maximum.accumulate(values) - values
    worst = int(np.argmax(back))
    margin = item.tolerance - float(back[worst])
    bound = f"{item.direction}, back by <= {item.tolerance:g} {item.unit}".rstrip()
    detail = f"at t = {window.t_s[worst]:g} s"
    return Verdict(item.name, decide(margin >= 0), float(back[worst]), bound, margin, item.unit, detail, item.source)


def _integrate(window: Window) -> float:
    steps = np.where(window.joined, np.diff(window.t_s), 0.0)
    return float(np.sum(0.5 * (window.values[1:] + window.values[:-1]) * steps))


def _judge_mean(item: Mean, values: Floats) -> Verdict:
    mean = float(np.mean(values))
    margins = [item.upper - mean] if item.upper is not None else []
    margins += [mean - item.lower] if item.lower is not None else []
    lower, upper = ("" if end is None else f"{end:g}" for end in (item.lower, item.upper))
    bound = (
        f"mean {lower} .. {upper} {item.unit}"
        if lower and upper
        else f"mean {'>=' if lower else '<='} {lower or upper}"
    )
    margin = min(margins)
    return Verdict(item.name, decide(margin >= 0), mean, bound.strip(), margin, item.unit, "", item.source)


def _vary(window: Window) -> float:
    length_s = float(np.sum(np.diff(window.t_s)[window.joined]))
    return float(np.sum(np.abs(np.diff(window.values))[window.joined])) / length_s
