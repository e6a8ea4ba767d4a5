"""Faults of a reaction wheel. Those of the torque are Zhang, Ye & Sun 2018, eq (8): tau = e tau_motor + b."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from bus.units import Ge, Lt, NewtonMetre
from plant_server.config import PlantConfig
from plant_server.faults.effects import Acting, WheelDisturbance, WheelEffect, register


@register("wheel", "loss")
@dataclass(frozen=True, slots=True, kw_only=True)
class Loss(WheelEffect):
    """torque is `effectiveness` times the command"""

    effectiveness: Annotated[float, Ge(0), Lt(1)]

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Scale the torque."""
        scale = 1.0 - now.level * (1.0 - self.effectiveness)
        wheel.gain *= scale
        wheel.offset_nm *= scale


@register("wheel", "bias")
@dataclass(frozen=True, slots=True, kw_only=True)
class Bias(WheelEffect):
    """`torque_nm` is added to the torque"""

    torque_nm: NewtonMetre

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Add a torque."""
        wheel.offset_nm += now.level * self.torque_nm

    def explain_futile(self, plant: PlantConfig | None) -> str | None:
        """Return why, when the torque is zero."""
        return "a bias of 0 N m has no effect; give torque_nm another value" if self.torque_nm == 0.0 else None


@register("wheel", "stuck_torque")
@dataclass(frozen=True, slots=True, kw_only=True)
class StuckTorque(WheelEffect):
    """torque is `torque_nm` whatever the command"""

    torque_nm: NewtonMetre

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Put a torque in place of all there was; on its way there, of a part of it."""
        _replace(wheel, now.level, self.torque_nm)


@register("wheel", "dead")
@dataclass(frozen=True, slots=True, kw_only=True)
class Dead(WheelEffect):
    """no motor torque; the rotor coasts and the tachometer still reports"""

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Take the torque away."""
        _replace(wheel, now.level, 0.0)


@register("wheel", "silent")
@dataclass(frozen=True, slots=True, kw_only=True)
class Silent(WheelEffect):
    """no telemetry frames; the wheel still obeys"""

    rises = False

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Stop the telemetry."""
        wheel.silent = True


def _replace(wheel: WheelDisturbance, level: float, torque_nm: float) -> None:
    rest = 1.0 - level
    wheel.gain *= rest
    wheel.offset_nm = wheel.offset_nm * rest + level * torque_nm
