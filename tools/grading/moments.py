"""When something happened in a run: from when the times of an expectation count, what ends its window, when faults were.

What `fault NAME`, `event WORDS` and a condition mean is stated in tools/config/expect.py.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tools.config.expect import condition_of, is_name_of
from tools.grading.expressions import evaluate
from tools.log.mcap_reader import Run

SLACK_S = 1e-9  # stamps are multiples of the tick; times in seconds need room for rounding


@dataclass(frozen=True, slots=True)
class Spell:
    """A fault while it was in force [s]. `effect_s` None: it changed nothing; `end_s` infinite: it stayed."""

    id: str
    unit: str
    kind: str
    onset_s: float
    effect_s: float | None
    end_s: float

    def is_meant(self, name: str) -> bool:
        """Whether an expectation means it by this name."""
        return is_name_of(name, (self.id, self.unit, self.kind))


def list_spells(run: Run) -> list[Spell]:
    """Every time that a fault was in force, by its onset."""
    open_spells: dict[str, Spell] = {}
    found: list[Spell] = []
    for record in run.faults:
        own_id, phase, t_s = str(record.get("id", "")), record["phase"], record["t_ns"] / 1e9
        spell = open_spells.get(own_id)
        if phase == "onset":
            open_spells[own_id] = Spell(own_id, record["unit"], record["fault"], t_s, None, math.inf)
            found += [spell] if spell is not None else []
        elif phase == "effect" and spell is not None and spell.effect_s is None:
            open_spells[own_id] = Spell(own_id, spell.unit, spell.kind, spell.onset_s, t_s, spell.end_s)
        elif phase in ("end", "cleared") and spell is not None:
            del open_spells[own_id]
            found.append(Spell(own_id, spell.unit, spell.kind, spell.onset_s, spell.effect_s, t_s))
    return sorted([*found, *open_spells.values()], key=lambda spell: spell.onset_s)


def find_moment(run: Run, after: str | None) -> tuple[float, str]:
    """Time [s] of the first effect of a fault, or of the first event with these words, and an empty text.

    after : as in tools/config/expect.py; None: the start of the run
    Where it did not happen the text says so.
    """
    if after is None:
        return 0.0, ""
    times, missing = _list_moments(run, after)
    return (min(times), "") if times else (0.0, f"{missing}, so that nothing is known of what follows it")


def find_end(run: Run, until: str | None, start_s: float) -> tuple[float, str]:
    """Time [s] of what ends a window, the first at or behind its start, and an empty text; infinite where nothing does.

    until   : as in tools/config/expect.py
    start_s : of the window, from the start of the run
    Where it did not happen the text says so. Raises ConfigError where a condition cannot be evaluated.
    """
    if until is None:
        return math.inf, ""
    condition = condition_of(until)
    if condition is None:
        times, missing = _list_moments(run, until)
        later = [t_s for t_s in times if t_s >= start_s - SLACK_S]
    else:
        series = evaluate(run, condition)
        assert series.t_s is not None
        from_start = series.t_s >= start_s - SLACK_S
        unknown = series.t_s[from_start & ~np.isfinite(series.values)]
        later = series.t_s[from_start & (series.values == 1.0)][:1].tolist()
        if unknown.size and not (later and later[0] <= unknown[0]):
            return math.inf, f"{condition}: not a number at t = {unknown[0]:g} s"
        missing = f"{condition} never holds"
    return (min(later), "") if later else (math.inf, f"{missing} from {start_s:g} s on, so that the window has no end")


def _list_moments(run: Run, moment: str) -> tuple[list[float], str]:
    """Times [s] of a fault's effects or of an event, and what to say when there is none."""
    word, _, name = moment.partition(" ")
    name = name.strip()
    if word == "fault":
        times = [
            record["t_ns"] / 1e9 for record in run.faults
            if record["phase"] == "effect" and is_name_of(name, (record.get("id", ""), record["unit"], record["fault"]))
        ]  # fmt: skip
        return times, f"no fault {name} had an effect"
    return [e["t_ns"] / 1e9 for e in run.events if name in e["message"]], f"no event says {name!r}"
