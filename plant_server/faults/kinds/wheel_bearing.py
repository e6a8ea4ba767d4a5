"""Faults of a reaction wheel's bearing: friction in several forms, up to seizure. It opposes the rotor's motion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from bus.units import Ge, Gt, Le, NewtonMetre, RadS, Seconds
from plant_server.config import PlantConfig
from plant_server.faults.effects import Acting, WheelDisturbance, WheelEffect, register
from plant_server.faults.profiles import Intermittent, LinearRise
from plant_server.faults.units import WHEELS


def _explain_without_friction(plant: PlantConfig | None, unit: str, key: str) -> str | None:
    """Return why a factor on a friction that an ideal wheel has not can do nothing, None when it has it."""
    if plant is None or unit not in WHEELS:
        return None
    index = WHEELS.index(unit)
    wheel = plant.wheels[index]
    if getattr(wheel, "model", "ideal") != "ideal" or getattr(wheel, key) > 0.0:
        return None
    return f"a factor on no friction has no effect; give plant.wheels[{index}].{key}, or take friction_extra"


@register("wheel", "friction_coulomb")
@dataclass(frozen=True, slots=True, kw_only=True)
class CoulombFriction(WheelEffect):
    """dry friction is `coulomb_gain` times what it was"""

    equation = "k_c"
    seen_in = "Kepler wheel 4, January 2013; Dawn, June 2010: friction that grew for hours to months"
    coulomb_gain: Annotated[float, Ge(1), Le(10)] = 3.0

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Scale dry friction."""
        wheel.coulomb_gain *= 1.0 + now.level * (self.coulomb_gain - 1.0)

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when the factor is 1 or there is nothing to scale."""
        if self.coulomb_gain == 1.0:
            return "a factor of 1 has no effect; give coulomb_gain another value"
        return _explain_without_friction(plant, unit, "coulomb_nm")


@register("wheel", "friction_viscous")
@dataclass(frozen=True, slots=True, kw_only=True)
class ViscousFriction(WheelEffect):
    """viscous friction is `viscous_gain` times what it was"""

    equation = "k_v"
    seen_in = "cold or degraded lubricant; Dawn, August 2012"
    viscous_gain: Annotated[float, Ge(1), Le(5)] = 2.5

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Scale viscous friction."""
        wheel.viscous_gain *= 1.0 + now.level * (self.viscous_gain - 1.0)

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when the factor is 1 or there is nothing to scale."""
        if self.viscous_gain == 1.0:
            return "a factor of 1 has no effect; give viscous_gain another value"
        return _explain_without_friction(plant, unit, "viscous_nm_s")


@register("wheel", "friction_extra")
@dataclass(frozen=True, slots=True, kw_only=True)
class ExtraFriction(WheelEffect):
    """`friction_nm` of dry friction comes to what there is"""

    equation = "tau_fe"
    seen_in = "fuzzy PID paper, eq (9); Cassini, December 2000: more current for the same speed"
    failures = ((101, 5),)
    friction_nm: Annotated[NewtonMetre, Ge(0.0002), Le(0.01)] = 0.003

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Add friction."""
        wheel.friction_nm += now.level * self.friction_nm


@register("wheel", "drag_burst")
@dataclass(frozen=True, slots=True, kw_only=True)
class DragBurst(WheelEffect):
    """bursts of `friction_nm` more dry friction, with torque noise while they last (cage instability)"""

    last = True  # its noise is of the rotor
    draws = 2
    usual = Intermittent(period_s=11.0, duty=3.0 / 11.0)
    equation = "tau_fe and tau_n"
    seen_in = "XMM-Newton: instability of the bearing cage"
    failures = ((101, 3),)
    friction_nm: Annotated[NewtonMetre, Ge(0.0002), Le(0.01)] = 0.004
    noise_nm: Annotated[NewtonMetre, Ge(0), Le(0.005)] = (
        0.0005  # 1 sigma of the torque noise, anew each integration step
    )

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Add friction and noise."""
        wheel.friction_nm += now.level * self.friction_nm
        radius, angle = now.drawn
        normal = math.sqrt(-2.0 * math.log1p(-radius)) * math.cos(2.0 * math.pi * angle)  # Box & Muller
        wheel.offset_nm += now.level * self.noise_nm * normal


@register("wheel", "low_speed_friction")
@dataclass(frozen=True, slots=True, kw_only=True)
class LowSpeedFriction(WheelEffect):
    """`static_nm` of friction at rest comes to the dry friction, below `below_rad_s`; it heals by running fast"""

    steady = False
    remembers = True
    needs_motor = True
    equation = "tau_s - tau_c, where |w| < `below_rad_s`"
    seen_in = "Cassini, December 2000: friction after long running at low speed, gone after running fast"
    static_nm: Annotated[NewtonMetre, Gt(0), Le(0.05)] = 0.002  # twice the Coulomb friction of ithaco_a in all
    below_rad_s: Annotated[RadS, Gt(0)] = 50.0  # speed from which on there is none of it
    heal_speed_rad_s: Annotated[RadS, Gt(0)] = 150.0  # speed above which it heals
    heal_s: Annotated[Seconds, Gt(0)] = 300.0  # that the wheel must run so fast, in all since the onset

    def follow(self, now: Acting, passed_s: float) -> str | None:
        """Count the time at high speed; return that it was enough."""
        if abs(now.speed_rad_s) > self.heal_speed_rad_s:
            now.fast_s += passed_s
        if now.fast_s < self.heal_s - 1e-9:
            return None
        return f"running above {self.heal_speed_rad_s:g} rad/s for {self.heal_s:g} s"

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Add friction at rest while the wheel is slow."""
        if abs(now.speed_rad_s) < self.below_rad_s:
            wheel.static_nm += now.level * self.static_nm


@register("wheel", "seize")
@dataclass(frozen=True, slots=True, kw_only=True)
class Seize(WheelEffect):
    """the bearing seizes: `torque_nm` against any motion of the rotor, whose momentum goes to the body"""

    usual = LinearRise(rise_s=0.2)
    equation = "tau_seize; a constant torque is `stuck_torque`"
    seen_in = "Kepler wheel 4, May 2013: at full torque while the speed went to zero; fuzzy PID paper, eq (7)"
    torque_nm: Annotated[NewtonMetre, Ge(0.3), Le(2)] = 0.8

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Hold the rotor."""
        wheel.seize_nm += now.level * self.torque_nm
