"""Faults of the star tracker."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from bus.units import DEG, Deg, Ge, Gt, Le, Unit
from plant_server.config import PlantConfig
from plant_server.faults.effects import Acting, StarEffect, StarSample, is_neutral, register


@register("star_tracker", "dropout")
@dataclass(frozen=True, slots=True, kw_only=True)
class Dropout(StarEffect):
    """with `probability` per frame, no frame"""

    equation = "attitude frames"
    seen_in = "blinded, or rebooting"
    failures = ((6, 1), (6, 7))
    draws = 1
    probability: Annotated[float, Gt(0), Le(1)] = 1.0  # 1: every frame is lost

    def disturb(self, sample: StarSample, now: Acting) -> None:
        """Lose the frame when chance has it."""
        if now.drawn[0] < now.level * self.probability:
            sample.lost = True


@register("star_tracker", "frozen")
@dataclass(frozen=True, slots=True, kw_only=True)
class Frozen(StarEffect):
    """frames carry the last attitude before the onset"""

    rises = False
    switches = True
    equation = "q = constant"
    seen_in = "a node that sends its buffer again and again"
    failures = ((6, 2),)

    def disturb(self, sample: StarSample, now: Acting) -> None:
        """Hold the attitude."""
        sample.frozen = sample.frozen or now.level > 0.0


@register("star_tracker", "garbage")
@dataclass(frozen=True, slots=True, kw_only=True)
class Garbage(StarEffect):
    """frames carry any attitude, anew with each"""

    rises = False
    switches = True
    draws = 3
    equation = "q = random"
    seen_in = "stars that are none: debris, protons on the detector"
    failures = ((6, 3),)

    def disturb(self, sample: StarSample, now: Acting) -> None:
        """Put a random attitude in place of what there was."""
        if now.level > 0.0:
            a, b, c = now.drawn
            sample.random = (a, b, c)


@register("star_tracker", "misaligned")
@dataclass(frozen=True, slots=True, kw_only=True)
class Misaligned(StarEffect):
    """the attitude is turned by `angle_deg` about an axis of the body"""

    equation = "q (x) turn"
    seen_in = "a bracket that has warped, a launch"
    failures = ((6, 4),)
    angle_deg: Annotated[Deg, Ge(-180), Le(180)] = 1.0
    axis: Literal["x", "y", "z"] = "x"

    def disturb(self, sample: StarSample, now: Acting) -> None:
        """Turn the attitude."""
        sample.turn(self.axis, now.level * self.angle_deg * DEG)

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when it is turned by nothing."""
        return "a turn of 0 deg has no effect; give another angle_deg" if is_neutral(self.angle_deg, 0.0) else None


@register("star_tracker", "half_rate")
@dataclass(frozen=True, slots=True, kw_only=True)
class HalfRate(StarEffect):
    """every other frame is missing"""

    rises = False
    switches = True
    remembers = True
    equation = "attitude frames"
    seen_in = "an overloaded processor in the unit"
    failures = ((6, 5),)

    def disturb(self, sample: StarSample, now: Acting) -> None:
        """Lose every second frame."""
        if now.level > 0.0 and now.count % 2 == 0:
            sample.lost = True


@register("star_tracker", "late")
@dataclass(frozen=True, slots=True, kw_only=True)
class Late(StarEffect):
    """frames come `ticks` ticks later than they should, and do not say so"""

    rises = False
    switches = True
    equation = "q(t - T)"
    seen_in = "a queue that has filled up"
    failures = ((6, 6),)
    ticks: Annotated[int, Ge(1), Le(100)] = 5

    def disturb(self, sample: StarSample, now: Acting) -> None:
        """Hold the frame back; several delays add up."""
        if now.level > 0.0:
            sample.late_ticks += self.ticks


@register("star_tracker", "rotating")
@dataclass(frozen=True, slots=True, kw_only=True)
class Rotating(StarEffect):
    """the attitude turns away by `rate_deg_s` about an axis of the body, from the onset on"""

    rises = False
    equation = "q (x) turn(t)"
    seen_in = "a structure that warps with the sun on it"
    failures = ((6, 8),)
    rate_deg_s: Annotated[float, Unit("deg/s"), Ge(-10), Le(10)] = 0.01
    axis: Literal["x", "y", "z"] = "x"

    def disturb(self, sample: StarSample, now: Acting) -> None:
        """Turn the attitude by what has grown since the onset."""
        sample.turn(self.axis, now.elapsed_s * self.rate_deg_s * DEG)

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when it does not turn."""
        return "a rate of 0 deg/s has no effect; give another rate_deg_s" if is_neutral(self.rate_deg_s, 0.0) else None
