"""Finite-time attitude law on modified Rodrigues parameters: PD with powers below one.

Source: Li & Liu 2011 (Aerospace Control and Application 37(3)), law (14) and theorem 2. Derivation and figures:
docs/finite-time.md.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from bus.errors import ConfigError
from bus.linear import ZERO3, add, cross, subtract, times
from bus.units import Mat3, Vec3
from fsw.controllers.latency import Latency
from fsw.controllers.settings import FiniteTimeConfig
from fsw.controllers.signed_power import sig, sig3, sig_along
from fsw.families import Controller
from fsw.mrp import find_kinematics, find_mrp
from fsw.records import PointingError, WheelHealth
from fsw.vehicle import Vehicle

HALVINGS: Final = 80  # of a bracket that holds the rate at the end of the period: below its last bit, but near zero
QUARTER: Final = 0.25  # G at sigma = 0


class FiniteTimeInternals(NamedTuple):
    """What the law acted on, for telemetry."""

    sigma: Vec3  # of the error, after the torques on their way
    omega_bt_b_rad_s: Vec3  # likewise


class FiniteTime(Controller):
    """From error parameters s and rate error w, with alpha2 = 2 alpha1/(1 + alpha1); the torque before - v is

        A  -k1 sig(s)^alpha1 - k2 sig(w)^alpha2                           eq (14)
        B  -4 k1 G(s)^T sig(s)^alpha1 - k2 sig(w)^alpha2
        C  -k1 |s|^(alpha1 - 1) s - k2 |w|^(alpha2 - 1) w

    For alpha1 < 1 the error is zero after finite time: A near the target (theorem 1), B and C from everywhere. With
    alpha1 = 1, A and C are the PD law of the paper's note 2. With `gyroscopic`, w x J w of the whole rate is added: what
    theorem 2 asks for. The rest of theorem 2, J (R w_t' - w x R w_t), is the flight's feed-forward, which counts the
    target's part R w_t x J R w_t of the gyroscopic torque too; that part is left out here.

    sampling: implicit, form A alone: the torque that is right at the end of the period, from one equation for each axis

        w+ = w - T/J_ii (k1 sig(s + T/4 w+)^alpha1 + k2 sig(w+)^alpha2),   torque J_ii (w+ - w)/T

    so that the steep powers at zero do not make a limit cycle.

    Differences from the paper: forms B and C, the implicit form and the latency are not in it.
    """

    __slots__ = (
        "_alpha1", "_alpha2", "_form", "_gyroscopic", "_implicit", "_inertia", "_k1", "_k2", "_latency", "_omega",
        "_period_s", "_sigma",
    )  # fmt: skip

    def __init__(self, config: FiniteTimeConfig, vehicle: Vehicle, period_s: float) -> None:
        """Raises ConfigError where an implicit form is asked for that there is not."""
        if config.sampling == "implicit" and config.form != "A":
            raise ConfigError(
                f"fsw.controller.sampling: implicit is solved axis by axis, and form {config.form} couples the axes; "
                "take form: A or sampling: explicit"
            )
        self._form = config.form
        self._alpha1, self._alpha2 = config.alpha1, 2.0 * config.alpha1 / (1.0 + config.alpha1)
        self._k1, self._k2 = config.k1, config.k2
        self._implicit = config.sampling == "implicit"
        self._inertia = vehicle.inertia_kgm2
        # With the wheels' momentum in play w x (J w + h) is near w x (total momentum): small. Without, w x J w is all.
        self._gyroscopic = config.gyroscopic and not vehicle.wheel_momentum
        self._latency = Latency(config.latency, vehicle, period_s)
        self._period_s = period_s
        self.reset()

    def reset(self) -> None:
        """Forget the torques on their way."""
        self._latency.reset()
        self._sigma = self._omega = ZERO3

    @property
    def internals(self) -> FiniteTimeInternals:
        """Parameters and rate of the error that the torque is for."""
        return FiniteTimeInternals(self._sigma, self._omega)

    def note_sent(self, tau_b_nm: Vec3) -> None:
        """A torque is on its way [N m]."""
        self._latency.note_sent(tau_b_nm)

    def step(self, dt_s: float, error: PointingError, tau_fault_hat_b_nm: Vec3, health: WheelHealth) -> Vec3:
        """Return the body torque [N m]. dt_s is not used: the law has no memory but the torques on their way.

        tau_fault_hat_b_nm : v, the observer's fault torque, body axes [N m]
        health             : not used, the allocator reckons with it
        """
        error = self._latency.predict(error, tau_fault_hat_b_nm)
        self._sigma = sigma = find_mrp(error.q_tb)
        self._omega = omega = error.omega_bt_b_rad_s
        torque = self._solve(sigma, omega) if self._implicit else self._evaluate(sigma, omega)
        if self._gyroscopic:
            torque = add(torque, find_gyroscopic_torque(self._inertia, error))
        return subtract(torque, tau_fault_hat_b_nm)

    def _evaluate(self, sigma: Vec3, omega: Vec3) -> Vec3:
        """The law at this instant [N m]."""
        k1, k2 = -self._k1, -self._k2
        if self._form == "C":
            ax, ay, az = sig_along(sigma, self._alpha1)
            bx, by, bz = sig_along(omega, self._alpha2)
        else:
            ax, ay, az = sig3(sigma, self._alpha1)
            bx, by, bz = sig3(omega, self._alpha2)
        if self._form == "B":
            (g, h, i), (j, k, l), (m, n, o) = find_kinematics(sigma)
            k1 *= 4.0
            ax, ay, az = g * ax + j * ay + m * az, h * ax + k * ay + n * az, i * ax + l * ay + o * az
        return (k1 * ax + k2 * bx, k1 * ay + k2 * by, k1 * az + k2 * bz)

    def _solve(self, sigma: Vec3, omega: Vec3) -> Vec3:
        """The torque for the end of the period [N m]."""
        (a, _, _), (_, b, _), (_, _, c) = self._inertia
        (sx, sy, sz), (wx, wy, wz) = sigma, omega
        return (
            a * self.find_acceleration(sx, wx, a),
            b * self.find_acceleration(sy, wy, b),
            c * self.find_acceleration(sz, wz, c),
        )

    def find_acceleration(self, sigma: float, omega_rad_s: float, inertia_kgm2: float) -> float:
        """Return (w+ - w)/T of one axis [rad/s^2]: the equation is monotone in w+, which bisection finds.

        From its side, w+ is between w and w less T times the acceleration at w.
        """
        period_s, alpha1, alpha2 = self._period_s, self._alpha1, self._alpha2
        k1, k2 = self._k1 / inertia_kgm2, self._k2 / inertia_kgm2
        quarter = QUARTER * period_s
        now = k1 * sig(sigma + quarter * omega_rad_s, alpha1) + k2 * sig(omega_rad_s, alpha2)
        other = omega_rad_s - period_s * now
        low, high = (other, omega_rad_s) if now > 0.0 else (omega_rad_s, other)
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            if not low < middle < high:
                break
            now = k1 * sig(sigma + quarter * middle, alpha1) + k2 * sig(middle, alpha2)
            if middle - omega_rad_s + period_s * now > 0.0:
                high = middle
            else:
                low = middle
        return (0.5 * (low + high) - omega_rad_s) / period_s


def find_gyroscopic_torque(inertia_kgm2: Mat3, error: PointingError) -> Vec3:
    """Return w x J w - d x J d [N m], w the body's rate and d the target's: what is missing to w x J w in a turning target's
    feed-forward, which has d x J d."""
    d = error.omega_ti_b_rad_s
    w = add(error.omega_bt_b_rad_s, d)
    torque = cross(w, times(inertia_kgm2, w))
    return torque if d == ZERO3 else subtract(torque, cross(d, times(inertia_kgm2, d)))
