"""No wheel health: every wheel is taken to give what it is told."""

from __future__ import annotations

from bus.units import Vec3, Vec4
from fsw.families import WheelHealthMonitor
from fsw.records import HEALTHY, FourReadings, WheelHealth
from fsw.vehicle import Vehicle
from fsw.wheel_health.settings import NoWheelHealthConfig


class NoWheelHealth(WheelHealthMonitor):
    """Every wheel is healthy, always."""

    __slots__ = ()

    def __init__(self, config: NoWheelHealthConfig, vehicle: Vehicle, period_s: float) -> None:
        """Nothing of these is needed."""

    def reset(self) -> None:
        """There is no state."""

    def step(
        self, dt_s: float, wheels: FourReadings, tau_rw_cmd_nm: Vec4, tau_fault_hat_b_nm: Vec3 | None
    ) -> WheelHealth:
        """Return full health."""
        return HEALTHY
