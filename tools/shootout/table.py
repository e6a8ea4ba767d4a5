"""The outcome of a shootout in words: a Markdown table, and one object for JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from tools.config.scenario import Scenario
from tools.shootout.figures import BOUNDS_DEG, Figures
from tools.shootout.flights import FAILED, FLEW, NOT_FLOWN, REFUSED, Outcome

HEADINGS = (
    "law", "allocator", "observer", "wheel health", "5 deg [s]", "1 deg [s]", "0.1 deg [s]", "steady [deg]",
    "impulse [N m s]", "peak [N m]", "variation [N m/s]", "energy [J]", "u^2 [N^2 m^2 s]", "saturated [%]",
    "pointing [%]",
)  # fmt: skip
WORDS = {REFUSED: "cannot fly", FAILED: "failed", NOT_FLOWN: "not flown"}


@dataclass(frozen=True, slots=True)
class Shootout:
    """What was flown and what came of it."""

    scenario: Scenario  # what all pairs have in common
    settings: tuple[str, ...]  # of the command line
    outcomes: Sequence[Outcome]
    signal: int = 0  # that cut it short

    def as_text(self) -> str:
        """Return the table with what is to be known of it, in Markdown."""
        scenario = self.scenario
        end_s = scenario.duration_s
        rows = [HEADINGS, *(_make_row(outcome, end_s) for outcome in self.outcomes)]
        lines = [f"{scenario.name}: {scenario.title}" if scenario.title else scenario.name]
        faults = f"{len(scenario.faults)} faults" if len(scenario.faults) != 1 else "1 fault"
        lines += [
            f"{end_s:g} s at {scenario.clock.tick_hz} Hz, seed {scenario.seed}, {faults}; every law and allocator with "
            "its defaults" + (f", but for {', '.join(self.settings)}" if self.settings else ""),
            "",
            *_align(rows),
            "",
            *_list_notes(self.outcomes),
        ]
        if self.signal:
            done = sum(outcome.state != NOT_FLOWN for outcome in self.outcomes)
            lines.append(f"CUT SHORT by a signal: {done} of {len(self.outcomes)} pairs are done")
        return "\n".join(lines).rstrip()

    def as_dict(self) -> dict[str, Any]:
        """Return the same in JSON types."""
        scenario = self.scenario
        return {
            "scenario": scenario.name,
            "duration_s": scenario.duration_s,
            "tick_hz": scenario.clock.tick_hz,
            "seed": scenario.seed,
            "settings": list(self.settings),
            "cut_short": bool(self.signal),
            "pairs": [_make_dict(outcome) for outcome in self.outcomes],
        }


def _make_dict(outcome: Outcome) -> dict[str, Any]:
    return {
        "controller": outcome.pair.controller,
        "allocator": outcome.pair.allocator,
        "observer": outcome.observer,
        "wheel_health": outcome.wheel_health,
        "note": outcome.pair.companions.note,
        "outcome": outcome.state,
        "reason": outcome.reason,
        "figures": None if outcome.figures is None else asdict(outcome.figures),
    }


def _make_row(outcome: Outcome, end_s: float) -> tuple[str, ...]:
    head = (outcome.pair.controller, outcome.pair.allocator, outcome.observer or "-", outcome.wheel_health or "-")
    if outcome.figures is None:
        return (*head, WORDS[outcome.state], *["-"] * (len(HEADINGS) - len(head) - 1))
    return (*head, *_list_cells(outcome.figures, end_s))


def _list_cells(figures: Figures, end_s: float) -> list[str]:
    settled = [figures.settled_5_deg_s, figures.settled_1_deg_s, figures.settled_01_deg_s]
    return [
        *(f"not by {end_s:g}" if time_s is None else f"{time_s:.1f}" for time_s in settled),
        f"{figures.steady_deg:.2g}",
        f"{figures.impulse_nms:.3g}",
        f"{figures.peak_rw_nm:.4f}",
        f"{figures.variation_nm_s:.2g}",
        f"{figures.energy_j:.3g}",
        f"{figures.effort_n2m2s:.3g}",
        f"{100.0 * figures.saturated_share:.1f}",
        f"{100.0 * figures.pointing_share:.1f}",
    ]


def _align(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    texts = [" | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    rule = "|".join("-" * (width + 2) for width in widths)
    return [f"| {texts[0]} |", f"|{rule}|", *(f"| {text} |" for text in texts[1:])]


def _list_notes(outcomes: Sequence[Outcome]) -> list[str]:
    """Why a pair did not fly, and what to know of a law's defaults, each once."""
    lines = [
        f"{outcome.pair.name}: {WORDS[outcome.state]}: {' '.join(outcome.reason.split())}"
        for outcome in outcomes
        if outcome.state != FLEW and outcome.reason
    ]
    notes = {outcome.pair.controller: outcome.pair.companions.note for outcome in outcomes}
    return lines + [f"{law}: {note}" for law, note in notes.items() if note]


def describe(outcome: Outcome) -> str:
    """One line for whoever waits."""
    if outcome.figures is None:
        return f"{outcome.pair.name}: {WORDS[outcome.state]}"
    time_s = outcome.figures.settled_1_deg_s
    bound = f"{BOUNDS_DEG[1]:g} deg"
    return f"{outcome.pair.name}: " + (
        f"{bound} after {time_s:.1f} s" if time_s is not None else f"never within {bound}"
    )
