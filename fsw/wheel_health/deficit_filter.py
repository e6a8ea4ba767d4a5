"""Torque that a wheel's rotor lacks, whatever took it: what an alarm goes by."""

from __future__ import annotations

import math
from typing import Final

DRY_RAD_S: Final = 0.1  # speed within which dry friction changes its sign
FIRST_SPEED: Final = 0.0025  # variances to begin with [rad^2/s^2],
FIRST_DEFICIT_NM2: Final = 1e-8  # [N^2 m^2]: a wheel is taken to be sound, so that the start is no alarm
SETTLED: Final = 1e-12  # relative change of the variance in a step below which it is taken to stay


class DeficitFilter:
    """Kalman filter of x = [w, d]: J dw/dt = k_t I - c tanh(w / 0.1) - v w - d; w is measured, d walks.

    Rederived, see docs/wheel-health.md. An adapting filter's own innovations hide a fault, this one's state does not.
    """

    __slots__ = (
        "_coulomb_nm",
        "_inertia_kgm2",
        "_k_d",
        "_k_w",
        "_noise",
        "_p_dd",
        "_p_wd",
        "_p_ww",
        "_settled_s",
        "_speed_walk",
        "_viscous_nm_s",
        "_walk_nm2_s",
        "deficit_nm",
        "speed_rad_s",
    )

    def __init__(
        self,
        inertia_kgm2: float,
        coulomb_nm: float,
        viscous_nm_s: float,
        torque_noise_nm: float,
        noise_rad_s: float,
        walk_nm_sqrt_s: float,
    ) -> None:
        """torque_noise_nm : of the motor's torque, one sigma a step; walk_nm_sqrt_s : how fast a deficit may wander"""
        self._inertia_kgm2 = inertia_kgm2
        self._coulomb_nm = coulomb_nm
        self._viscous_nm_s = viscous_nm_s
        self._speed_walk = (torque_noise_nm / inertia_kgm2) ** 2
        self._walk_nm2_s = walk_nm_sqrt_s * walk_nm_sqrt_s
        self._noise = noise_rad_s * noise_rad_s
        self._k_w = self._k_d = 0.0
        self.restart(0.0)

    def restart(self, speed_rad_s: float) -> None:
        """Start from a speed, with a sound wheel."""
        self.deficit_nm = 0.0
        self._p_dd = FIRST_DEFICIT_NM2
        self.anchor(speed_rad_s)

    def anchor(self, speed_rad_s: float) -> None:
        """Take a speed as it is measured, after a time in which there was none; the deficit stays."""
        self.speed_rad_s = speed_rad_s
        self._p_ww, self._p_wd = FIRST_SPEED, 0.0
        self._settled_s = (
            -1.0
        )  # the step at which the gains do not change any more; nothing in them depends on the data

    def step(self, dt_s: float, torque_nm: float, measured_rad_s: float, heard: bool) -> None:
        """Advance over dt_s with a mean motor torque [N m]; without a measurement it predicts."""
        w, d = self.speed_rad_s, self.deficit_nm
        h = dt_s / self._inertia_kgm2
        w += h * (torque_nm - self._coulomb_nm * math.tanh(w / DRY_RAD_S) - self._viscous_nm_s * w - d)
        if dt_s == self._settled_s and heard:
            innovation = measured_rad_s - w
            self.speed_rad_s, self.deficit_nm = w + self._k_w * innovation, d + self._k_d * innovation
            return
        f = 1.0 - h * self._viscous_nm_s
        p_wd, p_dd = self._p_wd, self._p_dd
        p_ww = f * f * self._p_ww - h * (2.0 * f * p_wd - h * p_dd) + self._speed_walk * dt_s * dt_s
        p_wd = f * p_wd - h * p_dd
        p_dd += self._walk_nm2_s * dt_s
        if heard:
            s = p_ww + self._noise
            k_w, k_d = p_ww / s, p_wd / s
            innovation = measured_rad_s - w
            w += k_w * innovation
            d += k_d * innovation
            p_dd -= k_d * p_wd
            p_wd -= k_w * p_wd
            p_ww -= k_w * p_ww
            before = self._p_dd
            self._settled_s = dt_s if -SETTLED * before < p_dd - before < SETTLED * before else -1.0
            self._k_w, self._k_d = k_w, k_d
        else:
            self._settled_s = -1.0
        self.speed_rad_s, self.deficit_nm = w, d
        self._p_ww, self._p_wd, self._p_dd = p_ww, p_wd, p_dd
