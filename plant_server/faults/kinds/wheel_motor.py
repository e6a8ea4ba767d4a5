"""Faults of a reaction wheel's motor, driver and supply."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from bus.units import Ge, Le, Unit
from plant_server.config import PlantConfig, WheelMotorConfig
from plant_server.faults.effects import (
    Acting,
    WheelDisturbance,
    WheelEffect,
    explain_without_motor,
    is_neutral,
    register,
)  # fmt: skip
from plant_server.faults.units import WHEELS


@register("wheel", "gain_kt")
@dataclass(frozen=True, slots=True, kw_only=True)
class TorqueGain(WheelEffect):
    """the motor's torque constant is `torque_gain` times what it was"""

    needs_motor = True
    equation = "C_t"
    seen_in = "fuzzy PID paper, eq (12): ageing; wear-out as exp(-a t) in remaining-life studies of wheels"
    torque_gain: Annotated[float, Ge(0.2), Le(1)] = 0.6

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Weaken the motor."""
        wheel.torque_gain *= 1.0 + now.level * (self.torque_gain - 1.0)

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when the gain stays 1 or the wheel has no motor."""
        if is_neutral(self.torque_gain, 1.0):
            return "a torque gain of 1 has no effect; give torque_gain another value"
        return explain_without_motor(self, plant, unit)


@register("wheel", "gain_driver")
@dataclass(frozen=True, slots=True, kw_only=True)
class DriverGain(WheelEffect):
    """the driver gives `driver_gain` times the current that it should"""

    needs_motor = True
    equation = "C_d"
    seen_in = "fuzzy PID paper: gain falls with the age and temperature of the electronics"
    driver_gain: Annotated[float, Ge(-1), Le(1.2)] = 0.6  # -1: polarity swapped

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Change the current."""
        wheel.driver_gain *= 1.0 + now.level * (self.driver_gain - 1.0)

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when the gain stays 1 or the wheel has no driver."""
        if is_neutral(self.driver_gain, 1.0):
            return "a driver gain of 1 has no effect; give driver_gain another value"
        return explain_without_motor(self, plant, unit)


@register("wheel", "idle")
@dataclass(frozen=True, slots=True, kw_only=True)
class Idle(WheelEffect):
    """the motor has no current and the rotor runs free, until the wheel is reset"""

    rises = False
    switches = True
    resettable = True
    equation = "m_on = 0"
    seen_in = "fuzzy PID paper, eq (8): driver shut down or latched up"

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Switch the motor off."""
        wheel.motor_on = wheel.motor_on and now.level == 0.0


@register("wheel", "runaway")
@dataclass(frozen=True, slots=True, kw_only=True)
class Runaway(WheelEffect):
    """the motor has `current_a` whatever the command"""

    rises = False
    switches = True
    needs_motor = True
    equation = "I_dem = I_stuck"
    seen_in = "driver shorted: full torque whatever is asked"
    current_a: Annotated[float, Unit("A"), Ge(-5), Le(5)] = (
        0.95  # 5 V at 0.19 A/V: all that the driver can give, either way
    )

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Put a current in place of what there was; a torque that an earlier fault holds gives way."""
        if now.level > 0.0:
            wheel.is_stuck = True
            wheel.stuck_current_a = self.current_a
            if wheel.gain == 0.0:
                wheel.gain, wheel.offset_nm = 1.0, 0.0


@register("wheel", "bus_sag")
@dataclass(frozen=True, slots=True, kw_only=True)
class BusSag(WheelEffect):
    """the wheel's supply has `voltage_v`"""

    rises = False
    switches = True
    needs_motor = True
    equation = "V_bus"
    seen_in = "eclipse, a failed battery cell, a load on the same bus"
    voltage_v: Annotated[float, Unit("V"), Ge(5), Le(50)] = 14.0

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Put a voltage in place of the bus's own."""
        if now.level > 0.0:
            wheel.has_bus = True
            wheel.bus_v = self.voltage_v

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when that is the voltage it has, or the wheel has no supply."""
        if word := explain_without_motor(self, plant, unit):
            return word
        if plant is None or unit not in WHEELS:
            return None
        motor = getattr(plant.wheels[WHEELS.index(unit)], "motor", None) or WheelMotorConfig()
        if not is_neutral(self.voltage_v, motor.bus_v):
            return None
        return f"{self.voltage_v:g} V have no effect: {unit} has that; give voltage_v another value"
