"""Pseudo-inverse allocation of a body torque to the four wheels."""

from __future__ import annotations

from bus.linear import ZERO4, subtract
from bus.units import Vec3, Vec4
from fsw.allocators.settings import PseudoInverseConfig
from fsw.families import Allocator
from fsw.records import ONES4, Allocation, WheelHealth
from fsw.vehicle import Vehicle


class PseudoInverse(Allocator):
    """The least sum of squares over the wheels' torques, then limited.

    "clip" limits each wheel by itself (Zhang, Ye & Sun 2018, eqs (42)-(43)): more torque, in a bent direction.
    "direction" scales all four by one factor: the body torque keeps its direction and loses length.

    A wheel that delivers a share e of its command is asked for what gives the torque with the others: least squares of
    D0 diag(e) u = tau. Shares below share_min count as share_min, so that a recovery shows. One that is dead or not
    available is asked for nothing, and what wheels give whatever they are told is left to the others to make up for.
    """

    __slots__ = ("_keep_direction", "_share_min", "_use_health", "_wheels")

    def __init__(self, config: PseudoInverseConfig, vehicle: Vehicle, period_s: float) -> None:
        self._wheels = vehicle.wheels
        self._keep_direction = config.saturation == "direction"
        self._share_min = config.share_min
        self._use_health = config.use_health

    def reset(self) -> None:
        """There is no state."""

    def allocate(self, tau_cmd_b_nm: Vec3, health: WheelHealth) -> Allocation:
        """Return wheel torques within limits [N m] for a body torque, body axes [N m]."""
        wheels, bias_nm = self._wheels, ZERO4
        if self._use_health and health.bias_nm != ZERO4:
            bias_nm = health.bias_nm
            tau_cmd_b_nm = subtract(tau_cmd_b_nm, wheels.combine(bias_nm))
        shares = self._find_shares(health)
        tau_rw_nm = wheels.spread(tau_cmd_b_nm) if shares == ONES4 else wheels.spread_weighted(tau_cmd_b_nm, shares)
        load = wheels.find_load(tau_rw_nm)
        if load > 1.0:
            if self._keep_direction:
                a, b, c, d = tau_rw_nm
                tau_rw_nm = (a / load, b / load, c / load, d / load)
            tau_rw_nm = wheels.limit(
                tau_rw_nm
            )  # after scaling too: rounding may leave the largest a bit above its limit
        return Allocation(tau_rw_nm, wheels.combine(tau_rw_nm), 1.0 - load if load < 1.0 else 0.0, shares, bias_nm)

    def _find_shares(self, health: WheelHealth) -> Vec4:
        low = self._share_min
        a, b, c, d = health.effectiveness if self._use_health else ONES4
        p, q, r, s = health.find_usable()
        return (
            0.0 if not p else a if a > low else low,
            0.0 if not q else b if b > low else low,
            0.0 if not r else c if c > low else low,
            0.0 if not s else d if d > low else low,
        )
