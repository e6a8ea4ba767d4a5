"""Variable-structure attitude law without a disturbance estimate: the baseline of comparisons.

After Hu, Xiao & Friswell, IET Control Theory & Applications 5(2), 2011. It stands in for the law that Zhang, Ye & Sun
2018 compare with (their reference [16], Xiao, Hu, Wang & Poh 2013); it makes no claim about that one.
"""

from __future__ import annotations

from typing import NamedTuple

from bus.linear import ZERO3
from bus.units import Vec3
from fsw.controllers.settings import VariableStructureConfig
from fsw.families import Controller
from fsw.records import PointingError, WheelHealth
from fsw.vehicle import Vehicle


class VariableStructureInternals(NamedTuple):
    """What the law computed last, for telemetry."""

    s_b_rad_s: Vec3


class VariableStructure(Controller):
    """tau = -(tau_max/epsilon) s, s = w + k q, whatever the observer says.

    With the allocator `transpose`, which cuts each wheel's D0^T tau to its limit, the wheels get what the law was printed
    for, tau_rw = -tau_max sat(D0^T s / epsilon).
    """

    __slots__ = ("_gain", "_k", "_s")

    def __init__(self, config: VariableStructureConfig, vehicle: Vehicle, period_s: float) -> None:
        self._k = config.k
        self._gain = -max(vehicle.wheels.max_torque_nm) / config.epsilon
        self.reset()

    def reset(self) -> None:
        """The law has no memory; only the telemetry record is cleared."""
        self._s = ZERO3

    @property
    def internals(self) -> VariableStructureInternals:
        """Sliding variable."""
        return VariableStructureInternals(self._s)

    def step(self, dt_s: float, error: PointingError, tau_fault_hat_b_nm: Vec3, health: WheelHealth) -> Vec3:
        """Return the body torque [N m]. Fault torque and health are not used: this law has no disturbance estimate."""
        _, qx, qy, qz = error.q_tb
        wx, wy, wz = error.omega_bt_b_rad_s
        k, gain = self._k, self._gain
        x, y, z = self._s = (wx + k * qx, wy + k * qy, wz + k * qz)
        return (gain * x, gain * y, gain * z)
