"""Iterative learning observer: the lumped torque that wheel faults and misalignments add to the command.

Source: Zhang, Ye & Sun 2018 (J. NUDT 40(1)), eqs (12)-(13).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from bus.errors import ConfigError, StepSizeError
from bus.units import Mat3, Vec3
from fsw.config import IloConfig, ModelConfig

ZERO: Vec3 = (0.0, 0.0, 0.0)
PERIOD_TOLERANCE = 0.01  # the gains belong to one period; 1 % of jitter in its nominal value is harmless
# A rate error of 1 rad/s would read as 98 N m, a thousand times what the wheels have: only the state is lost.
RESTART_ABOVE_RAD_S = 1.0


class IloInternals(NamedTuple):
    """What the observer holds, for telemetry."""

    omega_hat_b_rad_s: Vec3
    omega_err_b_rad_s: Vec3  # measured minus estimated rate at the last step
    tau_fault_hat_b_nm: Vec3
    restarts: int


def invert_inertia(inertia_kgm2: Mat3) -> Mat3:
    """Inverse of the inertia matrix [1/(kg m^2)], by cofactors. Raises ConfigError when it is not positive definite."""
    (a, b, c), (d, e, f), (g, h, i) = inertia_kgm2
    minor_2 = a * e - b * d
    det = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    if not (a > 0.0 and minor_2 > 0.0 and det > 0.0):
        raise ConfigError(
            f"model.inertia_kgm2 = {inertia_kgm2} kg m^2 is not positive definite "
            f"(leading minors {a:g}, {minor_2:g}, {det:g}, all must be > 0); check its signs and its symmetry"
        )
    return (
        ((e * i - f * h) / det, (c * h - b * i) / det, (b * f - c * e) / det),
        ((f * g - d * i) / det, (a * i - c * g) / det, (c * d - a * f) / det),
        ((d * h - e * g) / det, (b * g - a * h) / det, (a * e - b * d) / det),
    )


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


class Ilo:
    """Iterative learning observer, Zhang, Ye & Sun 2018, eqs (12)-(13), sampled at the control period.

    Differences from the paper: the torque fed in is the one commanded after saturation, eqs (42)-(43), else saturation
    would read as a fault; the wheels' momentum joins the gyroscopic term when the model says so; an estimate that is
    more than RESTART_ABOVE_RAD_S away from the measured rate starts afresh from the measurement.
    """

    __slots__ = (
        "_inertia", "_inverse", "_k1", "_k2", "_k3", "_lambda", "_omega", "_period_s", "_restarts", "_started", "_v",
        "_wheel_momentum", "_wt",
    )  # fmt: skip

    def __init__(self, config: IloConfig, model: ModelConfig) -> None:
        """Raises ConfigError when the inertia is not positive definite."""
        self._period_s = config.period_s
        self._k1 = config.k1
        self._k2 = config.k2
        self._k3 = config.k3
        self._lambda = config.lambda_nm_s
        self._inertia = model.inertia_kgm2
        self._inverse = invert_inertia(model.inertia_kgm2)
        self._wheel_momentum = model.wheel_momentum
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next step takes the measured rate as the estimate and returns zero torque."""
        self._started = False
        self._restarts = 0
        self._omega = ZERO
        self._wt = ZERO
        self._v = ZERO

    @property
    def internals(self) -> IloInternals:
        """Rate estimate, its error, fault torque and the count of restarts."""
        return IloInternals(self._omega, self._wt, self._v, self._restarts)

    def shift_rate(self, step_b_rad_s: Vec3) -> None:
        """Move the rate estimate by a known jump of the rate source [rad/s], so that it does not read as a torque."""
        x, y, z = self._omega
        self._omega = (x + step_b_rad_s[0], y + step_b_rad_s[1], z + step_b_rad_s[2])

    def step(self, dt_s: float, omega_bi_b_rad_s: Vec3, tau_cmd_b_nm: Vec3, h_rw_b_nms: Vec3) -> Vec3:
        """Advance one control period and return the lumped fault torque on the body, body axes [N m].

        Eqs (12)-(13) at T = dt_s: the estimate is carried over the interval that ends now by forward Euler, with the
        torque commanded and the v held in that interval; then the rate error wt, then v = K1 v + K2 wt + K3 wt_before.

        omega_bi_b_rad_s : measured body rate, body axes [rad/s]
        tau_cmd_b_nm     : D0 @ (wheel torques commanded, after limiting) over the interval that ends now [N m]
        h_rw_b_nms       : wheel momentum relative to the body, body axes [N m s]; left out for the paper's plant
        Raises StepSizeError unless dt_s is within 1 % of the configured period.
        """
        period_s = self._period_s
        if not -PERIOD_TOLERANCE * period_s <= dt_s - period_s <= PERIOD_TOLERANCE * period_s:
            raise StepSizeError(
                f"observer ilo was stepped by {dt_s:g} s, but its gains belong to observer.period_s = {period_s:g} s "
                f"(+-1 %); set period_s to the control period and scale k1, k2, k3 with it (see docs/ilo-smc.md)"
            )
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
        k1, k2, k3 = self._k1, self._k2, self._k3
        vx, vy, vz = self._v
        v = (k1 * vx + k2 * ex + k3 * px, k1 * vy + k2 * ey + k3 * py, k1 * vz + k2 * ez + k3 * pz)
        self._wt = (ex, ey, ez)
        self._v = v
        return v

    def _restart(self, omega_bi_b_rad_s: Vec3) -> Vec3:
        """Take the measured rate as the estimate and return zero torque [N m]."""
        self._started = True
        self._omega = omega_bi_b_rad_s
        self._wt = ZERO
        self._v = ZERO
        return ZERO

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
        gain = self._lambda
        tx = tau_cmd_b_nm[0] + vx + gain * ex - (wy * hz - wz * hy)
        ty = tau_cmd_b_nm[1] + vy + gain * ey - (wz * hx - wx * hz)
        tz = tau_cmd_b_nm[2] + vz + gain * ez - (wx * hy - wy * hx)
        (i00, i01, i02), (i10, i11, i12), (i20, i21, i22) = self._inverse
        self._omega = (
            wx + dt_s * (i00 * tx + i01 * ty + i02 * tz),
            wy + dt_s * (i10 * tx + i11 * ty + i12 * tz),
            wz + dt_s * (i20 * tx + i21 * ty + i22 * tz),
        )
