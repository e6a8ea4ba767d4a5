"""Judges alarms against the faults of the run: detection, isolation, false alarms. See tools/config/expect.py."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plant_server.faults.units import parts_of
from tools.config.expect import Alarming, Detects, Isolates, NoFalseAlarm
from tools.grading.measures import find_rises
from tools.grading.moments import SLACK_S, Spell
from tools.grading.verdict import Outcome, Verdict, decide
from tools.grading.window import Floats, Window

PLACES: Final = {"1": 0, "2": 1, "3": 2, "4": 3, "x": 0, "y": 1, "z": 2}  # of a unit in a vector, by its name's end
SIZES: Final = {"wheel": 4, "gyro": 3}  # elements that a family of units has in a vector


@dataclass(frozen=True, slots=True)
class Alarm:
    """An alarm over the samples of a window; times from the start of the run [s]."""

    t_s: Floats
    up: NDArray[np.bool_]
    joined: NDArray[np.bool_]

    def find_delay(self, spell: Spell, others: list[Spell]) -> float | None:
        """Time [s] from the fault's effect to the alarm; None when it never comes.

        others : faults for which the alarm may be up already
        """
        effect_s = spell.effect_s or 0.0
        before = int(np.searchsorted(self.t_s, effect_s - SLACK_S)) - 1
        if before >= 0 and self.up[before]:
            older = (other for other in others if other is not spell and other.effect_s is not None)
            if any(other.onset_s < effect_s and other.end_s >= self.t_s[before] for other in older):
                return 0.0
        rises = self.t_s[find_rises(self.up, self.joined)]
        later = rises[rises >= effect_s - SLACK_S]
        return max(0.0, float(later[0]) - effect_s) if later.size else None


def judge_alarm(item: Alarming, window: Window, spells: list[Spell]) -> Verdict:
    """The verdict on an alarm. spells: every time that a fault of the run was in force."""
    t_s = window.t_s + window.start_s
    if isinstance(item, NoFalseAlarm):
        return _judge_false_alarms(item, window, t_s, spells)
    begin_s, end_s = window.start_s + window.from_s, window.start_s + window.until_s
    named = [spell for spell in spells if spell.is_meant(item.fault)]
    due = [spell for spell in named if begin_s - SLACK_S <= (spell.effect_s or spell.onset_s) <= end_s + SLACK_S]
    dead = [spell.id for spell in due if spell.effect_s is None]
    if dead or not due:
        why = f"{dead[0]} came on and changed nothing" if dead else f"no fault {item.fault} took effect in the window"
        return _say(item, "not executed", None, why)
    if isinstance(item, Isolates):
        if (word := _explain_places(due, window.values.shape[1])) is not None:
            return _say(item, "not executed", None, word)
        return _judge_isolation(item, window, t_s, due, spells)
    alarm = Alarm(t_s, window.values > item.bound, window.joined)
    delays = [(spell, alarm.find_delay(spell, named)) for spell in due]
    return _judge_delays(item, t_s, delays)


def _explain_places(spells: list[Spell], width: int) -> str | None:
    """Why a unit has no element in a vector of this width; None when each has one."""
    for spell in spells:
        for unit in parts_of(spell.unit):
            family = unit.partition(".")[0]
            if SIZES.get(family, width) != width:
                return f"{family} has {SIZES[family]} alarms; a vector of {width} is another unit's"
            place = PLACES.get(unit.rpartition(".")[2])
            if place is None or place >= width:
                return f"{unit} has no element in a vector of {width}"
    return None


def _places_of(spell: Spell) -> set[int]:
    return {PLACES[end] for unit in parts_of(spell.unit) if (end := unit.rpartition(".")[2]) in PLACES}


def _judge_isolation(item: Isolates, window: Window, t_s: Floats, due: list[Spell], spells: list[Spell]) -> Verdict:
    up = window.values > item.bound
    delays = []
    for spell in due:
        family = spell.unit.partition(".")[0]
        alike = [other for other in spells if other.unit.partition(".")[0] == family]
        for place in sorted(set(range(up.shape[1])) - _places_of(spell)):
            wrong = up[:, place] & (t_s >= (spell.effect_s or 0.0) - SLACK_S)
            wrong &= t_s <= max((spell.effect_s or 0.0) + item.within_s, spell.end_s) + SLACK_S
            for other in alike:
                if place in _places_of(other):
                    wrong &= ~((t_s >= other.onset_s - SLACK_S) & (t_s <= other.end_s + item.within_s + SLACK_S))
            if wrong.any():
                what = f"{spell.id} ({spell.unit}): the alarm of element [{place}] is up at t = {t_s[wrong][0]:g} s"
                return _say(item, "fail", None, what)
        for place in sorted(_places_of(spell)):
            own = [other for other in alike if place in _places_of(other)]
            delays.append((spell, Alarm(t_s, up[:, place], window.joined).find_delay(spell, own)))
    return _judge_delays(item, t_s, delays)


def _judge_delays(item: Detects | Isolates, t_s: Floats, delays: list[tuple[Spell, float | None]]) -> Verdict:
    """The longest of the delays held against the one allowed; None: the alarm did not come while there were samples."""
    step_s = float(np.median(np.diff(t_s))) if t_s.size > 1 else 0.0
    late = [(s, d) for s, d in delays if d is None or d > item.within_s + SLACK_S]
    unseen = [(s, d) for s, d in late if d is None and t_s[-1] + step_s < (s.effect_s or 0.0) + item.within_s - SLACK_S]
    missed = [pair for pair in late if pair not in unseen]
    if missed:
        spell, delay = missed[0]
        came = "no alarm" if delay is None else f"the alarm came after {delay:g} s"
        return _say(item, "fail", delay, f"{spell.id} at {spell.effect_s:g} s: {came}", len(delays))
    if unseen:
        spell = unseen[0][0]
        what = f"{spell.id} at {spell.effect_s:g} s: no alarm up to {t_s[-1]:g} s, where the samples end"
        return _say(item, "not executed", None, what)
    return _say(item, "pass", max(d for _, d in delays if d is not None), "", len(delays))


def _say(item: Detects | Isolates, outcome: Outcome, delay_s: float | None, detail: str, count: int = 0) -> Verdict:
    faults = f", {count} fault{'s' if count > 1 else ''}" if count else ""
    bound = f"alarm within {item.within_s:g} s of {item.fault}{faults}"
    margin = None if delay_s is None else item.within_s - delay_s
    return Verdict(item.name, outcome, delay_s, bound, margin, "s", detail, item.source)


def _judge_false_alarms(item: NoFalseAlarm, window: Window, t_s: Floats, spells: list[Spell]) -> Verdict:
    named = [spell for spell in spells if item.fault is None or spell.is_meant(item.fault)]
    wrong = window.values > item.bound
    for spell in named:
        wrong &= ~((t_s >= spell.onset_s - SLACK_S) & (t_s <= spell.end_s + item.margin_s + SLACK_S))
    count = int(wrong.sum())
    bound = f"no alarm without {item.fault or 'a fault'}"
    detail = f"first at t = {t_s[wrong][0]:g} s" if count else ""
    if not count and item.fault is not None and not any(spell.effect_s is not None for spell in named):
        detail = f"no fault {item.fault} took effect"
        return Verdict(item.name, "not executed", None, bound, None, "samples", detail, item.source)
    return Verdict(item.name, decide(count == 0), count, bound, -count, "samples", detail, item.source)
