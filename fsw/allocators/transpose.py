"""Each wheel takes the part of a body torque that lies along its axis, as far as it can."""

from __future__ import annotations

from bus.units import Vec3
from fsw.allocators.settings import TransposeConfig
from fsw.families import Allocator
from fsw.records import Allocation, WheelHealth
from fsw.vehicle import Vehicle


class Transpose(Allocator):
    """tau_rw = sat(D0^T tau), each wheel cut to its own limit. One that is dead or not available gets nothing.

    For laws that saturate by design: D0 D0^T > 0, so that what the wheels give together never opposes what was asked for.
    """

    __slots__ = ("_wheels",)

    def __init__(self, config: TransposeConfig, vehicle: Vehicle, period_s: float) -> None:
        self._wheels = vehicle.wheels

    def reset(self) -> None:
        """There is no state."""

    def allocate(self, tau_cmd_b_nm: Vec3, health: WheelHealth) -> Allocation:
        """Return wheel torques within limits [N m] for a body torque, body axes [N m]."""
        wheels = self._wheels
        a, b, c, d = wheels.project(tau_cmd_b_nm)
        p, q, r, s = health.find_usable()
        tau_rw_nm = wheels.limit((a if p else 0.0, b if q else 0.0, c if r else 0.0, d if s else 0.0))
        return Allocation(tau_rw_nm, wheels.combine(tau_rw_nm), 1.0 - wheels.find_load(tau_rw_nm))
