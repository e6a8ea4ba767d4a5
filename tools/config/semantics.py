"""Checks that span several keys of a scenario: time, plant, model, faults, expectations, bus load.

Every check takes the parts it needs from a `Reading` and is skipped while one of them is not sound, so that one wrong
value does not hide the others and does not bring follow-up complaints either.
"""

from __future__ import annotations

import dataclasses
import math
import typing
from collections.abc import Callable, Iterator
from typing import Any

from bus.errors import BusLoadError
from bus.icd.load import check_load
from bus.settings import NOTHING, KeyPath, Problem, Reading, fields_of, strip_annotations
from bus.units import DEG
from bus.words import nearest
from plant_server.config import PlantConfig
from plant_server.faults import explain_times, fault_ids
from plant_server.validation import explain_inertia, validate
from plant_server.wheels.bank import has_slow_telemetry
from tools.config.expect import is_name_of
from tools.config.expect_checks import check_expectation
from tools.config.wire_checks import check_address, check_ranges

NANO = 1_000_000_000
MAX_TICKS = 1_000_000_000  # of a run
MAX_STEPS = 10_000  # integration steps of a tick
MOST_TURN_RAD = 1.0  # in an integration step, at the start
LEAST_MOMENT_KGM2 = 1e-9  # smallest moment of inertia that is computed with
PERIOD_TOLERANCE = 0.01  # relative; what the algorithms themselves accept (StepSizeError)

Problems = Iterator[Problem]


def check_semantics(reading: Reading, *, opens: bool = True) -> list[Problem]:
    """Every problem between the parts of a scenario that are each well-formed.

    opens : whether its bus is to be opened from here; False for what was flown long ago and elsewhere
    """
    problems: list[Problem] = []
    told = {known.path[:length] for known in reading.problems for length in range(len(known.path) + 1)}
    for check in (*CHECKS, check_address) if opens else CHECKS:
        for problem in check(reading.parts):
            if problem.path not in told:
                told.add(problem.path)
                problems.append(problem)
    return problems


# -- time ----------------------------------------------------------------------------------------------------------


def check_clock(parts: dict[KeyPath, Any]) -> Problems:
    tick_hz, duration_s = parts.get(("clock", "tick_hz")), parts.get(("duration_s",))
    if tick_hz is not None and NANO % tick_hz:
        whole = sorted((hz for hz in range(1, 1001) if NANO % hz == 0), key=lambda hz: abs(hz - tick_hz))[:2]
        near = " or ".join(str(hz) for hz in sorted(whole))
        yield Problem(("clock", "tick_hz"), f"{tick_hz} Hz: the period is not a whole number of ns; near: {near}")
    if tick_hz is None or duration_s is None:
        return
    if duration_s * tick_hz > MAX_TICKS:
        word = f"{duration_s:g} s at {tick_hz} Hz are {duration_s * tick_hz:g} ticks; at most {MAX_TICKS:g}"
        yield Problem(("duration_s",), word)
    elif not _is_whole(duration_s * tick_hz):
        down = math.floor(duration_s * tick_hz) / tick_hz
        word = f"{duration_s} s is not a whole number of ticks of {1 / tick_hz:g} s; near: {down:g} s"
        yield Problem(("duration_s",), word)


def _find_tick_hz(parts: dict[KeyPath, Any]) -> int | None:
    """Tick rate, where it is one that other times can be compared with."""
    tick_hz: int | None = parts.get(("clock", "tick_hz"))
    return None if tick_hz is None or NANO % tick_hz else tick_hz


def check_control_period(parts: dict[KeyPath, Any]) -> Problems:
    tick_hz, divider = _find_tick_hz(parts), parts.get(("fsw", "executive", "control_divider"))
    if tick_hz is None or divider is None:
        return
    for family in ("observer", "controller", "allocator", "detector"):
        period_s = parts.get(("fsw", family, "period_s"))
        if period_s is None or abs(divider / tick_hz - period_s) <= PERIOD_TOLERANCE * period_s:
            continue
        word = (
            f"its gains belong to {period_s:g} s, but the control period is {divider / tick_hz:g} s "
            f"(fsw.executive.control_divider {divider} / clock.tick_hz {tick_hz})"
        )
        fix = f"; set period_s: {divider / tick_hz:g} with gains for it"
        if round(period_s * tick_hz) >= 1 and abs(round(period_s * tick_hz) / tick_hz - period_s) < 1e-3 * period_s:
            fix = f"; set fsw.executive.control_divider: {round(period_s * tick_hz)}"
        yield Problem(("fsw", family, "period_s"), word + fix)


