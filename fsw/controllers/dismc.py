"""Discrete integral sliding mode with an estimate of what disturbs the body.

Source: Wang Dayi, Duan Wenjie, Liu Chengrui, He Yingzi, CN103699131B (2016), abstract and claim 1. The law printed there has
lost a bracket and diverges as it stands; the derivation of this one, and what was added, is in docs/dismc.md.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from bus.errors import ConfigError
from bus.linear import ZERO3, add, scale, subtract, times
from bus.units import Vec3
from fsw.controllers.dismc_stability import find_stable_range, is_stable_between
from fsw.controllers.settings import DismcConfig
from fsw.families import Controller
from fsw.records import PointingError, WheelHealth
from fsw.vehicle import Vehicle

LARGEST_C: Final = 10.0  # of c over 2 zeta f
JUMP_RAD: Final = 0.1  # an angle that is off its prediction by more, beside what its rate explains, is another target's


class DismcInternals(NamedTuple):
    """What the law holds, for telemetry."""

    sigma_b_nms: Vec3
    drift_b_rad_s: Vec3  # estimate of what turns the body beside its rate: gyro bias, kinematics
    disturbance_b_nm: Vec3  # estimate of what acts on it beside the wheels: J times d_omega
    windup_b_nm: Vec3  # torque that was asked for and not given, over the last interval


class DiscreteIntegralSlidingMode(Controller):
    """sigma_k = G (x_k - x_0) + eps_k, x = (theta, omega), theta = 2 q_v, on x+ = Phi x + Gamma v + d with T the period:

        eps_k = eps_(k-1) - G (Phi - I - Gamma K0) x_(k-1) - T (v^ach - v)                    G = (c J, J)
        v_k   = -K0 x_k - (G d_k + kappa sigma_k) / T                                          K0 = J (f^2, 2 zeta f)
        d_k   = (1 - lam) d_(k-1) + lam (x_k - Phi x_(k-1) - Gamma v^ach)

    v^ach is the torque that acted over the interval that ends now, as the allocator really gave it: what was sent `latency`
    samples before the last. kappa = lam = 1 is the patent, with sigma_(k+1) = G (d_k - d_(k-1)).

    Differs from the patent: the bracket; kappa, lam, latency and the last term of eps are added; x_0 is the state at the
    first step, and at one after a jump of the target, and takes no part in v. The estimates are held as rates, d / T, so
    that a period that was longer does no harm. Gyroscopic torque is part of d. What the observer reports is made up for
    once: d leaves it out.
    """

    __slots__ = (
        "_anti_windup", "_asked", "_c", "_caution", "_damping", "_disturbance", "_drift", "_eps", "_fault", "_gap",
        "_inertia", "_inverse", "_kappa", "_lam", "_last", "_latency", "_period_s", "_sent", "_sigma", "_start",
        "_started", "_stiffness",
    )  # fmt: skip

    def __init__(self, config: DismcConfig, vehicle: Vehicle, period_s: float) -> None:
        """period_s: control period [s].

        Raises ConfigError where the reference motion or, unless `stability` says warn, the loop is not stable.
        """
        f, damping = config.frequency_rad_s, config.damping
        if not period_s * f < 2.0 * damping:
            raise ConfigError(
                f"controller.frequency_rad_s = {f:g} rad/s is too fast for a control period of {period_s:g} s: "
                f"frequency times period must be below twice the damping, {2.0 * damping:g}"
            )
        self._inertia, self._inverse = vehicle.inertia_kgm2, vehicle.inverse_inertia
        self._stiffness = f * f
        self._damping = 2.0 * damping * f
        self._c = self._damping if config.c_1_s is None else config.c_1_s
        if self._c > LARGEST_C * self._damping:
            raise ConfigError(
                f"controller.c_1_s = {self._c:g} 1/s makes a surface of the angle alone, to which limited torque does "
                f"not bring a body; at most {LARGEST_C:g} times 2 damping frequency, {LARGEST_C * self._damping:g} 1/s"
            )
        self._kappa, self._lam = config.kappa, config.lam
        self._latency = config.latency
        self._anti_windup = config.anti_windup
        self._period_s = period_s
        self._caution = _check_range(config, period_s, self._c)
        self.reset()

    def reset(self) -> None:
        """Begin a new surface at the next step, with no disturbance known."""
        self._started = False
        self._start: tuple[Vec3, Vec3] = (ZERO3, ZERO3)
        self._last: tuple[Vec3, Vec3] = (ZERO3, ZERO3)
        self._sigma = self._eps = self._drift = self._disturbance = self._gap = self._fault = ZERO3
        # newest last; the first of each is what acted over the interval that ends at the next step
        self._asked: list[Vec3] = [ZERO3] * (self._latency + 1)
        self._sent: list[Vec3] = [ZERO3] * (self._latency + 1)

    @property
    def internals(self) -> DismcInternals:
        """Surface and estimates."""
        return DismcInternals(self._sigma, self._drift, times(self._inertia, self._disturbance), self._gap)

    @property
    def caution(self) -> str:
        """That the loop may be unstable, where it may."""
        return self._caution

    def step(self, dt_s: float, error: PointingError, tau_fault_hat_b_nm: Vec3, health: WheelHealth) -> Vec3:
        """Return the body torque v - tau_fault_hat [N m]; health is the allocator's business."""
        _, qx, qy, qz = error.q_tb
        theta, omega = (2.0 * qx, 2.0 * qy, 2.0 * qz), error.omega_bt_b_rad_s
        if self._started:
            self._follow(dt_s, theta, omega)
        else:
            self._started = True
            self._start = (theta, omega)
        self._last = (theta, omega)
        theta_0, omega_0 = self._start
        inertia, c = self._inertia, self._c
        # all that G multiplies, under one J: sigma = J (c (theta - theta_0) + omega - omega_0) + eps
        moved = add(scale(subtract(theta, theta_0), c), subtract(omega, omega_0))
        self._sigma = sigma = add(times(inertia, moved), self._eps)
        wanted = add(scale(theta, self._stiffness), scale(omega, self._damping))
        known = add(scale(self._drift, c), self._disturbance)
        x, y, z = times(inertia, add(wanted, known))
        k = self._kappa / self._period_s
        v = (-x - k * sigma[0], -y - k * sigma[1], -z - k * sigma[2])
        del self._asked[0]
        self._asked.append(v)
        self._fault = tau_fault_hat_b_nm
        return subtract(v, tau_fault_hat_b_nm)

    def note_sent(self, tau_b_nm: Vec3) -> None:
        """What the wheels are expected to give from now on; of it, what makes up for the observer's torque is not v's."""
        del self._sent[0]
        self._sent.append(add(tau_b_nm, self._fault))

    def _follow(self, dt_s: float, theta: Vec3, omega: Vec3) -> None:
        """Bring estimate and integral up to the state that is measured now."""
        last_theta, last_omega = self._last
        acted = self._sent[0]
        off = subtract(theta, add(last_theta, scale(last_omega, dt_s)))
        x, y, z = last_omega
        if max(abs(off[0]), abs(off[1]), abs(off[2])) > JUMP_RAD + 2.0 * dt_s * math.sqrt(x * x + y * y + z * z):
            self._start = (theta, omega)
            self._eps = ZERO3
            return
        share = self._lam
        drift, disturbance = scale(off, 1.0 / dt_s), scale(subtract(omega, last_omega), 1.0 / dt_s)
        disturbance = subtract(disturbance, times(self._inverse, acted))
        self._drift = add(self._drift, scale(subtract(drift, self._drift), share))
        self._disturbance = add(self._disturbance, scale(subtract(disturbance, self._disturbance), share))
        self._gap = gap = subtract(acted, self._asked[0]) if self._anti_windup else ZERO3
        run = add(scale(last_theta, self._stiffness), scale(last_omega, self._damping - self._c))
        self._eps = add(self._eps, scale(subtract(times(self._inertia, run), gap), dt_s))


def _check_range(config: DismcConfig, period_s: float, c_1_s: float) -> str:
    """What the settings leave doubtful, in words; empty where the loop is stable over the whole range of torque ratios."""
    low, high = config.torque_ratio
    if not low <= high:
        raise ConfigError(f"controller.torque_ratio = {config.torque_ratio}: the first must not be above the second")
    if is_stable_between(config, period_s, c_1_s, low, high):
        return ""
    least, most = find_stable_range(config, period_s, c_1_s)
    stable = f"is stable for {least:.2f} to {most:.2f}" if most > least else "is stable for no ratio"
    words = (
        f"controller: with kappa {config.kappa:g}, lam {config.lam:g} and a latency of {config.latency} samples the loop "
        f"{stable} of the torque that wheel health says; torque_ratio asks for {low:g} to {high:g}; "
        "lower kappa, lam, the latency or the frequency"
    )
    if config.stability == "refuse":
        raise ConfigError(f"{words}; or stability: warn, to fly it all the same")
    return words
