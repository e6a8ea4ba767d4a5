"""What must hold between the settings of a plant, beyond the range of each."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from bus.settings import Problem
from bus.units import Mat3, Vec3
from plant_server.config import PlantConfig, StarTrackerConfig, WheelConfig
from plant_server.wheels.ithaco_rotor import DRY_RAD_S
from plant_server.wheels.motor import Motor, fill_motor

MAX_STAR_LATENCY_TICKS: Final = 14  # AGE of the star tracker's frames is 0..14; 15 says not valid
SYMMETRY_TOLERANCE: Final = 1e-9  # of the largest element
WHOLE_TOLERANCE: Final = 1e-6
STABLE: Final = 2.5  # rate times step that Runge-Kutta's fourth order follows without swinging up; its bound is 2.78
PLAIN_WHEEL = WheelConfig(mount="x")
IDEAL_ONLY = {
    "inertia_kgm2": "inertia_kgm2", "max_torque_nm": "max_command_v", "max_speed_rad_s": "overspeed_rad_s",
    "torque_lag_s": "bandwidth_rad_s", "viscous_nm_s": "viscous_nm_s", "coulomb_nm": "coulomb_nm",
    "motor_constant_nm_a": "torque_constant_nm_a",
}  # fmt: skip


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
        at = ("wheels", i)
        if wheel.model == "ithaco":
            yield from _check_motor(wheel, config.step_s, at)
            continue
        if wheel.motor is not None:
            word = "belongs to a wheel with a motor; give `model: ithaco` beside it, or leave it out"
            yield Problem((*at, "motor"), word)
        if abs(wheel.speed_rad_s) > wheel.max_speed_rad_s:
            word = f"{wheel.speed_rad_s:g} rad/s is beyond max_speed_rad_s, {wheel.max_speed_rad_s:g} rad/s"
            yield Problem((*at, "speed_rad_s"), word)
        # drag is held over a step: a step longer than the time in which it stops the rotor would not converge
        if wheel.viscous_nm_s * config.step_s > wheel.inertia_kgm2:
            most = wheel.inertia_kgm2 / config.step_s
            word = f"{wheel.viscous_nm_s:g} N m s stops the rotor in a step of {config.step_s:g} s; at most {most:g}"
            yield Problem((*at, "viscous_nm_s"), word)


def _check_motor(wheel: WheelConfig, step_s: float, at: tuple[str | int, ...]) -> Iterator[Problem]:
    """What is wrong with a wheel of the ithaco model, preset and all."""
    for key in IDEAL_ONLY:
        if getattr(wheel, key) != getattr(PLAIN_WHEEL, key):
            word = f"is of an ideal wheel; of one with a motor it comes from `motor` ({IDEAL_ONLY[key]})"
            yield Problem((*at, key), word)
    motor, where = fill_motor(wheel), (*at, "motor")
    if motor.static < motor.coulomb:
        word = (
            f"{motor.static:g} N m is less than coulomb_nm, {motor.coulomb:g} N m: friction at rest is the larger one"
        )
        yield Problem((*where, "static_nm"), word)
    if abs(wheel.speed_rad_s) > motor.overspeed:
        word = f"{wheel.speed_rad_s:g} rad/s is beyond overspeed_rad_s, {motor.overspeed:g} rad/s, where the limiter sets in"
        yield Problem((*at, "speed_rad_s"), word)
    settings = motor.settings
    idle_a = settings.quiescent_w / (settings.bus_v - 1.0)
    spare_v = settings.bus_v - 1.0 - settings.input_ohm * idle_a
    if spare_v <= 0.0:
        word = f"{settings.bus_v:g} V leave the driver {spare_v:g} V at rest: the wheel could never turn; give more"
        yield Problem((*where, "bus_v"), word)
    torque = motor.max_command * motor.driver_gain * motor.torque_constant
    if torque <= motor.coulomb:
        word = f"{motor.coulomb:g} N m are more than full command gives, {torque:g} N m: the rotor could never start"
        yield Problem((*where, "coulomb_nm"), word)
    for key, rate, what in (
        ("bandwidth_rad_s", motor.bandwidth, "the driver"),
        ("coulomb_nm", motor.static / (DRY_RAD_S * motor.inertia), "dry friction at rest"),
        ("overspeed_gain_v_s", _find_limiter_rate(motor), "the speed limiter"),
    ):
        if rate * step_s > STABLE:
            word = f"{what} has a rate of {rate:.4g} 1/s, which steps of {step_s:g} s cannot follow; give "
            yield Problem((*where, key), f"{word}plant.step_s of at most {STABLE / rate:.2g} s, or less of it")


def _find_limiter_rate(motor: Motor) -> float:
    """Return the natural frequency of rotor and driver while the speed limiter acts [rad/s]."""
    per_speed = motor.overspeed_gain * motor.driver_gain * motor.torque_constant / motor.inertia
    return math.sqrt(per_speed * motor.bandwidth)


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
