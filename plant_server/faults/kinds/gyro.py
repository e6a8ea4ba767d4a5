"""Faults of a gyro axis. Each changes the rate as those with an earlier onset left it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from bus.units import Ge, Gt, Le, RadS, Unit
from plant_server.config import PlantConfig
from plant_server.faults.effects import Acting, GyroEffect, GyroSample, register
from plant_server.gyro.presets import fill_preset

Probability = Annotated[float, Gt(0), Le(1)]


def _refuse_zero(rate_rad_s: float) -> str | None:
    return "0 rad/s has no effect; give rate_rad_s another value" if rate_rad_s == 0.0 else None


@register("gyro", "constant")
@dataclass(frozen=True, slots=True, kw_only=True)
class Constant(GyroEffect):
    """`rate_rad_s` is added to the rate"""

    equation = "y + f"
    seen_in = "Wang, Li & Ma 2010, first fault"
    failures = ((0, 4),)
    rate_rad_s: RadS

    def disturb(self, sample: GyroSample, now: Acting) -> None:
        """Add a rate."""
        sample.shift_to(sample.rate_rad_s + now.level * self.rate_rad_s)

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when the rate is zero."""
        return _refuse_zero(self.rate_rad_s)


@register("gyro", "periodic")
@dataclass(frozen=True, slots=True, kw_only=True)
class Periodic(GyroEffect):
    """`rate_rad_s` sin(`frequency_rad_s` t) is added, t from the onset or absolute (`phase`)"""

    equation = "y + f sin(w t)"
    seen_in = "Wang, Li & Ma 2010, second fault"
    rate_rad_s: RadS  # amplitude
    frequency_rad_s: Annotated[RadS, Gt(0)]
    phase: Literal["onset", "absolute"] = "onset"  # where t starts: at the onset, or with the run

    def disturb(self, sample: GyroSample, now: Acting) -> None:
        """Add a sine."""
        origin_s = now.start_s if self.phase == "onset" else 0.0
        size = self.rate_rad_s * math.sin(self.frequency_rad_s * (now.t_s - origin_s))
        sample.shift_to(sample.rate_rad_s + now.level * size)

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when the amplitude is zero."""
        return _refuse_zero(self.rate_rad_s)


@register("gyro", "ramp")
@dataclass(frozen=True, slots=True, kw_only=True)
class Ramp(GyroEffect):
    """`slope_rad_s2` times the time since onset is added"""

    equation = "y + k t"
    seen_in = "drift of light source or coil"
    failures = ((0, 8),)
    rises = False
    slope_rad_s2: Annotated[float, Unit("rad/s^2")]

    def disturb(self, sample: GyroSample, now: Acting) -> None:
        """Add what has grown since the onset."""
        sample.shift_to(sample.rate_rad_s + self.slope_rad_s2 * now.elapsed_s)

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when the slope is zero."""
        return "a slope of 0 has no effect; give slope_rad_s2 another value" if self.slope_rad_s2 == 0.0 else None


@register("gyro", "stuck")
@dataclass(frozen=True, slots=True, kw_only=True)
class Stuck(GyroEffect):
    """the output does not move"""

    equation = "y = constant"
    seen_in = "hung converter"
    failures = ((0, 2),)
    rate_rad_s: RadS | None = None  # where it stands; left out: at the last output before onset

    def disturb(self, sample: GyroSample, now: Acting) -> None:
        """Hold the output."""
        if now.held_rad_s is None:
            now.held_rad_s = sample.last_rad_s if self.rate_rad_s is None else self.rate_rad_s
        sample.rate_rad_s += now.level * (now.held_rad_s - sample.rate_rad_s)
        sample.frozen = now.level == 1.0


@register("gyro", "dead")
@dataclass(frozen=True, slots=True, kw_only=True)
class Dead(GyroEffect):
    """no frames"""

    equation = "rate frames"
    seen_in = "supply or harness lost"
    failures = ((0, 1),)
    rises = False

    def disturb(self, sample: GyroSample, now: Acting) -> None:
        """Send nothing."""
        sample.silent = True


@register("gyro", "noise")
@dataclass(frozen=True, slots=True, kw_only=True)
class Noise(GyroEffect):
    """the angle random walk is `factor` times as large"""

    equation = "N of the angle random walk"
    seen_in = "ageing light source"
    early = True  # a larger angle random walk is part of the noise
    factor: Annotated[float, Ge(0)]

    def disturb(self, sample: GyroSample, now: Acting) -> None:
        """Make the sample's own white noise larger."""
        before = sample.noise_gain
        sample.noise_gain *= 1.0 + now.level * (self.factor - 1.0)
        sample.rate_rad_s += (sample.noise_gain - before) * sample.white_rad_s

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when the noise stays what it is or there is none."""
        if self.factor == 1.0:
            return "noise by a factor of 1 has no effect; give another factor"
        if plant is not None and not fill_preset(plant.gyro).arw_rad_sqrt_s > 0.0:
            preset = plant.gyro.preset
            return f"more noise has no effect: the gyro ({preset}) has no angle random walk; give gyro.arw_rad_sqrt_s"
        return None


@register("gyro", "scale")
@dataclass(frozen=True, slots=True, kw_only=True)
class Scale(GyroEffect):
    """the rate, as disturbed so far, is multiplied by 1 + `factor`"""

    equation = "y (1 + s)"
    seen_in = "loop gain drifted"
    factor: float

    def disturb(self, sample: GyroSample, now: Acting) -> None:
        """Scale the rate."""
        sample.shift_to(sample.rate_rad_s * (1.0 + now.level * self.factor))

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when the factor is zero."""
        return "a scale factor of 0 has no effect; give another factor" if self.factor == 0.0 else None


@register("gyro", "spikes")
@dataclass(frozen=True, slots=True, kw_only=True)
class Spikes(GyroEffect):
    """with `probability` per tick, +-`rate_rad_s` is added, sign at random"""

    equation = "y + f now and then"
    seen_in = "charged particles"
    failures = ((0, 3),)
    draws = 2
    rate_rad_s: RadS
    probability: Probability

    def disturb(self, sample: GyroSample, now: Acting) -> None:
        """Add a spike when chance has it."""
        hit, sign = now.drawn
        if hit < now.level * self.probability:
            sample.shift_to(sample.rate_rad_s + (1.0 if sign < 0.5 else -1.0) * self.rate_rad_s)

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when the spikes have no size."""
        return _refuse_zero(self.rate_rad_s)


@register("gyro", "intermittent")
@dataclass(frozen=True, slots=True, kw_only=True)
class Intermittent(GyroEffect):
    """with `probability` per tick, no frame"""

    equation = "rate frames"
    seen_in = "loose connector"
    failures = ((0, 7),)
    draws = 1
    probability: Probability

    def disturb(self, sample: GyroSample, now: Acting) -> None:
        """Send nothing when chance has it."""
        if now.drawn[0] < now.level * self.probability:
            sample.silent = True
