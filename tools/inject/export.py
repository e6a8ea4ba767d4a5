"""A log's faults as a list for a scenario file: the scenario's own and those commanded on the way, clears as `until_s`.

A run of that scenario with this list repeats what the plant did, bit for bit: an onset in the past when it was commanded is
the time of the tick on which it was applied. What a list cannot say is named: a latched fault that was cleared by command
(`until_s` does not end it), and a fault that is left out because it never acted where a later one of its kind draws random
numbers (the streams are counted).
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bus.errors import ConfigError, RecordError
from plant_server.faults import Fault, fault_ids, make_fault, parts_of
from plant_server.faults.profiles import FixedProfile
from tools.config.scenario import Resolved
from tools.config.yaml_nodes import write_yaml
from tools.grading.grade import scenario_of
from tools.log.completeness import warn_of_missing
from tools.log.mcap_reader import Run, read_run

ADDED = re.compile(r"fault\.add by .* at tick (\d+): (.*)", re.DOTALL)


@dataclass(slots=True)
class ExportedFaults:
    """The faults of a run as a scenario has them, and what there is to say of them."""

    faults: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # what was left out and makes no difference
    inexact: list[str] = field(default_factory=list)  # what this list does not repeat exactly


@dataclass(slots=True)
class _Told:
    """One fault of the run, and what the log says of it."""

    id: str
    fault: Fault
    own: bool  # of the scenario
    applied_tick: int = 0  # on which it was commanded
    cleared_tick: int | None = None  # by command
    began: bool = False


def export_faults(path: Path) -> ExportedFaults:
    """Return the faults of a log. Raises RecordError for a log without its scenario or with a fault that cannot be read."""
    log = read_run(path)
    warn_of_missing(log, "inject export")
    resolved = scenario_of(log, path)
    told = _list_faults(log, resolved)
    result = ExportedFaults()
    _note_unknown(log, told, result)
    tick_s = (1_000_000_000 // resolved.scenario.clock.tick_hz) * 1e-9
    steps = round(tick_s / resolved.scenario.plant.step_s)
    times = _Times(tick_s / steps, steps)
    gone: list[_Told] = []
    for item in told:
        _put(item, times, result, gone)
    if gone:
        _name_all(result, told, gone)
    return result


def format_export(exported: ExportedFaults, log: Path, extends: str | None = None) -> str:
    """Return the list as YAML, for a scenario file. extends : the scenario that it belongs to; None: it is left open"""
    head = f"# The faults of {str(log)!a}, as they acted. In a scenario file with `extends:` they replace its list.\n"
    said = "".join(f"# not exactly: {problem}\n" for problem in exported.inexact)
    return head + said + write_yaml(({} if extends is None else {"extends": extends}) | {"faults": exported.faults})


@dataclass(frozen=True, slots=True)
class _Times:
    """Times of ticks as the plant has them, to the last bit."""

    step_s: float
    steps_per_tick: int

    def of(self, tick: int) -> float:
        return tick * self.steps_per_tick * self.step_s


def _list_faults(log: Run, resolved: Resolved) -> list[_Told]:
    """Every fault of the run that the log defines, in its order: the scenario's, then those commanded."""
    own = resolved.scenario.faults
    told = {n: _Told(name, fault, True) for n, (name, fault) in enumerate(zip(fault_ids(own), own, strict=True))}
    messages = [(event["t_ns"], event["message"]) for event in log.events if event["name"] == "plant"]
    applied = [match for _, text in messages if (match := ADDED.fullmatch(text))]
    said = set(messages)
    for record in log.faults:
        number = record.get("number")
        if type(number) is not int or number < 0 or record["phase"] == "refused":
            continue
        if number not in told:
            told[number] = _read_fault(record, log.path)
            words = f"{told[number].id}: {told[number].fault.describe()}"
            told[number].applied_tick = next((int(m[1]) for m in applied if m[2] == words), record["tick"])
        item = told[number]
        item.began |= record["phase"] in ("onset", "effect")
        if record["phase"] == "cleared" and (record["t_ns"], _say_cleared(item)) in said:
            item.cleared_tick = record["tick"]
    return [told[number] for number in sorted(told)]


def _say_cleared(item: _Told) -> str:
    """How the plant tells of a fault that was cleared by command; of others it says by what."""
    return f"fault cleared: {item.id}: {item.fault.describe()}"


def _read_fault(record: dict[str, Any], log: Path) -> _Told:
    try:
        fault = make_fault(**json.loads(record["definition"]))
    except (KeyError, ValueError, TypeError, ConfigError) as error:
        raise RecordError(
            f"{log}: a fault of tick {record['tick']} has no definition that can be read: {error}"
        ) from None
    return _Told(str(record.get("id", "")), fault, False)


def _note_unknown(log: Run, told: list[_Told], result: ExportedFaults) -> None:
    """Name the faults that were commanded and of which nothing more was heard: they waited when the run ended."""
    known = {f"{item.id}: {item.fault.describe()}" for item in told}
    for event in log.events:
        match = ADDED.fullmatch(event["message"]) if event["name"] == "plant" else None
        if match and match[2] not in known:
            result.notes.append(f"{match[2]}: left out, it had not begun when the run ended")
            unit, kind = [*match[2].rpartition(": ")[2].split(" "), ""][:2]
            _check_streams(unit, kind, [item for item in told if item.applied_tick >= int(match[1])], result)


def _put(item: _Told, times: _Times, result: ExportedFaults, gone: list[_Told]) -> None:
    keys = item.fault.plain_settings()
    if not item.own:
        keys = {"id": item.id} | keys
        # An onset that had passed is the moment of the command. The comparison is the plant's own.
        keys["at_s"] = max(item.fault.at_s, times.of(item.applied_tick))
    if item.cleared_tick is not None:
        until_s = times.of(item.cleared_tick)
        if not item.began or until_s <= keys["at_s"]:
            result.notes.append(f"{item.id}: left out, it was cleared before it could act")
            gone.append(item)
            return
        if item.fault.latch:
            result.inexact.append(
                f"{item.id}: it is latched and was cleared by command at tick {item.cleared_tick}; no key of a "
                "scenario does that"
            )
        else:
            keys["until_s"] = until_s
    result.faults.append(keys)


def _name_all(result: ExportedFaults, told: list[_Told], gone: list[_Told]) -> None:
    """Where one was left out, the others keep the ids that they had by their place, and their random numbers if they can."""
    kept = [item for item in told if item not in gone]
    result.faults = [{"id": item.id} | keys for item, keys in zip(kept, result.faults, strict=True)]
    for item in gone:
        later = told[told.index(item) + 1 :]
        _check_streams(item.fault.unit, item.fault.kind, [other for other in later if other in kept], result)


def _check_streams(unit: str, kind: str, later: list[_Told], result: ExportedFaults) -> None:
    """Name the faults whose random numbers are others for want of one of this unit and kind before them."""
    parts = set(parts_of(unit))
    for item in later:
        fault = item.fault
        by_chance = fault.effect.draws or not isinstance(fault.profile, FixedProfile)
        if by_chance and fault.kind == kind and parts & set(parts_of(fault.unit)):
            text = f"{item.id}: it draws other random numbers, for a {unit} {kind} before it is left out"
            if text not in result.inexact:
                result.inexact.append(text)
