"""Whether each fault of a scenario took effect: asked for is not the same as bitten.

/faults carries a record for every onset, effect and end of a fault, each with the fault's `id`. A fault counts when the
log has a record of phase `effect` with its id: what it did changed something, at or after its onset, and its onset came
within one tick of when it was due.
"""

from __future__ import annotations

from typing import Any

from plant_server.faults import Fault, fault_ids
from tools.grading.verdict import Verdict, decide
from tools.log.completeness import Completeness, Timetable

TOLERANCE_TICKS = 1
TRUTH = "/truth/"


def judge_faults(
    records: list[dict[str, Any]], faults: tuple[Fault, ...], completeness: Completeness, timetable: Timetable
) -> list[Verdict]:
    """A verdict on each fault of a scenario, in their order. records: those of /faults."""
    verdicts = []
    for own_id, fault in zip(fault_ids(faults), faults, strict=True):
        due = round(fault.at_s * timetable.tick_hz)
        tick, detail = find_effect(records, own_id, fault, due)
        hole = _find_hole(completeness, due) if tick is None else ""
        verdicts.append(
            Verdict(
                f"fault took effect: {fault.unit} {fault.kind}",
                "not executed" if hole else decide(tick is not None),
                None if tick is None else tick / timetable.tick_hz,
                f"at {fault.at_s:g} s",
                None,
                "s",
                hole or detail,
            )
        )
    return verdicts


def find_effect(records: list[dict[str, Any]], own_id: str, fault: Fault, due: int) -> tuple[int | None, str]:
    """Tick at which the fault first had an effect, or None and why it does not count.

    records : of /faults, with id, unit, fault, phase, tick
    own_id  : the fault's id, as the plant announces it
    due     : the tick of its onset
    """
    mine = [
        record for record in records
        if record.get("id") == own_id and record["fault"] == fault.kind and record["unit"] == fault.unit
    ]  # fmt: skip
    onsets = [r["tick"] for r in mine if r["phase"] == "onset" and abs(r["tick"] - due) <= TOLERANCE_TICKS]
    if not onsets:
        return None, f"no onset of {own_id} is in the log at its time"
    effects = [r["tick"] for r in mine if r["phase"] == "effect" and r["tick"] >= min(onsets)]
    if not effects:
        return None, f"{own_id} was switched on and changed nothing"
    return min(effects), ""


def _find_hole(completeness: Completeness, due: int) -> str:
    """In words, what the truth lacks from the fault's onset on; empty when its absence is no matter of the log's."""
    holes = [gap for gap in completeness.gaps if gap.topic.startswith(TRUTH) and gap.ran and gap.last >= due]
    return holes[0].describe() if holes else ""
