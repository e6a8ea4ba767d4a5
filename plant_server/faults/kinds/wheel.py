"""Faults of a reaction wheel's whole torque, and no telemetry. Zhang, Ye & Sun 2018, eq (8): tau = e tau_motor + b.

They are maps of the motor torque, and compose as such in the order of their onset: a loss scales a bias that was there
before it, and not one that comes later. Torques are those on the body, about the wheel's axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from bus.units import Ge, Le, Lt, NewtonMetre
from plant_server.config import PlantConfig
from plant_server.faults.effects import Acting, WheelDisturbance, WheelEffect, is_neutral, register
from plant_server.faults.profiles import Pulse

PAPER = "Zhang, Ye & Sun 2018, eq (8)"


@register("wheel", "loss")
@dataclass(frozen=True, slots=True, kw_only=True)
class Loss(WheelEffect):
    """torque is `effectiveness` times the command"""

    equation = "tau_m e; the catalogue's `effectiveness`"
    seen_in = PAPER
    failures = ((101, 4), (101, 7))
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

    equation = "tau_m + b"
    seen_in = PAPER
    failures = ((101, 8),)
    torque_nm: NewtonMetre

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Add a torque."""
        wheel.offset_nm += now.level * self.torque_nm

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when the torque is zero."""
        return (
            "a bias of 0 N m has no effect; give torque_nm another value" if is_neutral(self.torque_nm, 0.0) else None
        )


@register("wheel", "stuck_torque")
@dataclass(frozen=True, slots=True, kw_only=True)
class StuckTorque(WheelEffect):
    """torque is `torque_nm` whatever the command"""

    equation = "tau_m = b; a wheel that cannot turn is `seize`"
    seen_in = PAPER
    failures = ((101, 2),)
    torque_nm: NewtonMetre

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Put a torque in place of all there was; on its way there, of a part of it."""
        _replace(wheel, now.level, self.torque_nm)


@register("wheel", "dead")
@dataclass(frozen=True, slots=True, kw_only=True)
class Dead(WheelEffect):
    """no motor torque; the rotor coasts and the tachometer still reports"""

    equation = "tau_m = 0; one that a reset heals is `idle`"
    seen_in = PAPER
    failures = ((101, 1),)

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Take the torque away."""
        _replace(wheel, now.level, 0.0)


@register("wheel", "bias_torque")
@dataclass(frozen=True, slots=True, kw_only=True)
class BiasTorque(WheelEffect):
    """`torque_nm` is added, whatever the motor does"""

    last = True  # of the rotor, not of the motor: no loss scales it
    equation = "tau_bias; `bias` with the losses of the motor kept away from it"
    seen_in = "unbalance or a residual of the drive; as a random walk, a drifting bearing"
    torque_nm: Annotated[NewtonMetre, Ge(-0.01), Le(0.01)] = 0.002

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Add a torque."""
        wheel.offset_nm += now.level * self.torque_nm

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when the torque is zero."""
        return (
            "a bias of 0 N m has no effect; give torque_nm another value" if is_neutral(self.torque_nm, 0.0) else None
        )


@register("wheel", "jump")
@dataclass(frozen=True, slots=True, kw_only=True)
class Jump(WheelEffect):
    """`torque_nm` is added for a short time, whatever the motor does"""

    last = True
    usual = Pulse(length_s=0.5)
    equation = "tau_spike"
    seen_in = "fuzzy PID paper, eq (10); torque anomalies of worn bearings (Marble & Tow)"
    torque_nm: Annotated[NewtonMetre, Ge(-0.05), Le(0.05)] = 0.02

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Add a torque."""
        wheel.offset_nm += now.level * self.torque_nm

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when the torque is zero."""
        return (
            "a jump of 0 N m has no effect; give torque_nm another value" if is_neutral(self.torque_nm, 0.0) else None
        )


@register("wheel", "silent")
@dataclass(frozen=True, slots=True, kw_only=True)
class Silent(WheelEffect):
    """no telemetry frames; the wheel still obeys"""

    rises = False
    switches = True
    reports = True
    equation = "telemetry"
    seen_in = "node or harness lost"
    failures = ((106, 1),)

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Stop the telemetry."""
        wheel.silent = wheel.silent or now.level > 0.0


def _replace(wheel: WheelDisturbance, level: float, torque_nm: float) -> None:
    rest = 1.0 - level
    wheel.gain *= rest
    wheel.offset_nm = wheel.offset_nm * rest + level * torque_nm
