"""The absence of a fault-torque observer, so that a run without one is a choice and not a special case."""

from __future__ import annotations

from bus.linear import ZERO3
from bus.units import Vec3
from fsw.families import Observer
from fsw.observers.settings import NoObserverConfig
from fsw.vehicle import Vehicle


class NoObserver(Observer):
    """Estimates no fault torque: always zero."""

    __slots__ = ()

    def __init__(self, config: NoObserverConfig, vehicle: Vehicle, period_s: float) -> None:
        """Nothing of these is needed."""

    def reset(self) -> None:
        """There is no state."""

    def step(self, dt_s: float, omega_bi_b_rad_s: Vec3, tau_cmd_b_nm: Vec3, h_rw_b_nms: Vec3) -> Vec3:
        """Return zero fault torque, body axes [N m]."""
        return ZERO3

    def shift_rate(self, step_b_rad_s: Vec3) -> None:
        """There is no rate state to move."""
