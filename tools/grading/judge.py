"""Judges one expectation on one log. The meaning of each check is stated beside its class in tools/config/expect.py."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus.errors import ConfigError
from tools.config.expect import Above, Below, Equals, Expectation, Holding, RmsBelow, RmsEquals, Settles, Within
from tools.grading.expressions import evaluate, name_signals
from tools.grading.moments import find_moment
from tools.grading.verdict import Verdict, decide
from tools.log.completeness import Completeness, Timetable
from tools.log.mcap_reader import Run

Floats = NDArray[np.floating[Any]]
FEWEST = 2  # samples from which something can be said to settle or to hold


def judge(
    run: Run, item: Expectation, completeness: Completeness | None = None, timetable: Timetable | None = None
) -> Verdict:
    """The verdict on one expectation, under its id where it has one: see `_judge`."""
    verdict = _judge(run, item, completeness, timetable)
    if item.id is None and item.severity is None and not item.text:
        return verdict
    return dataclasses.replace(verdict, id=item.id or "", severity=item.severity or "", text=item.text)


def _judge(run: Run, item: Expectation, completeness: Completeness | None, timetable: Timetable | None) -> Verdict:
    """The verdict on one expectation.

    completeness, timetable : what the log lacks, and of which ticks; an expectation that needs a missing tick is not
                              executed. Without them: the log is taken as it is.
    A signal that is not in the log is not an exception: such an expectation is not executed either.
    """
    try:
        series = evaluate(run, item.signal)
    except ConfigError as error:
        return _unexecuted(item, str(error))
    start_s, unseen = find_moment(run, item.after)
    if unseen:
        return _unexecuted(item, unseen)
    notes = ""
    if completeness is not None and timetable is not None:
        missing, notes = _list_missing(item, start_s, completeness, timetable)
        if missing:
            return _unexecuted(item, missing)
    assert series.t_s is not None
    until_s = math.inf if item.until_s is None else item.until_s
    since_s = series.t_s if item.after is None else series.t_s - start_s
    inside = (since_s >= item.from_s - 1e-9) & (since_s <= until_s + 1e-9)
    t_s, values = since_s[inside], series.values[inside]
    if not t_s.size:
        return _unexecuted(item, f"no sample between {item.from_s:g} s and {until_s:g} s")
    if not np.all(np.isfinite(values)):
        return _unexecuted(item, f"not a number at t = {t_s[~np.isfinite(values)][0]:g} s")
    if t_s.size < FEWEST and (isinstance(item, Settles) or _is_hold(item)):
        return _unexecuted(item, f"one sample between {item.from_s:g} s and {until_s:g} s; it takes {FEWEST} or more")
    with np.errstate(all="ignore"):
        if isinstance(item, Settles):
            verdict = _judge_settling(item, t_s, values)
        elif isinstance(item, RmsBelow | RmsEquals):
            verdict = _judge_rms(item, values)
        else:
            verdict = _judge_holding(item, t_s, values)
    return _add_note(verdict, "; ".join(word for word in (notes, _say_after(item, start_s)) if word))


def _say_after(item: Expectation, start_s: float) -> str:
    return "" if item.after is None else f"times from {item.after}, {start_s:g} s"


def _is_hold(item: Expectation) -> bool:
    return isinstance(item, Below | Above | Within | Equals) and (item.by_s is not None or item.for_s is not None)


def _list_missing(
    item: Expectation, start_s: float, completeness: Completeness, timetable: Timetable
) -> tuple[str, str]:
    """Which ticks that its window needs are missing, and which of them were not run, each in words or empty."""
    topics = {topic for topic, _ in name_signals(item.signal)}
    first = math.ceil((start_s + item.from_s) * timetable.tick_hz - 1e-6)
    last = timetable.ticks - 1
    if item.until_s is not None:
        last = min(last, math.floor((start_s + item.until_s) * timetable.tick_hz + 1e-6))
    near = [
        gap for gap in completeness.gaps  # the value before the window counts too: for rates, and for slower topics
        if gap.topic in topics and gap.last >= first - gap.step and gap.first <= last
    ]  # fmt: skip
    missing, skipped = (
        Completeness(tuple(gap for gap in near if gap.ran is ran), ()).describe() for ran in (True, False)
    )
    words = [missing[0], f"and {len(missing) - 1} more holes"] if len(missing) > 1 else missing
    count = sum((gap.last - gap.first) // gap.step + 1 for gap in near if not gap.ran)
    return ", ".join(words), f"{count} records of its window were not made: {skipped[0]}" if skipped else ""


def _add_note(verdict: Verdict, note: str) -> Verdict:
    if not note:
        return verdict
    return dataclasses.replace(verdict, detail=f"{verdict.detail}; {note}" if verdict.detail else note)


def _unexecuted(item: Expectation, detail: str) -> Verdict:
    return Verdict(item.name, "not executed", None, item.check, None, item.unit, detail, item.source)


def _judge_settling(item: Settles, t_s: Floats, values: Floats) -> Verdict:
    above = np.flatnonzero(np.abs(values) > item.bound)
    settled_s = float(t_s[above[-1]]) if above.size else item.from_s
    words, margins = [], []
    if item.at_s is not None and item.tolerance_s is not None:
        words.append(f"{item.at_s:g} +- {item.tolerance_s:g} s")
        margins.append(item.tolerance_s - abs(settled_s - item.at_s))
    if item.by_s is not None:
        words.append(f"<= {item.by_s:g} s")
        margins.append(item.by_s - settled_s)
    if item.not_before_s is not None:
        words.append(f">= {item.not_before_s:g} s")
        margins.append(settled_s - item.not_before_s)
    bound = f"within {item.bound:g} {item.unit} for good: " + ", ".join(words)
    if above.size and above[-1] == values.size - 1:
        return Verdict(item.name, "fail", None, bound, None, "s", f"still {abs(values[-1]):g} at the end", item.source)
    margin = min(margins)
    # The stamps are multiples of the tick; a time compared with a bound in seconds needs room for rounding.
    return Verdict(item.name, decide(margin >= -1e-9), settled_s, bound, margin, "s", "", item.source)


def _judge_rms(item: RmsBelow | RmsEquals, values: Floats) -> Verdict:
    rms = float(np.sqrt(np.mean(values * values)))
    if isinstance(item, RmsBelow):
        margin, bound = item.bound - rms, f"rms <= {item.bound:g} {item.unit}"
    else:
        margin = item.tolerance - abs(rms - item.value)
        bound = f"rms {item.value:g} +- {item.tolerance:g} {item.unit}"
    detail = "" if math.isfinite(rms) else "the sum of squares is beyond what a number holds"
    return Verdict(item.name, decide(margin >= 0), rms, bound, margin, item.unit, detail, item.source)


def _slack(item: Holding, values: Floats) -> tuple[Floats, str]:
    """How far each sample is inside the condition, and the condition in words."""
    unit = f" {item.unit}" if item.unit else ""
    match item:
        case Below():
            return item.bound - values, f"<= {item.bound:g}{unit}"
        case Above():
            return values - item.bound, f">= {item.bound:g}{unit}"
        case Within():
            return np.minimum(values - item.lower, item.upper - values), f"{item.lower:g} .. {item.upper:g}{unit}"
        case Equals():
            words = f"= {item.value:g}" + (f" +- {item.tolerance:g}" if item.tolerance else "")
            return item.tolerance - np.abs(values - item.value), words + unit


def _judge_holding(item: Holding, t_s: Floats, values: Floats) -> Verdict:
    slack, bound = _slack(item, values)
    if item.by_s is None and item.for_s is None:
        worst = int(np.argmin(slack))
        margin = float(slack[worst])
        detail = f"at t = {t_s[worst]:g} s"
        return Verdict(
            item.name, decide(margin >= 0), float(values[worst]), bound, margin, item.unit, detail, item.source
        )
    spells = _spells(slack >= 0, t_s)
    end_s = float(t_s[-1])
    for_s = item.for_s
    if item.for_s is not None:
        bound += f" for {item.for_s:g} s"
    if item.by_s is not None:
        bound += f" from {item.by_s:g} s at the latest"
        if for_s is None:
            good = [start for start, stop in spells if stop >= end_s]
        else:
            good = [start for start, stop in spells if stop - start >= for_s - 1e-9]
        if not good:
            return Verdict(item.name, "fail", None, bound, None, "s", "the condition never held that long", item.source)
        margin = item.by_s - good[0]
        return Verdict(item.name, decide(margin >= -1e-9), good[0], bound, margin, "s", "", item.source)
    longest = max((stop - start for start, stop in spells), default=0.0)
    margin = longest - (for_s or 0.0)
    return Verdict(item.name, decide(margin >= -1e-9 and bool(spells)), longest, bound, margin, "s", "", item.source)


def _spells(holds: NDArray[np.bool_], t_s: Floats) -> list[tuple[float, float]]:
    """Start and end of every unbroken spell in which the condition holds."""
    edges = np.diff(np.concatenate(([0], holds.astype(np.int8), [0])))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return [(float(t_s[a]), float(t_s[b])) for a, b in zip(starts, stops, strict=True)]
