"""Finite-time attitude law by adding a power integrator, on modified Rodrigues parameters.

Source: Li & Liu 2011 (Aerospace Control and Application 37(3)), law (28). Derivation and figures: docs/finite-time.md.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from bus.errors import ConfigError
from bus.linear import ZERO3, add, subtract, times
from bus.units import Vec3, Vec4
from fsw.controllers.finite_time import HALVINGS, QUARTER, find_gyroscopic_torque
from fsw.controllers.gain_condition import find_dominance, find_largest_beta, find_least_gain
from fsw.controllers.latency import Latency
from fsw.controllers.settings import PowerIntegratorConfig
from fsw.controllers.signed_power import sig
from fsw.families import Controller
from fsw.mrp import find_mrp
from fsw.records import ONES4, PointingError, WheelHealth
from fsw.vehicle import Vehicle

FIVE_THIRDS: Final = 5.0 / 3.0
FIFTH: Final = 0.2
LEAST_SHARE: Final = (
    0.05  # of the torque in the weakest direction, as far as beta follows it down: it must go on moving
)


class PowerIntegratorInternals(NamedTuple):
    """What the law acted on, for telemetry."""

    sigma: Vec3  # of the error, after the torques on their way
    omega_bt_b_rad_s: Vec3  # likewise
    xi: Vec3  # distance from the manifold, (rad/s)^(5/3)
    beta_rad_s: float
    gain_s2: float  # gain as an acceleration, as far as the proof counts it [rad/s^2]
    least_gain_s2: float  # that the proof needs for beta as set


class PowerIntegrator(Controller):
    """The rate is led to w*_i = -beta sig(s_i)^(3/5); the torque before - v is, element by element,

        xi = sig(w)^(5/3) + beta^(5/3) s
        tau = w x J w - m J sig(xi)^(1/5)      inertia_weight: true, m in rad/s^2
        tau = w x J w - m sig(xi)^(1/5)        inertia_weight: false, m in N m                      eq (28)

    which takes the error to zero in finite time from everywhere (|s| <= 1) where m >= m_min(beta), see gain_condition.py.

    sampling: implicit: the acceleration that is right at the end of the period, from the scalar equation of each axis

        w+ = w - T m_a sig(sig(w+)^(5/3) + beta^(5/3) (s + T/4 w+))^(1/5),   m_a = m or m/J_ii,

    torque J (w+ - w)/T or J_ii (w+ - w)/T: the fifth root has an infinite slope on the manifold, where the explicit form
    chatters.

    Differences from the paper: exponents and gain condition are reconstructed (our copy has lost most equations); V1 is
    2 ln(1 + s.s), so that the paper's time-varying r(t) drops out; a turning target is followed as in finite_time.py.
    """

    __slots__ = (
        "_adapt",
        "_beta",
        "_beta53",
        "_beta_set",
        "_caution",
        "_explicit",
        "_gain",
        "_gyroscopic",
        "_inertia",
        "_latency",
        "_least",
        "_m",
        "_omega",
        "_period_s",
        "_shares",
        "_sigma",
        "_weakest_nm",
        "_weight",
        "_wheels",
        "_xi",
    )

    def __init__(self, config: PowerIntegratorConfig, vehicle: Vehicle, period_s: float) -> None:
        """Raises ConfigError where the gain is below what the proof needs and gain_check is `refuse`."""
        self._m, self._beta_set = config.m, config.beta
        self._weight = config.inertia_weight
        self._explicit = config.sampling == "explicit"
        self._inertia = vehicle.inertia_kgm2
        self._gyroscopic = config.gyroscopic and not vehicle.wheel_momentum  # see finite_time.py
        self._latency = Latency(config.latency, vehicle, period_s)
        self._period_s = period_s
        self._gain = config.m * (1.0 if config.inertia_weight else find_dominance(vehicle.inverse_inertia))
        self._least, _ = find_least_gain(config.beta)
        self._caution = ""
        if config.gain_check != "off" and not self._gain >= self._least:
            self._caution = _explain_gain(config, self._gain, self._least)
            if config.gain_check == "refuse":
                raise ConfigError(f"{self._caution}, or gain_check: warn")
        self._adapt = config.adapt_beta
        self._wheels = vehicle.wheels
        self._weakest_nm = self._find_weakest(ONES4)
        self.reset()

    def reset(self) -> None:
        """Forget the torques on their way and what is known of the wheels."""
        self._latency.reset()
        self._sigma = self._omega = self._xi = ZERO3
        self._shares = ONES4
        self._set_beta(self._beta_set)

    @property
    def internals(self) -> PowerIntegratorInternals:
        """Error, distance from the manifold, slope and gain."""
        return PowerIntegratorInternals(self._sigma, self._omega, self._xi, self._beta, self._gain, self._least)

    @property
    def caution(self) -> str:
        """That the gain is not covered by the proof, where it is not and `gain_check` is `warn`."""
        return self._caution

    def note_sent(self, tau_b_nm: Vec3) -> None:
        """A torque is on its way [N m]."""
        self._latency.note_sent(tau_b_nm)

    def step(self, dt_s: float, error: PointingError, tau_fault_hat_b_nm: Vec3, health: WheelHealth) -> Vec3:
        """Return the body torque [N m]. dt_s is not used: the law has no memory but the torques on their way.

        tau_fault_hat_b_nm : v, the observer's fault torque, body axes [N m]
        health             : with adapt_beta, beta follows the torque that is left
        """
        if self._adapt:
            self._follow(health)
        error = self._latency.predict(error, tau_fault_hat_b_nm)
        self._sigma = s = find_mrp(error.q_tb)
        self._omega = w = error.omega_bt_b_rad_s
        b = self._beta53
        self._xi = (
            sig(w[0], FIVE_THIRDS) + b * s[0], sig(w[1], FIVE_THIRDS) + b * s[1], sig(w[2], FIVE_THIRDS) + b * s[2],
        )  # fmt: skip
        torque = self._push(s, w)
        if self._gyroscopic:
            torque = add(torque, find_gyroscopic_torque(self._inertia, error))
        return subtract(torque, tau_fault_hat_b_nm)

    def _push(self, s: Vec3, w: Vec3) -> Vec3:
        """The torque towards the manifold and along it [N m]."""
        m, (x, y, z) = self._m, self._xi
        (jx, _, _), (_, jy, _), (_, _, jz) = self._inertia
        if self._explicit:
            accel = (-m * sig(x, FIFTH), -m * sig(y, FIFTH), -m * sig(z, FIFTH))
            return times(self._inertia, accel) if self._weight else accel
        if self._weight:
            find = self.find_acceleration
            return times(self._inertia, (find(s[0], w[0], m), find(s[1], w[1], m), find(s[2], w[2], m)))
        return (
            jx * self.find_acceleration(s[0], w[0], m / jx),
            jy * self.find_acceleration(s[1], w[1], m / jy),
            jz * self.find_acceleration(s[2], w[2], m / jz),
        )

    def find_acceleration(self, sigma: float, omega_rad_s: float, gain_s2: float) -> float:
        """Return (w+ - w)/T of one axis [rad/s^2]: the equation is monotone in w+, which bisection finds.

        From its side, w+ is between w and w less T times the acceleration at w.
        """
        period_s, b = self._period_s, self._beta53
        quarter, reach = QUARTER * period_s, period_s * gain_s2
        xi = sig(omega_rad_s, FIVE_THIRDS) + b * (sigma + quarter * omega_rad_s)
        other = omega_rad_s - reach * sig(xi, FIFTH)
        low, high = (other, omega_rad_s) if xi > 0.0 else (omega_rad_s, other)
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            if not low < middle < high:
                break
            xi = sig(middle, FIVE_THIRDS) + b * (sigma + quarter * middle)
            if middle - omega_rad_s + reach * sig(xi, FIFTH) > 0.0:
                high = middle
            else:
                low = middle
        return (0.5 * (low + high) - omega_rad_s) / period_s

    def _follow(self, health: WheelHealth) -> None:
        """Let beta^2 follow the torque in the weakest direction of the wheels that are left: braking takes beta^2."""
        shares = health.find_shares()
        if shares != self._shares:
            self._shares = shares
            left = self._find_weakest(shares) / self._weakest_nm
            left = 1.0 if left > 1.0 else left if left > LEAST_SHARE else LEAST_SHARE
            self._set_beta(self._beta_set * math.sqrt(left))

    def _find_weakest(self, shares: Vec4) -> float:
        """The torque that these wheels can give in every direction [N m]: the least over the normals of their facets."""
        la, lb, lc, ld = self._wheels.max_torque_nm
        a, b, c, d = shares
        return self._wheels.find_weakest((la * a, lb * b, lc * c, ld * d))

    def _set_beta(self, beta_rad_s: float) -> None:
        self._beta, self._beta53 = beta_rad_s, math.pow(beta_rad_s, FIVE_THIRDS)


def _explain_gain(config: PowerIntegratorConfig, gain: float, least: float) -> str:
    """Why the proof does not cover a gain, and what it would cover."""
    given = f"{config.m:g} rad/s^2" if config.inertia_weight else f"{config.m:g} N m"
    if not gain > 0.0:
        return (
            f"fsw.controller.m: {given} without the factor J is not covered by the proof: the inverse of the inertia is not "
            "diagonally dominant; take inertia_weight: true"
        )
    counts = "" if config.inertia_weight else f", which counts as {gain:.4g} rad/s^2,"
    need = least * config.m / gain
    return (
        f"fsw.controller.m: {given}{counts} is below m_min = {least:.4g} rad/s^2 of beta {config.beta:g}, and "
        f"finite time is not proven; take m >= {need:.4g}, or beta <= {find_largest_beta(gain):.3g}"
    )
