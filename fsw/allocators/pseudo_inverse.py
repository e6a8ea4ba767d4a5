"""Pseudo-inverse allocation of a body torque to the four wheels."""

from __future__ import annotations

from bus.units import Vec3, Vec4
from fsw.allocators.settings import PseudoInverseConfig
from fsw.families import Allocator
from fsw.records import ALL_WHEELS, Allocation, WheelHealth
from fsw.vehicle import Vehicle

FULL: Vec4 = (1.0, 1.0, 1.0, 1.0)


class PseudoInverse(Allocator):
    """The least sum of squares over the wheels' torques, then limited.

    "clip" limits each wheel by itself (Zhang, Ye & Sun 2018, eqs (42)-(43)): more torque, in a bent direction.
    "direction" scales all four by one factor: the body torque keeps its direction and loses length.

    A wheel that delivers a share e of its command is asked for what gives the torque with the others: least squares of
    D0 diag(e) u = tau. Shares below share_min count as share_min, so that a recovery shows. One that is not available is
    asked for nothing.
    """

    __slots__ = ("_keep_direction", "_share_min", "_wheels")

    def __init__(self, config: PseudoInverseConfig, vehicle: Vehicle, period_s: float) -> None:
        self._wheels = vehicle.wheels
        self._keep_direction = config.saturation == "direction"
        self._share_min = config.share_min

    def reset(self) -> None:
        """There is no state."""

    def allocate(self, tau_cmd_b_nm: Vec3, health: WheelHealth) -> Allocation:
        """Return wheel torques within limits [N m] for a body torque, body axes [N m]."""
        wheels = self._wheels
        if health.effectiveness == FULL and health.available == ALL_WHEELS:
            tau_rw_nm = wheels.spread(tau_cmd_b_nm)
        else:
            tau_rw_nm = wheels.spread_weighted(tau_cmd_b_nm, self._find_shares(health))
        load = wheels.find_load(tau_rw_nm)
        if load > 1.0:
            if self._keep_direction:
                a, b, c, d = tau_rw_nm
                tau_rw_nm = (a / load, b / load, c / load, d / load)
            tau_rw_nm = wheels.limit(
                tau_rw_nm
            )  # after scaling too: rounding may leave the largest a bit above its limit
        return Allocation(tau_rw_nm, wheels.combine(tau_rw_nm), 1.0 - load if load < 1.0 else 0.0)

    def _find_shares(self, health: WheelHealth) -> Vec4:
        low = self._share_min
        a, b, c, d = (
            0.0 if not available else share if share > low else low
            for share, available in zip(health.effectiveness, health.available, strict=True)
        )
        return (a, b, c, d)
