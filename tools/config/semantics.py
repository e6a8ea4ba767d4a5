"""Checks that span several keys of a scenario: time, geometry, rates, faults, expectations, bus load.

Every check takes the parts it needs from a `Reading` and is skipped while one of them is not sound, so that one wrong
value does not hide the others and does not bring follow-up complaints either.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

from bus.errors import BusLoadError
from bus.load import check_load
from bus.settings import KeyPath, Problem, Reading
from bus.units import Mat3
from plant_server.config import FaultConfig
from plant_server.faults import check_fault
from tools.config.expect import Expectation, check_expectation

NANO = 1_000_000_000
PERIOD_TOLERANCE = 0.01  # relative; what the algorithms themselves accept (StepSizeError)
MAX_LATENCY_TICKS = 14  # AGE in the star tracker's frames has four bits; 15 means not valid
SYMMETRY_TOLERANCE = 1e-9  # relative to the largest element

Problems = Iterator[Problem]


def check_semantics(reading: Reading) -> list[Problem]:
    """Every problem between the parts of a scenario that are each well-formed."""
    problems: list[Problem] = []
    for check in CHECKS:
        for problem in check(reading.parts):
            follows = any(problem.path == known.path[: len(problem.path)] for known in reading.problems)
            if not follows and not any(problem.path == known.path for known in problems):
                problems.append(problem)
    return problems


# -- time ----------------------------------------------------------------------------------------------------------


def check_clock(parts: dict[KeyPath, Any]) -> Problems:
    tick_hz, duration_s = parts.get(("clock", "tick_hz")), parts.get(("duration_s",))
    if tick_hz is not None and NANO % tick_hz:
        whole = sorted((hz for hz in range(1, 1001) if NANO % hz == 0), key=lambda hz: abs(hz - tick_hz))[:2]
        near = " or ".join(str(hz) for hz in sorted(whole))
        yield Problem(("clock", "tick_hz"), f"{tick_hz} Hz: the period is not a whole number of ns; near: {near}")
    if tick_hz is not None and duration_s is not None and not _is_whole(duration_s * tick_hz):
        down = math.floor(duration_s * tick_hz) / tick_hz
        word = f"{duration_s} s is not a whole number of ticks of {1 / tick_hz:g} s; near: {down:g} s"
        yield Problem(("duration_s",), word)


def _find_tick_hz(parts: dict[KeyPath, Any]) -> int | None:
    """Tick rate, where it is one that other times can be compared with."""
    tick_hz: int | None = parts.get(("clock", "tick_hz"))
    return None if tick_hz is None or NANO % tick_hz else tick_hz


def check_plant_rates(parts: dict[KeyPath, Any]) -> Problems:
    tick_hz = _find_tick_hz(parts)
    if tick_hz is None:
        return
    tick_s = 1 / tick_hz
    step_s = parts.get(("plant", "step_s"))
    if step_s is not None and (step_s > tick_s * (1 + 1e-9) or not _is_whole(tick_s / step_s)):
        steps = max(1, math.ceil(tick_s / step_s))
        word = f"{step_s} s does not divide the tick of {tick_s:g} s (clock.tick_hz {tick_hz})"
        yield Problem(("plant", "step_s"), f"{word}; near: {tick_s / steps:g} s")
    rate_hz = parts.get(("plant", "star_tracker", "rate_hz"))
    if rate_hz is not None and (rate_hz > tick_hz or not _is_whole(tick_hz / rate_hz)):
        frames = max(1, math.ceil(tick_hz / rate_hz))
        word = f"{rate_hz} Hz does not divide the tick rate of {tick_hz} Hz; near: {tick_hz / frames:g} Hz"
        yield Problem(("plant", "star_tracker", "rate_hz"), word)
    latency_s = parts.get(("plant", "star_tracker", "latency_s"))
    if latency_s is not None and (not _is_whole(latency_s * tick_hz) or round(latency_s * tick_hz) > MAX_LATENCY_TICKS):
        near = min(round(latency_s * tick_hz), MAX_LATENCY_TICKS) / tick_hz
        word = f"{latency_s} s is not a whole number of ticks of {tick_s:g} s, at most {MAX_LATENCY_TICKS}"
        yield Problem(("plant", "star_tracker", "latency_s"), f"{word}; near: {near:g} s")


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


# -- geometry ------------------------------------------------------------------------------------------------------


def check_inertias(parts: dict[KeyPath, Any]) -> Problems:
    for path in (("plant", "body", "inertia_kgm2"), ("fsw", "model", "inertia_kgm2")):
        inertia = parts.get(path)
        if inertia is not None and (word := explain_inertia(inertia)):
            yield Problem(path, word)


def explain_inertia(inertia_kgm2: Mat3) -> str | None:
    """Why no rigid body has this inertia tensor; None when one can."""
    largest = max(abs(element) for row in inertia_kgm2 for element in row)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        upper, lower = inertia_kgm2[i][j], inertia_kgm2[j][i]
        if abs(upper - lower) > SYMMETRY_TOLERANCE * largest:
            return f"is not symmetric: row {i + 1} column {j + 1} is {upper:g}, row {j + 1} column {i + 1} is {lower:g}"
    moments = principal_moments(inertia_kgm2)
    words = ", ".join(f"{moment:.4g}" for moment in moments)
    if moments[0] <= 0.0:
        return f"is not positive definite: its principal moments are {words} kg m^2; all must be > 0"
    if moments[2] > (moments[0] + moments[1]) * (1 + 1e-9):
        word = f"no rigid body has the principal moments {words} kg m^2"
        return f"{word}: the largest can be at most the sum of the others, {moments[0] + moments[1]:.4g}"
    return None


def principal_moments(inertia_kgm2: Mat3) -> tuple[float, float, float]:
    """Eigenvalues of a symmetric 3 x 3 matrix, smallest first [kg m^2].

    Trigonometric solution of the characteristic equation (Smith, Comm. ACM 4(4), 1961).
    """
    (a, d, e), (_, b, f), (_, _, c) = inertia_kgm2
    mean = (a + b + c) / 3
    spread = math.sqrt(((a - mean) ** 2 + (b - mean) ** 2 + (c - mean) ** 2 + 2 * (d * d + e * e + f * f)) / 6)
    if spread == 0.0:
        return (mean, mean, mean)
    x, y, z = (a - mean) / spread, (b - mean) / spread, (c - mean) / spread
    u, v, w = d / spread, e / spread, f / spread
    half_det = (x * (y * z - w * w) - u * (u * z - w * v) + v * (u * w - y * v)) / 2
    angle = math.acos(max(-1.0, min(1.0, half_det))) / 3
    low, high = mean + 2 * spread * math.cos(angle + 2 * math.pi / 3), mean + 2 * spread * math.cos(angle)
    return (low, 3 * mean - low - high, high)


def check_quaternions(parts: dict[KeyPath, Any]) -> Problems:
    for path in (("plant", "body", "attitude_q"), ("fsw", "target_q")):
        q = parts.get(path)
        if q is not None and not math.hypot(*q) > 1e-6:
            yield Problem(path, f"has length {math.hypot(*q):g}; no attitude: it must be longer than 1e-6")


# -- faults and expectations ---------------------------------------------------------------------------------------


def check_faults(parts: dict[KeyPath, Any]) -> Problems:
    duration_s = parts.get(("duration_s",))
    for index in range(_length(parts, "faults")):
        fault: FaultConfig | None = parts.get(("faults", index))
        if fault is None:
            continue
        if duration_s is not None and fault.at_s >= duration_s:
            word = f"{fault.at_s} s is not before the end of the run, {duration_s} s: the fault would never take effect"
            yield Problem(("faults", index, "at_s"), word)
        for problem in check_fault(fault):
            yield Problem(("faults", index, *problem.path), problem.message, problem.at_key)


def check_expectations(parts: dict[KeyPath, Any]) -> Problems:
    duration_s = parts.get(("duration_s",))
    seen: dict[str, int] = {}
    for index in range(_length(parts, "expect")):
        item: Expectation | None = parts.get(("expect", index))
        if item is None:
            continue
        for key, word in check_expectation(item, duration_s):
            yield Problem(("expect", index, key), word)
        if item.name in seen:
            yield Problem(("expect", index, "name"), f'"{item.name}" is the name of expect[{seen[item.name]}] too')
        seen[item.name] = index


def check_bus_load(parts: dict[KeyPath, Any]) -> Problems:
    tick_hz, bitrate_bps = parts.get(("clock", "tick_hz")), parts.get(("bus", "bitrate_bps"))
    star_hz = parts.get(("plant", "star_tracker", "rate_hz"))
    if tick_hz is None or bitrate_bps is None or star_hz is None:
        return
    try:
        check_load(tick_hz, star_hz, bitrate_bps)
    except BusLoadError as error:
        yield Problem(("bus", "bitrate_bps"), str(error).removeprefix("bus: "))


def _length(parts: dict[KeyPath, Any], key: str) -> int:
    """How many entries a list has, counted by what was read of them."""
    indices = [path[1] for path in parts if len(path) > 1 and path[0] == key and isinstance(path[1], int)]
    return max(indices, default=-1) + 1


CHECKS: tuple[Callable[[dict[KeyPath, Any]], Problems], ...] = (
    check_clock,
    check_plant_rates,
    check_control_period,
    check_inertias,
    check_quaternions,
    check_faults,
    check_expectations,
    check_bus_load,
)
