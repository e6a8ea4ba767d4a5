"""Iterative learning observer: the lumped torque that wheel faults and misalignments add to the command.

Source: Zhang, Ye & Sun 2018 (J. NUDT 40(1)), eqs (12)-(13).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final, NamedTuple

from bus.errors import ConfigError, StepSizeError
from bus.linear import ZERO3
from bus.units import Vec3
from fsw.families import Observer
from fsw.observers.settings import IloConfig
from fsw.vehicle import Vehicle

PERIOD_TOLERANCE: Final = 0.01  # the gains belong to one period; 1 % of jitter in its nominal value is harmless
GAP_PERIODS: Final = 5.0  # forward Euler over more of them is no estimate
# A rate error of 1 rad/s would read as 98 N m, a thousand times what the wheels have: only the state is lost.
RESTART_ABOVE_RAD_S: Final = 1.0


class IloInternals(NamedTuple):
    """What the observer holds, for telemetry."""

    omega_hat_b_rad_s: Vec3
    omega_err_b_rad_s: Vec3  # measured minus estimated rate at the last step
    restarts: int


def scale_gains(config: IloConfig, period_s: float) -> IloConfig:
    """Return the observer's settings for another sampling period, with the same behaviour in seconds.

    With z the shift by one period T, eq (13) is v = F(z) wt, F = (K2 z + K3) / (z - K1), in front of the plant
    wt' = (u_f - v)/J. Two things in it are times:

        the steady gain L = (K2 + K3)/(1 - K1), which makes a first-order disturbance observer of time constant J/L;
        the learning filter's pole K1, which forgets with time constant -T/ln K1.

    Both are kept for the new period T': K1' = K1^(T'/T) and K2' + K3' = L (1 - K1'), the split K3/K2 as it was (eq
    (13)'s zero at -K3/K2 is a sampled artefact without a time of its own). For K1 -> 1 the rule tends to
    K2' + K3' = (K2 + K3) T'/T, the pure integrator's, which is used there.

    Raises ConfigError unless period_s > 0.
    """
    if not period_s > 0.0:
        raise ConfigError(f"observer period {period_s:g} s must be > 0 s; give the control period in seconds")
    ratio = period_s / config.period_s
    k1 = config.k1**ratio
    gain_ratio = ratio if config.k1 == 1.0 else (1.0 - k1) / (1.0 - config.k1)
    return replace(config, period_s=period_s, k1=k1, k2=config.k2 * gain_ratio, k3=config.k3 * gain_ratio)


class Ilo(Observer):
    """Iterative learning observer, Zhang, Ye & Sun 2018, eqs (12)-(13), sampled at the control period.

    Differences from the paper: the torque fed in is the one commanded after saturation, eqs (42)-(43), else saturation
    would read as a fault; the wheels' momentum joins the gyroscopic term when the model says so; an estimate that is
    more than RESTART_ABOVE_RAD_S away from the measured rate starts afresh from the measurement.
    """

    __slots__ = (
        "_config", "_inertia", "_inverse", "_omega", "_restarts", "_started", "_v", "_wheel_momentum", "_wt",
    )  # fmt: skip

    def __init__(self, config: IloConfig, vehicle: Vehicle, period_s: float) -> None:
        """period_s: nominal control period [s]. Raises StepSizeError unless the gains' own is within 1 % of it."""
        if not abs(period_s - config.period_s) <= PERIOD_TOLERANCE * config.period_s:
            raise StepSizeError(
                f"observer ilo would be stepped every {period_s:g} s, but its gains belong to observer.period_s = "
                f"{config.period_s:g} s (+-1 %); set period_s to the control period and scale k1, k2, k3 with it (see "
                "docs/ilo-smc.md)"
            )
        self._config = config
        self._inertia = vehicle.inertia_kgm2
        self._inverse = vehicle.inverse_inertia
        self._wheel_momentum = vehicle.wheel_momentum
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next step takes the measured rate as the estimate and returns zero torque."""
        self._started = False
        self._restarts = 0
        self._omega = ZERO3
        self._wt = ZERO3
        self._v = ZERO3

    @property
    def internals(self) -> IloInternals:
        """Rate estimate, its error and the count of restarts."""
        return IloInternals(self._omega, self._wt, self._restarts)

    def shift_rate(self, step_b_rad_s: Vec3) -> None:
        """Move the rate estimate by a known jump of the rate source [rad/s], so that it does not read as a torque."""
        x, y, z = self._omega
        self._omega = (x + step_b_rad_s[0], y + step_b_rad_s[1], z + step_b_rad_s[2])

    def step(self, dt_s: float, omega_bi_b_rad_s: Vec3, tau_cmd_b_nm: Vec3, h_rw_b_nms: Vec3) -> Vec3:
        """Advance by dt_s and return the lumped fault torque on the body, body axes [N m].

        Eqs (12)-(13) at T = dt_s: the estimate is carried over the interval that ends now by forward Euler, with the
        torque commanded and the v held in that interval; then the rate error wt, then v = K1 v + K2 wt + K3 wt_before.
        After lost ticks dt_s is longer than the period that the gains belong to: they are then scaled to it, see
        `scale_gains`, and after more than GAP_PERIODS the estimate starts afresh.

        omega_bi_b_rad_s : measured body rate, body axes [rad/s]
        tau_cmd_b_nm     : D0 @ (wheel torques commanded, as sent) over the interval that ends now [N m]
        h_rw_b_nms       : wheel momentum relative to the body, body axes [N m s]; left out for the paper's plant
        """
        config = self._config
        period_s = config.period_s
        if not -PERIOD_TOLERANCE * period_s <= dt_s - period_s <= PERIOD_TOLERANCE * period_s:
            if not 0.0 < dt_s <= GAP_PERIODS * period_s:
                return self._restart(omega_bi_b_rad_s)
            config = scale_gains(config, dt_s)
        if not self._started:
            return self._restart(omega_bi_b_rad_s)
        self._propagate(dt_s, tau_cmd_b_nm, h_rw_b_nms)
        wx, wy, wz = self._omega
        px, py, pz = self._wt
        ex = omega_bi_b_rad_s[0] - wx
        ey = omega_bi_b_rad_s[1] - wy
        ez = omega_bi_b_rad_s[2] - wz
        bound = RESTART_ABOVE_RAD_S
        if not (-bound < ex < bound and -bound < ey < bound and -bound < ez < bound):
            self._restarts += 1
            return self._restart(omega_bi_b_rad_s)
        k1, k2, k3 = config.k1, config.k2, config.k3
        vx, vy, vz = self._v
        v = (k1 * vx + k2 * ex + k3 * px, k1 * vy + k2 * ey + k3 * py, k1 * vz + k2 * ez + k3 * pz)
        self._wt = (ex, ey, ez)
        self._v = v
        return v

    def _restart(self, omega_bi_b_rad_s: Vec3) -> Vec3:
        """Take the measured rate as the estimate and return zero torque [N m]."""
        self._started = True
        self._omega = omega_bi_b_rad_s
        self._wt = ZERO3
        self._v = ZERO3
        return ZERO3

    def _propagate(self, dt_s: float, tau_cmd_b_nm: Vec3, h_rw_b_nms: Vec3) -> None:
        """Forward Euler on eq (12) over the interval that ends now."""
        wx, wy, wz = self._omega
        (j00, j01, j02), (j10, j11, j12), (j20, j21, j22) = self._inertia
        hx = j00 * wx + j01 * wy + j02 * wz
        hy = j10 * wx + j11 * wy + j12 * wz
        hz = j20 * wx + j21 * wy + j22 * wz
        if self._wheel_momentum:
            hx += h_rw_b_nms[0]
            hy += h_rw_b_nms[1]
            hz += h_rw_b_nms[2]
        ex, ey, ez = self._wt
        vx, vy, vz = self._v
        gain = self._config.lambda_nm_s
        tx = tau_cmd_b_nm[0] + vx + gain * ex - (wy * hz - wz * hy)
        ty = tau_cmd_b_nm[1] + vy + gain * ey - (wz * hx - wx * hz)
        tz = tau_cmd_b_nm[2] + vz + gain * ez - (wx * hy - wy * hx)
        (i00, i01, i02), (i10, i11, i12), (i20, i21, i22) = self._inverse
        self._omega = (
            wx + dt_s * (i00 * tx + i01 * ty + i02 * tz),
            wy + dt_s * (i10 * tx + i11 * ty + i12 * tz),
            wz + dt_s * (i20 * tx + i21 * ty + i22 * tz),
        )
