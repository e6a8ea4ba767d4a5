"""Faults of a reaction wheel as a node of the bus: its frames are late, lost, or not counted on; or the wheel is gone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from bus.units import Ge, Gt, Le
from plant_server.faults.effects import Acting, WheelDisturbance, WheelEffect, register

FRAMES = "telemetry frames"


@register("wheel", "late")
@dataclass(frozen=True, slots=True, kw_only=True)
class Late(WheelEffect):
    """telemetry frames are those of `ticks` ticks ago"""

    rises = False
    switches = True
    reports = True
    equation = FRAMES
    seen_in = "a queue that has filled up, a task that has slipped"
    failures = ((106, 6),)
    ticks: Annotated[int, Ge(1), Le(100)] = 5

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Hold the frames back; several delays add up."""
        if now.level > 0.0:
            wheel.late_ticks += self.ticks


@register("wheel", "frozen_counter")
@dataclass(frozen=True, slots=True, kw_only=True)
class FrozenCounter(WheelEffect):
    """the alive counter of the telemetry frames stands still"""

    rises = False
    switches = True
    reports = True
    equation = FRAMES
    seen_in = "a node that sends its buffer again and again"

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Stop the counter."""
        wheel.counter_frozen = wheel.counter_frozen or now.level > 0.0


@register("wheel", "drop")
@dataclass(frozen=True, slots=True, kw_only=True)
class Drop(WheelEffect):
    """with `probability` per telemetry frame, no frame"""

    draws = 1
    reports = True
    equation = FRAMES
    seen_in = "bit errors, a loose connector"
    failures = ((106, 7),)
    probability: Annotated[float, Gt(0), Le(1)] = 0.1  # 1: every frame, which is `silent`

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Lose the frame when chance has it."""
        if now.drawn[0] < now.level * self.probability:
            wheel.silent = True


@register("wheel", "total_failure")
@dataclass(frozen=True, slots=True, kw_only=True)
class TotalFailure(WheelEffect):
    """no motor current and no telemetry frames: the wheel is gone, the rotor runs free"""

    rises = False
    switches = True
    equation = "m_on = 0, and no telemetry frames"
    seen_in = "FUSE, December 2001: wheels lost"

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Switch motor and telemetry off."""
        if now.level > 0.0:
            wheel.motor_on = False
            wheel.silent = True
