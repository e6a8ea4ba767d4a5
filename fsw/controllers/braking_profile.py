"""Attitude law that follows a braking profile, as fast as the wheels that are left allow.

The body turns towards the target at the rate from which it can still be stopped there. What "can" means comes from the
wheel health stage, which learns it in flight; no fault is known beforehand. Derivation and study: docs/braking-profile.md.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from bus.linear import ZERO3, ZERO4, times
from bus.units import Vec3, Vec4
from fsw.controllers.settings import BrakingProfileConfig
from fsw.families import Controller
from fsw.records import PointingError, WheelHealth
from fsw.vehicle import Vehicle

BRAKING_MIN_RAD_S2: Final = 2e-4  # slowest braking planned on: a wheel set judged dead would otherwise never move again
VECTOR_MIN: Final = 1e-9  # |q| below which the eigenaxis has no direction


class BrakingProfileInternals(NamedTuple):
    """What the law holds, for telemetry."""

    s_b_rad_s: Vec3
    profile_rad_s: float  # length of w_d
    braking_rad_s2: float  # deceleration along the eigenaxis planned on, before eta


class BrakingProfile(Controller):
    """s = w - w_d, w_d = -e f(theta); the torque is J (-k_s s + w_d') + w x J w - v.

    e and theta are eigenaxis and angle of the error, f is the profile:

        f   = k_theta theta                                         for theta <= theta_1 = a eta / k_theta^2
        f^2 = 2 a (eta theta_1 / 2 + far x + (eta - far) L (1 - exp(-x/L))),  x = theta - theta_1,  beyond

    so that the deceleration along it is a (far + (eta - far) exp(-x/L)), L = far_rad: gentle far out, where a wheel that
    fails while the body is fast costs a long overshoot, firm close to the target. far passes from eta_far to eta as
    wheels are lost, far = eta_far + (eta - eta_far) min(1, spent sum(1 - e_i)): fewer faults are still to come.

    a = (1 - reserve) a_now + reserve a_worst: the braking accelerations along e of the wheels as they are thought to be
    (shares, and torques that they give whatever they are told: help or hindrance as they lie to the braking direction),
    and after one more loss. With `adapt` off, a is that of braking_share of each wheel and eta_far is not used.

    Bounds, for turns about an axis where the wheels have the acceleration A >= a either way and w x J w has no part:

        from rest at theta_0 to theta_b: at most f(theta_0)/A + the integral of d theta / f, theta_b - A/k_s^2 .. theta_0
        after A has fallen to A' at theta on the profile: past the target by at most the largest
                                                          f(x)^2/(2 A') - x, 0 <= x <= theta, whether health sees it or not

    The first: w reaches the layer |s| < A/k_s in f(theta_0)/A; from there on s falls by exp(-k_s t), which keeps theta
    within A/k_s^2 of the profile's own course, as f rises with theta. The second: the body stays on the profile up to the
    x where that asks for more than A', and has A' from there on.
    """

    __slots__ = ("_a", "_config", "_fixed_nm", "_gyroscopic", "_inertia", "_profile", "_s", "_wheels")

    def __init__(self, config: BrakingProfileConfig, vehicle: Vehicle, period_s: float) -> None:
        self._config = config
        self._inertia = vehicle.inertia_kgm2
        self._wheels = vehicle.wheels
        a, b, c, d = vehicle.wheels.max_torque_nm
        share = config.braking_share
        self._fixed_nm: Vec4 = (share * a, share * b, share * c, share * d)
        # With the wheels' momentum in play w x (J w + h) is near w x (total momentum): small. Without, w x J w is all.
        self._gyroscopic = not vehicle.wheel_momentum
        self.reset()

    def reset(self) -> None:
        """The law has no memory; only the telemetry record is cleared."""
        self._s = ZERO3
        self._profile = 0.0
        self._a = 0.0

    @property
    def internals(self) -> BrakingProfileInternals:
        """Surface, profile rate and deceleration planned on."""
        return BrakingProfileInternals(self._s, self._profile, self._a)

    def step(self, dt_s: float, error: PointingError, tau_fault_hat_b_nm: Vec3, health: WheelHealth) -> Vec3:
        """Return the body torque [N m].

        tau_fault_hat_b_nm : v, what the wheels' shares do not explain of the observer's fault torque [N m]
        """
        q0, qx, qy, qz = error.q_tb
        norm = math.sqrt(qx * qx + qy * qy + qz * qz)
        theta = 2.0 * math.atan2(norm, q0)
        scale = 1.0 / norm if norm > VECTOR_MIN else 0.0
        ex, ey, ez = qx * scale, qy * scale, qz * scale
        rate, slope = self._plan(theta, (ex, ey, ez), health)
        wx, wy, wz = error.omega_bt_b_rad_s
        sx, sy, sz = self._s = (wx + rate * ex, wy + rate * ey, wz + rate * ez)
        # w_d' = -e f'(theta) theta', theta' = w.e; the turning of e itself is left to the feedback.
        along = slope * (wx * ex + wy * ey + wz * ez)
        k = self._config.k_s
        tx, ty, tz = self._turn_into_torque(
            (-k * sx - along * ex, -k * sy - along * ey, -k * sz - along * ez), error.omega_bt_b_rad_s
        )
        vx, vy, vz = tau_fault_hat_b_nm
        return (tx - vx, ty - vy, tz - vz)

    def _plan(self, theta: float, axis: Vec3, health: WheelHealth) -> tuple[float, float]:
        """Return the profile's rate [rad/s] and its slope over the angle [1/s]."""
        config = self._config
        per_accel = times(self._inertia, axis)
        eta = far = config.eta
        if config.adapt:
            la, lb, lc, ld = self._wheels.max_torque_nm
            shares = health.find_shares()
            ea, eb, ec, ed = shares
            given = ZERO3 if health.bias_nm == ZERO4 else self._wheels.combine(health.bias_nm)
            now, worst = self._wheels.find_authority(per_accel, (la * ea, lb * eb, lc * ec, ld * ed), given)
            spent = config.spent * (4.0 - ea - eb - ec - ed)
            far = config.eta_far + (eta - config.eta_far) * (spent if spent < 1.0 else 1.0)
            a = now + config.reserve * (worst - now) if now < math.inf else BRAKING_MIN_RAD_S2
        else:
            a = self._wheels.find_authority(per_accel, self._fixed_nm)[0]
        if not BRAKING_MIN_RAD_S2 <= a < math.inf:
            a = BRAKING_MIN_RAD_S2
        self._a = a
        k = config.k_theta
        linear_to = a * eta / (k * k)
        if theta <= linear_to:
            self._profile = rate = k * theta
            return rate, k
        x = theta - linear_to
        near = (eta - far) * math.exp(-x / config.far_rad)
        energy = 0.5 * eta * linear_to + far * x + (eta - far - near) * config.far_rad
        self._profile = rate = math.sqrt(2.0 * a * energy)
        return rate, a * (far + near) / rate

    def _turn_into_torque(self, accel_b_rad_s2: Vec3, omega_b_rad_s: Vec3) -> Vec3:
        """Return the body torque for an acceleration [N m], the gyroscopic torque counted where it stands alone."""
        tx, ty, tz = times(self._inertia, accel_b_rad_s2)
        if self._gyroscopic:
            wx, wy, wz = omega_b_rad_s
            hx, hy, hz = times(self._inertia, omega_b_rad_s)
            tx += wy * hz - wz * hy
            ty += wz * hx - wx * hz
            tz += wx * hy - wy * hx
        return (tx, ty, tz)
