"""Pseudo-inverse allocation of a body torque to the four wheels."""

from __future__ import annotations

from bus.units import Vec3, Vec4
from fsw.config import ModelConfig, PseudoInverseConfig
from fsw.wheel_axes import spread_on_wheels


class PseudoInverse:
    """tau_rw = D0^T (D0 D0^T)^-1 tau, the least sum of squares over the wheels, then limited.

    "clip" limits each wheel by itself (Zhang, Ye & Sun 2018, eqs (42)-(43)): more torque, in a bent direction.
    "direction" scales all four by one factor: the body torque keeps its direction and loses length.
    """

    __slots__ = ("_keep_direction", "_limit")

    def __init__(self, config: PseudoInverseConfig, model: ModelConfig) -> None:
        self._limit = model.wheel_max_torque_nm
        self._keep_direction = config.saturation == "direction"

    def allocate(self, tau_cmd_b_nm: Vec3) -> Vec4:
        """Return wheel torques within limits [N m] for a body torque, body axes [N m]."""
        return self.limit(spread_on_wheels(tau_cmd_b_nm))

    def limit(self, tau_rw_nm: Vec4) -> Vec4:
        """Return the wheel torques within +-tau_max [N m]: clipped one by one, or all scaled by one factor."""
        a, b, c, d = tau_rw_nm
        top = self._limit
        if self._keep_direction:
            largest = max(abs(a), abs(b), abs(c), abs(d))
            if largest <= top:
                return tau_rw_nm
            factor = top / largest
            a, b, c, d = a * factor, b * factor, c * factor, d * factor
        # After scaling too: rounding may leave the largest a bit above the limit.
        return (max(-top, min(top, a)), max(-top, min(top, b)), max(-top, min(top, c)), max(-top, min(top, d)))
