"""Sliding-mode fault-tolerant attitude law with an adaptive surface slope.

Source: Zhang, Ye & Sun 2018 (J. NUDT 40(1)), eqs (33)-(35).
"""

from __future__ import annotations

from typing import Final, NamedTuple

from bus.linear import ZERO3
from bus.units import Vec3
from fsw.controllers.settings import SmcConfig
from fsw.families import Controller
from fsw.records import PointingError, WheelHealth
from fsw.vehicle import Vehicle

BETA_MIN: Final = 1e-3  # the proof needs a positive slope; far below the 0.18..0.4 that the laws settle at
BETA_MAX: Final = 10.0  # beta^2 = 100 rad/s on the surface: a slope that no wheel set follows


class SmcInternals(NamedTuple):
    """What the law holds, for telemetry."""

    s_b_rad_s: Vec3
    beta: float


class SlidingMode(Controller):
    """tau = -k1 (s + k2 v) as body torque, s = w + beta^2 q, k1 k2 = 1 (eqs (33)-(34)).

    Differences from the paper, each checked by derivation in docs/ilo-smc.md:

    - (34) prints (D^T D)^-1 D^T, which does not exist for a 3x4 D. The body torque goes to the allocator instead.
    - (35) prints the denominator mu + 4 - q0; the proof (37)-(38) needs mu + 4 - 4 q0. `beta_law` chooses:
      "published" is (35) as printed, the default, because the paper's figures come from it and it settles faster;
      "lyapunov" is the one the proof covers; "fixed" holds beta0.
    - q0 >= 0 is chosen by the caller: the printed law takes the long way round for q0 < 0.
    - beta is kept within BETA_MIN..BETA_MAX, which the paper's scenario does not touch.
    """

    __slots__ = ("_beta", "_beta0", "_k1", "_mu", "_q0_factor", "_s")

    def __init__(self, config: SmcConfig, vehicle: Vehicle, period_s: float) -> None:
        self._k1 = config.k1
        self._mu = config.mu
        self._beta0 = config.beta0
        self._q0_factor = {"published": 1.0, "lyapunov": 4.0, "fixed": None}[config.beta_law]
        self.reset()

    def reset(self) -> None:
        """Back to the initial slope."""
        self._beta = self._beta0
        self._s = ZERO3

    @property
    def internals(self) -> SmcInternals:
        """Sliding variable and slope."""
        return SmcInternals(self._s, self._beta)

    def step(self, dt_s: float, error: PointingError, tau_fault_hat_b_nm: Vec3, health: WheelHealth) -> Vec3:
        """Return the body torque -k1 s - v [N m] and advance beta by forward Euler over dt_s.

        tau_fault_hat_b_nm : v, the observer's fault torque, body axes [N m]
        health             : not used, the observer sees what the wheels do not give
        """
        q0, qx, qy, qz = error.q_tb
        wx, wy, wz = error.omega_bt_b_rad_s
        beta = self._beta
        slope = beta * beta
        sx = wx + slope * qx
        sy = wy + slope * qy
        sz = wz + slope * qz
        k1 = self._k1
        if self._q0_factor is not None:
            q_dot_s = qx * sx + qy * sy + qz * sz
            w_dot_q = wx * qx + wy * qy + wz * qz
            rate = -beta * (q_dot_s - k1 * w_dot_q) / (self._mu + 4.0 - self._q0_factor * q0)
            beta += dt_s * rate
            # Written so that a result that is not a number is caught too.
            self._beta = beta if BETA_MIN <= beta <= BETA_MAX else (BETA_MAX if beta > BETA_MAX else BETA_MIN)
        self._s = (sx, sy, sz)
        vx, vy, vz = tau_fault_hat_b_nm
        return (-k1 * sx - vx, -k1 * sy - vy, -k1 * sz - vz)
