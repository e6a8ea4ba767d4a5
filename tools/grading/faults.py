"""Whether each fault of a scenario took effect: asked for is not the same as bitten.

/faults carries a record for every onset, effect and end of a fault, each with the fault's `id`. A fault counts when the
log has a record of phase `effect` with its id: what it did changed something, at or after its onset, and its onset came
within one tick of when it was due.
"""

from __future__ import annotations

from typing import Any

from plant_server.config import FaultConfig
from plant_server.faults import GYRO_AXES
from tools.grading.verdict import Verdict, decide
from tools.log.completeness import Completeness, Timetable

TOLERANCE_TICKS = 1
TRUTH = "/truth/"


def judge_faults(
    records: list[dict[str, Any]], faults: tuple[FaultConfig, ...], completeness: Completeness, timetable: Timetable
) -> list[Verdict]:
    """A verdict on each fault of a scenario, in their order. records: those of /faults."""
    with_ids = any("id" in record for record in records)
    verdicts = []
    for index, fault in enumerate(faults):
        due = round(fault.at_s * timetable.tick_hz)
        own_id = getattr(fault, "id", "") or f"faults[{index}]"
        if with_ids:
            tick, detail = find_effect(records, own_id, fault, due)
        else:
            tick, detail = find_onset(records, fault, due)
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


def find_effect(records: list[dict[str, Any]], own_id: str, fault: FaultConfig, due: int) -> tuple[int | None, str]:
    """Tick at which the fault first had an effect, or None and why it does not count.

    records : of /faults, with id, unit, fault, phase, tick
    own_id  : the fault's id, or faults[i] for one that has none
    due     : the tick of its onset
    """
    mine = [
        record for record in records
        if record.get("id") == own_id and record["fault"] == fault.kind and record["unit"] in _list_units(fault)
    ]  # fmt: skip
    onsets = [r["tick"] for r in mine if r["phase"] == "onset" and abs(r["tick"] - due) <= TOLERANCE_TICKS]
    if not onsets:
        return None, f"no onset of {own_id} is in the log at its time"
    effects = [r["tick"] for r in mine if r["phase"] == "effect" and r["tick"] >= min(onsets)]
    if not effects:
        return None, f"{own_id} was switched on and changed nothing"
    return min(effects), ""


def find_onset(records: list[dict[str, Any]], fault: FaultConfig, due: int) -> tuple[int | None, str]:
    """As `find_effect`, for records without an id: unit, kind and tick of an onset have to do.

    To go once every log has ids: it cannot tell two faults of one kind on one unit at one time, nor asks for an effect.
    """
    units = GYRO_AXES if fault.unit == "gyro" else (fault.unit,)
    found = []
    for unit in units:
        found += [
            record["tick"] for record in records
            if (record["phase"], record["unit"], record["fault"]) == ("onset", unit, fault.kind)
            and abs(record["tick"] - due) <= TOLERANCE_TICKS
        ][:1]  # fmt: skip
    if len(found) < len(units):
        return None, "it is not in the log as having taken effect"
    return min(found), ""


def _list_units(fault: FaultConfig) -> tuple[str, ...]:
    return ("gyro", *GYRO_AXES) if fault.unit == "gyro" else (fault.unit,)


def _find_hole(completeness: Completeness, due: int) -> str:
    """In words, what the truth lacks from the fault's onset on; empty when its absence is no matter of the log's."""
    holes = [gap for gap in completeness.gaps if gap.topic.startswith(TRUTH) and gap.ran and gap.last >= due]
    return holes[0].describe() if holes else ""
