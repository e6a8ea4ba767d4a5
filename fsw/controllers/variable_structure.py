"""Saturated variable-structure attitude law without a disturbance estimate: the baseline of comparisons.

After Hu, Xiao & Friswell, IET Control Theory & Applications 5(2), 2011. It stands in for the law that Zhang, Ye & Sun
2018 compare with (their reference [16], Xiao, Hu, Wang & Poh 2013); it makes no claim about that one.
"""

from __future__ import annotations

from typing import NamedTuple

from bus.units import Vec3, Vec4
from fsw.config import ModelConfig, VariableStructureConfig
from fsw.records import Demand
from fsw.wheel_axes import combine_wheels, project_on_wheels


class VariableStructureInternals(NamedTuple):
    """What the law computed last, for telemetry."""

    s_b_rad_s: Vec3


class VariableStructure:
    """tau_rw = -tau_max sat(D0^T s / epsilon), s = w + k q: commands the wheels directly and ignores the observer."""

    __slots__ = ("_gain", "_k", "_limit", "_s")

    def __init__(self, config: VariableStructureConfig, model: ModelConfig) -> None:
        self._k = config.k
        self._limit = model.wheel_max_torque_nm
        self._gain = model.wheel_max_torque_nm / config.epsilon
        self.reset()

    def reset(self) -> None:
        """The law has no memory; only the telemetry record is cleared."""
        self._s = (0.0, 0.0, 0.0)

    @property
    def internals(self) -> VariableStructureInternals:
        """Sliding variable."""
        return VariableStructureInternals(self._s)

    def step(self, dt_s: float, q_err: Vec4, omega_err_b_rad_s: Vec3, tau_fault_hat_b_nm: Vec3) -> Demand:
        """Return wheel torques [N m] and the body torque they add up to.

        q_err              : body with respect to target, scalar first, q0 >= 0 chosen by the caller
        omega_err_b_rad_s  : body rate with respect to target, body axes [rad/s]
        tau_fault_hat_b_nm : not used, this law has no disturbance estimate
        """
        _, qx, qy, qz = q_err
        wx, wy, wz = omega_err_b_rad_s
        k = self._k
        s = (wx + k * qx, wy + k * qy, wz + k * qz)
        self._s = s
        a, b, c, d = project_on_wheels(s)
        gain, limit = -self._gain, self._limit
        tau_rw_nm = (
            max(-limit, min(limit, gain * a)),
            max(-limit, min(limit, gain * b)),
            max(-limit, min(limit, gain * c)),
            max(-limit, min(limit, gain * d)),
        )
        return Demand(combine_wheels(tau_rw_nm), tau_rw_nm)
