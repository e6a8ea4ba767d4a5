"""Faults of what a reaction wheel reports of its speed and its current; the wheel itself runs as it should.

A reading is value times gain plus offset, in whole steps where it has steps: factors multiply and offsets add,
whatever their order.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from bus.units import Gt, Le, RadS, Unit
from plant_server.config import PlantConfig
from plant_server.faults.effects import (
    CURRENT_STEP_A,
    SPEED_STEP_RAD_S,
    Acting,
    WheelDisturbance,
    WheelEffect,
    is_neutral,
    register,
)

Probability = Annotated[float, Gt(0), Le(1)]
SPEED, CURRENT = "telemetered speed", "telemetered current"


def _refuse(value: float, harmless: float, key: str) -> str | None:
    return f"{key} {harmless:g} has no effect; give it another value" if is_neutral(value, harmless) else None


def _refuse_fine(key: str, step: float, of_frame: float, unit: str) -> str | None:
    if step > of_frame * (1.0 + 1e-9):
        return None
    return f"{key} {step:g} {unit} has no effect: the frame has steps of {of_frame:g} {unit}; give more"


# -- speed ---------------------------------------------------------------------------------------------------------


@register("wheel", "tach_bias")
@dataclass(frozen=True, slots=True, kw_only=True)
class TachBias(WheelEffect):
    """`speed_rad_s` is added to the telemetered speed"""

    reports = True
    equation = SPEED
    seen_in = "tachometer electronics"
    failures = ((106, 8),)
    speed_rad_s: RadS = 5.0

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Shift the reading."""
        wheel.speed_offset_rad_s += now.level * self.speed_rad_s

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when nothing is added."""
        return _refuse(self.speed_rad_s, 0.0, "speed_rad_s")


@register("wheel", "tach_scale")
@dataclass(frozen=True, slots=True, kw_only=True)
class TachScale(WheelEffect):
    """the telemetered speed is `factor` times the true one"""

    reports = True
    equation = SPEED
    seen_in = "tachometer pulses lost or doubled"
    failures = ((106, 4),)
    factor: float = 0.9

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Scale the reading."""
        wheel.speed_gain *= 1.0 + now.level * (self.factor - 1.0)

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when the factor is 1."""
        return _refuse(self.factor, 1.0, "factor")


@register("wheel", "tach_freeze")
@dataclass(frozen=True, slots=True, kw_only=True)
class TachFreeze(WheelEffect):
    """the telemetered speed stays what it was"""

    rises = False
    switches = True
    reports = True
    equation = SPEED
    seen_in = "tachometer or its converter hung"
    failures = ((106, 2),)

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Hold the reading."""
        wheel.speed_frozen = wheel.speed_frozen or now.level > 0.0


@register("wheel", "tach_dropout")
@dataclass(frozen=True, slots=True, kw_only=True)
class TachDropout(WheelEffect):
    """with `probability` per reading, a telemetered speed of 0"""

    last = True  # whatever else is wrong with it, what is lost reads 0
    draws = 1
    reports = True
    equation = SPEED
    seen_in = "no pulses from the tachometer"
    probability: Probability = 0.1  # 1: every reading

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Lose the reading when chance has it."""
        if now.drawn[0] < now.level * self.probability:
            wheel.speed_gain = 0.0
            wheel.speed_offset_rad_s = 0.0


@register("wheel", "tach_quantise")
@dataclass(frozen=True, slots=True, kw_only=True)
class TachQuantise(WheelEffect):
    """the telemetered speed comes in steps of `step_rad_s`"""

    rises = False
    switches = True
    reports = True
    equation = SPEED
    seen_in = "few pulses a turn, a lost bit"
    step_rad_s: Annotated[RadS, Gt(0)] = 1.0

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Round the reading to the coarsest of all steps."""
        if now.level > 0.0:
            wheel.speed_lsb_rad_s = max(wheel.speed_lsb_rad_s, self.step_rad_s)

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when the frame itself has no finer steps."""
        return _refuse_fine("step_rad_s", self.step_rad_s, SPEED_STEP_RAD_S, "rad/s")


@register("wheel", "tach_garbage")
@dataclass(frozen=True, slots=True, kw_only=True)
class TachGarbage(WheelEffect):
    """the telemetered speed is any number within +-`speed_rad_s`, anew each time"""

    rises = False
    switches = True
    last = True
    draws = 1
    reports = True
    equation = SPEED
    seen_in = "noise on the lines of the tachometer"
    failures = ((106, 3),)
    speed_rad_s: Annotated[RadS, Gt(0)] = 300.0

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Put a random reading in place of the true one."""
        if now.level > 0.0:
            wheel.speed_gain = 0.0
            wheel.speed_offset_rad_s = (2.0 * now.drawn[0] - 1.0) * self.speed_rad_s

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when the readings have no size."""
        return _refuse(self.speed_rad_s, 0.0, "speed_rad_s")


# -- current -------------------------------------------------------------------------------------------------------


@register("wheel", "current_bias")
@dataclass(frozen=True, slots=True, kw_only=True)
class CurrentBias(WheelEffect):
    """`current_a` is added to the telemetered current"""

    reports = True
    equation = CURRENT
    seen_in = "offset of the current amplifier"
    current_a: Annotated[float, Unit("A")] = 0.05

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Shift the reading."""
        wheel.current_offset_a += now.level * self.current_a

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when nothing is added."""
        return _refuse(self.current_a, 0.0, "current_a")


@register("wheel", "current_scale")
@dataclass(frozen=True, slots=True, kw_only=True)
class CurrentScale(WheelEffect):
    """the telemetered current is `factor` times the true one"""

    reports = True
    equation = CURRENT
    seen_in = "shunt or amplifier drifted"
    factor: float = 0.9

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Scale the reading."""
        wheel.current_gain *= 1.0 + now.level * (self.factor - 1.0)

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when the factor is 1."""
        return _refuse(self.factor, 1.0, "factor")


@register("wheel", "current_freeze")
@dataclass(frozen=True, slots=True, kw_only=True)
class CurrentFreeze(WheelEffect):
    """the telemetered current stays what it was"""

    rises = False
    switches = True
    reports = True
    equation = CURRENT
    seen_in = "converter hung"

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Hold the reading."""
        wheel.current_frozen = wheel.current_frozen or now.level > 0.0


@register("wheel", "current_dropout")
@dataclass(frozen=True, slots=True, kw_only=True)
class CurrentDropout(WheelEffect):
    """with `probability` per reading, a telemetered current of 0"""

    last = True  # whatever else is wrong with it, what is lost reads 0
    draws = 1
    reports = True
    equation = CURRENT
    seen_in = "loose contact of the shunt"
    probability: Probability = 0.1  # 1: every reading

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Lose the reading when chance has it."""
        if now.drawn[0] < now.level * self.probability:
            wheel.current_gain = 0.0
            wheel.current_offset_a = 0.0


@register("wheel", "current_quantise")
@dataclass(frozen=True, slots=True, kw_only=True)
class CurrentQuantise(WheelEffect):
    """the telemetered current comes in steps of `step_a`"""

    rises = False
    switches = True
    reports = True
    equation = CURRENT
    seen_in = "a coarse converter, a lost bit"
    step_a: Annotated[float, Unit("A"), Gt(0)] = 0.02

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Round the reading to the coarsest of all steps."""
        if now.level > 0.0:
            wheel.current_lsb_a = max(wheel.current_lsb_a, self.step_a)

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when the frame itself has no finer steps."""
        return _refuse_fine("step_a", self.step_a, CURRENT_STEP_A, "A")