def _is_whole(number: float) -> bool:
    return abs(number - round(number)) <= 1e-6 * max(1.0, abs(number)) and round(number) >= 0


# -- plant and model ---------------------------------------------------------------------------------------------


def check_plant(parts: dict[KeyPath, Any]) -> Problems:
    """What the plant itself says of its settings, also while some of them are not sound."""
    tick_hz = _find_tick_hz(parts)
    if tick_hz is None:
        return
    step_s = parts.get(("plant", "step_s"))
    if step_s is not None and step_s * tick_hz * MAX_STEPS < 1.0 - 1e-9:
        word = (
            f"{step_s:g} s makes {1 / (tick_hz * step_s):g} steps of a tick of {1 / tick_hz:g} s; at most {MAX_STEPS}"
        )
        yield Problem(("plant", "step_s"), word)
        parts = {path: value for path, value in parts.items() if path not in _WITH_STEP}
    rate_deg_s = parts.get(("plant", "body", "rate_deg_s"))
    if rate_deg_s is not None and step_s is not None and math.hypot(*rate_deg_s) * DEG * step_s > MOST_TURN_RAD:
        most = MOST_TURN_RAD / step_s / DEG
        word = f"{math.hypot(*rate_deg_s):g} deg/s cannot be followed in steps of {step_s:g} s; at most {most:g} deg/s"
        yield Problem(("plant", "body", "rate_deg_s"), word)
    config = _complete(PlantConfig, NOTHING, ("plant",), parts, 1 / tick_hz)
    for problem in validate(config, 1 / tick_hz):
        if ("plant", *problem.path) in parts:
            yield Problem(("plant", *problem.path), problem.message, problem.at_key)


_WITH_STEP: tuple[KeyPath, ...] = (("plant",), ("plant", "step_s"))  # what cannot be looked at with a step beyond reach


def _complete(kind: Any, default: Any, path: KeyPath, parts: dict[KeyPath, Any], tick_s: float) -> Any:
    """Settings as far as they were read, with something harmless in place of what is not sound."""
    if path in parts:
        return parts[path]
    kind, _ = strip_annotations(kind)
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        items = fields_of(kind).items()
        return kind(**{name: _complete(inner, given, (*path, name), parts, tick_s) for name, (inner, given) in items})
    members = typing.get_args(kind) if typing.get_origin(kind) is tuple else ()
    if members and dataclasses.is_dataclass(members[0]) and Ellipsis not in members:
        return tuple(_complete(inner, NOTHING, (*path, i), parts, tick_s) for i, inner in enumerate(members))
    harmless = {
        "inertia_kgm2": 1.0 if "wheels" in path else ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        "mount": "x",
        "step_s": tick_s / 1000,
        "rate_hz": 1 / tick_s,
    }
    return harmless.get(str(path[-1]), default)


def check_model(parts: dict[KeyPath, Any]) -> Problems:
    inertia = parts.get(("fsw", "model", "inertia_kgm2"))
    if inertia is not None and (word := explain_inertia(inertia)):
        yield Problem(("fsw", "model", "inertia_kgm2"), word)
    for path in (("fsw", "model", "inertia_kgm2"), ("plant", "body", "inertia_kgm2")):
        matrix = parts.get(path)
        if matrix is not None and 0.0 <= (least := min(matrix[i][i] for i in range(3))) < LEAST_MOMENT_KGM2:
            yield Problem(path, f"{least:g} kg m^2 on the diagonal is out of reach; at least {LEAST_MOMENT_KGM2:g}")
    q = parts.get(("fsw", "target_q"))
    if q is not None and not math.hypot(*q) > 1e-6:
        yield Problem(("fsw", "target_q"), f"has length {math.hypot(*q):g}; an attitude needs one above 1e-6")


# -- faults and expectations ---------------------------------------------------------------------------------------


