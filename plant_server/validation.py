"""What must hold between the settings of a plant, beyond the range of each."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from bus.settings import Problem
from bus.units import Mat3, Vec3
from plant_server.config import PlantConfig, StarTrackerConfig

MAX_STAR_LATENCY_TICKS: Final = 14  # AGE of the star tracker's frames is 0..14; 15 says not valid
SYMMETRY_TOLERANCE: Final = 1e-9  # of the largest element
WHOLE_TOLERANCE: Final = 1e-6


def validate(config: PlantConfig, tick_s: float) -> list[Problem]:
    """Return everything that is wrong between the settings, key paths relative to the plant's.

    tick_s : period of the loop [s]
    """
    problems = []
    if word := explain_inertia(config.body.inertia_kgm2):
        problems.append(Problem(("body", "inertia_kgm2"), word))
    length = math.hypot(*config.body.attitude_q)
    if not length > 1e-6:
        problems.append(Problem(("body", "attitude_q"), f"has length {length:g}; an attitude needs one above 1e-6"))
    problems += _check_step(config.step_s, tick_s)
    problems += _check_wheels(config)
    problems += _check_star_tracker(config.star_tracker, tick_s)
    return problems


def explain_inertia(inertia_kgm2: Mat3) -> str | None:
    """Return why no rigid body has this inertia tensor; None when one can."""
    largest = max(abs(element) for row in inertia_kgm2 for element in row)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        upper, lower = inertia_kgm2[i][j], inertia_kgm2[j][i]
        if abs(upper - lower) > SYMMETRY_TOLERANCE * largest:
            return f"is not symmetric: row {i + 1} column {j + 1} is {upper:g}, row {j + 1} column {i + 1} is {lower:g}"
    low, middle, high = (float(moment) for moment in np.linalg.eigvalsh(np.array(inertia_kgm2)))
    words = f"{low:.4g}, {middle:.4g}, {high:.4g} kg m^2"
    if low <= 0.0:
        return f"is not positive definite: its principal moments are {words}; all must be above 0"
    if high > (low + middle) * (1.0 + 1e-9):
        most = f"the largest can be at most the sum of the others, {low + middle:.4g}"
        return f"breaks the triangle inequality: no rigid body has the principal moments {words}; {most}"
    return None


def _check_step(step_s: float, tick_s: float) -> Iterator[Problem]:
    ratio = tick_s / step_s
    if not _is_whole(ratio):
        near = tick_s / max(1, math.ceil(ratio))
        yield Problem(("step_s",), f"{step_s:g} s does not divide the tick of {tick_s:g} s; near: {near:g} s")


def _check_wheels(config: PlantConfig) -> Iterator[Problem]:
    for i, wheel in enumerate(config.wheels):
        if abs(wheel.speed_rad_s) > wheel.max_speed_rad_s:
            word = f"{wheel.speed_rad_s:g} rad/s is beyond max_speed_rad_s, {wheel.max_speed_rad_s:g} rad/s"
            yield Problem(("wheels", i, "speed_rad_s"), word)
        # drag is held over a step: a step longer than the time in which it stops the rotor would not converge
        if wheel.viscous_nm_s * config.step_s > wheel.inertia_kgm2:
            most = wheel.inertia_kgm2 / config.step_s
            word = f"{wheel.viscous_nm_s:g} N m s stops the rotor in a step of {config.step_s:g} s; at most {most:g}"
            yield Problem(("wheels", i, "viscous_nm_s"), word)


def _check_star_tracker(config: StarTrackerConfig, tick_s: float) -> Iterator[Problem]:
    ratio = 1.0 / (config.rate_hz * tick_s)
    if not _is_whole(ratio):
        near = 1.0 / (max(1, math.ceil(ratio)) * tick_s)
        word = f"{config.rate_hz:g} Hz does not divide the tick rate of {1.0 / tick_s:g} Hz; near: {near:g} Hz"
        yield Problem(("star_tracker", "rate_hz"), word)
    latency = config.latency_s / tick_s
    path = ("star_tracker", "latency_s")
    if latency != 0.0 and not _is_whole(latency):
        near = round(latency) * tick_s
        yield Problem(path, f"{config.latency_s:g} s is not a whole number of ticks of {tick_s:g} s; near: {near:g} s")
    elif round(latency) > MAX_STAR_LATENCY_TICKS:
        most = MAX_STAR_LATENCY_TICKS * tick_s
        word = f"{config.latency_s:g} s is {round(latency)} ticks; its frames can say up to {MAX_STAR_LATENCY_TICKS}"
        yield Problem(path, f"{word}, {most:g} s at this tick")
    if config.exclusion is not None:
        vectors: tuple[tuple[str, Vec3], ...] = (
            ("boresight_b", config.exclusion.boresight_b),
            ("direction_i", config.exclusion.direction_i),
        )
        for key, vector in vectors:
            if not math.hypot(*vector) > 1e-6:
                yield Problem(("star_tracker", "exclusion", key), f"{vector} has no direction; its length is 0")


def _is_whole(number: float) -> bool:
    return round(number) >= 1 and abs(number - round(number)) <= WHOLE_TOLERANCE * number
