"""Faults of the star tracker."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from bus.units import Gt, Le
from plant_server.faults.effects import Acting, StarEffect, StarSample, register


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