def check_faults(parts: dict[KeyPath, Any]) -> Problems:
    """What is wrong between the keys of a fault, with the length of the run, and on this plant."""
    duration_s, plant = parts.get(("duration_s",)), parts.get(("plant",))
    count = _length(parts, "faults")
    for index in range(count):
        at = ("faults", index)
        at_s, until_s, fault = parts.get((*at, "at_s")), parts.get((*at, "until_s")), parts.get(at)
        if at_s is not None and duration_s is not None and at_s >= duration_s:
            word = f"{at_s} s is not before the end of the run, {duration_s} s: the fault would never take effect"
            yield Problem((*at, "at_s"), word)
        if at_s is not None and (late := explain_times(at_s, until_s)):
            yield Problem((*at, "until_s"), late)
        for problem in fault.check(plant) if fault is not None else ():
            yield Problem((*at, *problem.path), problem.message, problem.at_key)
    faults = [fault for index in range(count) if (fault := parts.get(("faults", index))) is not None]
    names = fault_ids(faults) if len(faults) == count else ()
    for index, name in enumerate(names):
        if name in names[:index]:
            word = f'"{name}" is the id of faults[{names.index(name)}] too; ids are unique'
            yield Problem(("faults", index, "id"), word)


def check_expectations(parts: dict[KeyPath, Any]) -> Problems:
    """What is wrong with each expectation, judged by those of its keys that are sound."""
    duration_s = parts.get(("duration_s",))
    seen: dict[str, int] = {}
    items: dict[int, dict[str, Any]] = {}
    for path, value in parts.items():
        if len(path) == 3 and path[0] == "expect" and isinstance(path[1], int):
            items.setdefault(path[1], {})[str(path[2])] = value
    for index, item in items.items():
        for key, word in check_expectation(item, duration_s):
            yield Problem(("expect", index, key), word)
        for key, name in _list_faults_named(item):
            if word := _explain_fault(parts, name):
                yield Problem(("expect", index, key), word)
        if "name" not in item:
            continue
        if item["name"] in seen:
            yield Problem(
                ("expect", index, "name"), f'"{item["name"]}" is the name of expect[{seen[item["name"]]}] too'
            )
        seen[item["name"]] = index


def _list_faults_named(item: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Key and name of every fault that an expectation waits for or holds an alarm against."""
    for key in ("after", "until"):
        word, _, name = (item.get(key) or "").partition(" ")
        if word == "fault":
            yield key, name.strip()
    if item.get("fault") is not None:
        yield "fault", item["fault"]


def _explain_fault(parts: dict[KeyPath, Any], name: str) -> str:
    """Why an expectation names a fault that will not come; empty when it may, also by command."""
    if parts.get(("inject",), "off") != "off":
        return ""
    known = {f"faults[{index}]" for index in range(_length(parts, "faults"))}
    known |= {
        value for path, value in parts.items()
        if len(path) == 3 and path[0] == "faults" and path[2] in ("id", "unit", "kind") and isinstance(value, str)
    }  # fmt: skip
    if is_name_of(name, known):
        return ""
    near = nearest(name, known)
    hint = f"did you mean {near}? " if near else ""
    return f"the scenario has no fault {name}; {hint}there are: {', '.join(sorted(known)) or 'none'}"


def check_bus_load(parts: dict[KeyPath, Any]) -> Problems:
    tick_hz, bitrate_bps = parts.get(("clock", "tick_hz")), parts.get(("bus", "bitrate_bps"))
    star_hz = parts.get(("plant", "star_tracker", "rate_hz"))
    if tick_hz is None or bitrate_bps is None or star_hz is None:
        return
    try:
        models = [parts.get(("plant", "wheels", index, "model")) for index in range(4)]
        check_load(tick_hz, star_hz, bitrate_bps, sum(map(has_slow_telemetry, models)))
    except BusLoadError as error:
        yield Problem(("bus", "bitrate_bps"), str(error).removeprefix("bus: "))


def _length(parts: dict[KeyPath, Any], key: str) -> int:
    """How many entries a list has, counted by what was read of them."""
    indices = [path[1] for path in parts if len(path) > 1 and path[0] == key and isinstance(path[1], int)]
    return max(indices, default=-1) + 1


CHECKS: tuple[Callable[[dict[KeyPath, Any]], Problems], ...] = (
    check_clock,
    check_plant,
    check_control_period,
    check_model,
    check_faults,
    check_expectations,
    check_bus_load,
    check_ranges,
)
