"""Judges one expectation on one log. The meaning of each check is stated beside its class in tools/config/expect.py."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus.errors import ConfigError
from bus.telemetry.events import EVENTS, FAULTS
from tools.config.expect import (
    Above,
    Below,
    Detects,
    Equals,
    EventCount,
    Expectation,
    Holding,
    Integral,
    Isolates,
    Judging,
    Matches,
    Monotonic,
    NoFalseAlarm,
    Settles,
    Variation,
    Within,
    expressions_of,
)  # fmt: skip
from tools.grading.alarms import judge_alarm
from tools.grading.expressions import evaluate, name_signals
from tools.grading.measures import find_rises, judge_measure, judge_number
from tools.grading.moments import SLACK_S, find_end, find_moment, list_spells
from tools.grading.verdict import Verdict, decide
from tools.grading.window import Window, select_samples
from tools.log.completeness import Completeness, Timetable
from tools.log.mcap_reader import Run

Floats = NDArray[np.floating[Any]]
FEWEST = 2  # samples from which something can be said to settle or to hold


def judge(
    run: Run,
    item: Expectation,
    completeness: Completeness | None = None,
    timetable: Timetable | None = None,
    reference: Run | None = None,
) -> Verdict:
    """The verdict on one expectation, under its id where it has one.

    completeness, timetable : what the log lacks, and of which ticks; an expectation that needs a missing tick is not
                              executed. Without them: the log is taken as it is.
    reference               : the log that `matches` holds this one against
    A signal that is not in the log is not an exception: such an expectation is not executed either.
    """
    try:
        verdict = _judge(run, item, completeness, timetable, reference)
    except ConfigError as error:
        verdict = _unexecuted(item, str(error))
    if item.id is None and item.severity is None and not item.text:
        return verdict
    return dataclasses.replace(verdict, id=item.id or "", severity=item.severity or "", text=item.text)


def _judge(
    run: Run, item: Expectation, completeness: Completeness | None, timetable: Timetable | None, reference: Run | None
) -> Verdict:
    """The verdict on one expectation: see `judge`. Raises ConfigError where a signal or a condition cannot be evaluated."""
    series = None if isinstance(item, EventCount) else evaluate(run, item.signal, vector=isinstance(item, Isolates))
    start_s, unseen = find_moment(run, item.after)
    if unseen:
        return _unexecuted(item, unseen)
    ended_s, unseen = find_end(run, item.until, start_s + item.from_s)
    ended_s -= start_s
    until_s = math.inf if item.until_s is None else item.until_s
    is_last_in = until_s < ended_s or item.until is None
    span = (start_s, item.from_s, min(until_s, ended_s))
    notes = ""
    if timetable is not None and item.after is not None and (late := _explain_late(item, span, timetable)):
        return _unexecuted(item, late)
    if completeness is not None and timetable is not None:
        missing, notes = _list_missing(run, item, span, completeness, timetable)
        if missing:
            return _unexecuted(item, missing)
    if unseen:
        return _unexecuted(item, unseen)
    if isinstance(item, EventCount):
        verdict = _judge_events(run, item, span, is_last_in)
    else:
        assert series is not None
        window = select_samples(run, item, series, span, is_last_in)
        if isinstance(window, str):
            return _unexecuted(item, window)
        with np.errstate(all="ignore"):
            verdict = _judge_window(run, item, window, reference)
    return _add_note(verdict, "; ".join(word for word in (notes, _say_moments(item, span)) if word))


def _explain_late(item: Expectation, span: tuple[float, float, float], timetable: Timetable) -> str:
    """Why a window or a time that counts from a moment of the run is not seen whole; empty where it is."""
    start_s, from_s, until_s = span
    end_s = timetable.ticks / timetable.tick_hz
    by_s = getattr(item, "by_s", None) or 0.0
    times = {"starts": from_s, "ends": until_s if math.isfinite(until_s) else 0.0, "goes at least to its by_s": by_s}
    for what, time_s in times.items():
        if start_s + time_s > end_s + SLACK_S:
            return f"the window {what} at {start_s + time_s:g} s, the run ends at {end_s:g} s"
    return ""


def _judge_window(run: Run, item: Judging, window: Window, reference: Run | None) -> Verdict:
    """The verdict on an expectation of the samples of a window."""
    if window.t_s.size < FEWEST and (isinstance(item, Settles | Monotonic | Integral | Variation) or _is_hold(item)):
        end = f"between {window.from_s:g} s and {window.until_s:g} s"
        return _unexecuted(item, f"one sample {end}; it takes {FEWEST} or more")
    if isinstance(item, Integral | Variation) and not window.joined.any():
        return _unexecuted(item, f"no two neighbouring samples on which {item.when}")
    match item:
        case Settles():
            return _judge_settling(item, window.t_s, window.values)
        case Below() | Above() | Within() | Equals():
            return _judge_holding(item, window)
        case Detects() | Isolates() | NoFalseAlarm():
            if word := _explain_events(run, FAULTS.name):
                return _unexecuted(item, word)
            return judge_alarm(item, window, list_spells(run))
        case Matches():
            return _judge_match(item, window, reference)
        case _:
            return judge_measure(item, window)


def _judge_events(run: Run, item: EventCount, span: tuple[float, float, float], is_last_in: bool) -> Verdict:
    if word := _explain_events(run, EVENTS.name):
        return _unexecuted(item, word)
    start_s, from_s, until_s = span
    end_s = until_s + (SLACK_S if is_last_in else -SLACK_S)
    times = [event["t_ns"] / 1e9 - start_s for event in run.events if item.event in event["message"]]
    inside = [t_s for t_s in times if from_s - SLACK_S <= t_s <= end_s]
    detail = f"first at t = {inside[0]:g} s" if inside else ""
    return judge_number(item, len(inside), f"lines with {item.event!r}", "lines", detail)


def _explain_events(run: Run, topic: str) -> str:
    """Why nothing is known of what happened now and then; empty where the log has all of it, as far as it tells."""
    if topic not in run.topics:
        return f"the log has no topic {topic}"
    _ = run.events if topic == EVENTS.name else run.faults  # reading counts the damage
    damage = [what for what in run.damage if what.startswith(topic)]
    if damage or run.lost_chunks:
        return f"{topic} may lack records: {damage[0] if damage else run.lost_chunks[0].why}"
    return ""


def _judge_match(item: Matches, window: Window, reference: Run | None) -> Verdict:
    if reference is None:
        return _unexecuted(item, "no reference log was given: hilsat grade LOG --against LOG2")
    try:
        other = evaluate(reference, item.signal)
    except ConfigError as error:
        return _unexecuted(item, f"{reference.path}: {error}")
    assert other.t_s is not None
    stamps_s = window.t_s + window.start_s
    first, last = np.searchsorted(other.t_s, (stamps_s[0] - SLACK_S, stamps_s[-1] + SLACK_S))
    theirs_s, values = other.t_s[first:last], other.values[first:last]
    if item.when is not None and theirs_s.size:
        near = np.minimum(np.searchsorted(theirs_s, stamps_s - SLACK_S), theirs_s.size - 1)
        theirs_s, values = theirs_s[near], values[near]
    if theirs_s.size != stamps_s.size or not np.all(np.abs(theirs_s - stamps_s) <= SLACK_S):
        return _unexecuted(item, f"{reference.path} has other stamps: {theirs_s.size} samples for {stamps_s.size} here")
    if not np.isfinite(values).all():
        return _unexecuted(item, f"{reference.path}: not a number at t = {theirs_s[~np.isfinite(values)][0]:g} s")
    difference = np.abs(window.values - values)
    worst = int(np.argmax(difference))
    margin = item.tolerance - float(difference[worst])
    bound = f"as in the reference +- {item.tolerance:g} {item.unit}".rstrip()
    detail = f"at t = {window.t_s[worst]:g} s"
    return Verdict(
        item.name, decide(margin >= 0), float(difference[worst]), bound, margin, item.unit, detail, item.source
    )


def _say_moments(item: Expectation, span: tuple[float, float, float]) -> str:
    words = [] if item.after is None else [f"times from {item.after}, {span[0]:g} s"]
    return ", ".join(words + ([] if item.until is None else [f"until {item.until}, {span[2]:g} s"]))


def _is_hold(item: Expectation) -> bool:
    return isinstance(item, Below | Above | Within | Equals) and (item.by_s is not None or item.for_s is not None)


def _list_missing(
    run: Run,
    item: Expectation,
    span: tuple[float, float, float],
    completeness: Completeness,
    timetable: Timetable,
) -> tuple[str, str]:
    """Which ticks that its window needs are missing, and which of them were not run, each in words or empty."""
    topics = {topic for expression in expressions_of(item) for topic, _ in name_signals(expression)}
    if isinstance(item, EventCount):  # has no ticks of its own: what either side says comes with its ticks
        topics |= {"/truth/attitude", "/fsw/attitude"}
    start_s, from_s, until_s = span
    first = math.ceil((start_s + from_s) * timetable.tick_hz - 1e-6)
    last = timetable.ticks - 1
    if until_s < math.inf:
        last = min(last, math.floor((start_s + until_s) * timetable.tick_hz + 1e-6))
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


def _judge_holding(item: Holding, window: Window) -> Verdict:
    t_s, values = window.t_s, window.values
    slack, bound = _slack(item, values)
    if item.by_s is None and item.for_s is None:
        worst = int(np.argmin(slack))
        margin = float(slack[worst])
        detail = f"at t = {t_s[worst]:g} s"
        return Verdict(
            item.name, decide(margin >= 0), float(values[worst]), bound, margin, item.unit, detail, item.source
        )
    apart = ~window.joined if item.for_s is not None else np.zeros(window.joined.size, np.bool_)
    spells = _spells(slack >= 0, t_s, apart)
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


def _spells(holds: NDArray[np.bool_], t_s: Floats, apart: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Start and end of every spell in which the condition holds, unbroken also where a sample is `apart` from the next."""
    starts = np.flatnonzero(find_rises(holds, ~apart))
    stops = np.flatnonzero(find_rises(holds[::-1], ~apart[::-1])[::-1])
    return [(float(t_s[a]), float(t_s[b])) for a, b in zip(starts, stops, strict=True)]
