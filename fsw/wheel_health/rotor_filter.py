"""What took a rotor's torque: its motor's gain or its bearing's friction."""

from __future__ import annotations

import math
from typing import Final

from fsw.wheel_health.deficit_filter import DRY_RAD_S

# Variances that a second adds: of speed [rad^2/s^2], gain and friction [N^2 m^2].
SPEED_WALK: Final = 4.5e-5
GAIN_WALK: Final = 1e-5
FRICTION_WALK: Final = 1e-9
FIRST_SPEED: Final = 0.0025  # variances to begin with
FIRST_GAIN: Final = 0.01
FIRST_FRICTION: Final = 1e-6
AFTER_GAIN: Final = 0.09  # once there is an alarm: what was learnt of a sound wheel says nothing of a faulty one
AFTER_FRICTION: Final = 9e-6
GAIN_LIMIT: Final = 1.5
FAST_RAD_S: Final = (
    4.0  # from here on tanh(w / 0.1) is 1 to the last bit, also after a step that changes w by less than
)
NEAR_RAD_S: Final = 2.0
FRICTION_LIMIT_NM: Final = 0.05


class RotorFilter:
    """Extended Kalman filter of x = [w, C_t, f]: J dw/dt = C_t k_t I - (c + f) tanh(w / 0.1) - v w; w is measured.

    Rederived, see docs/wheel-health.md. Four Euler steps for w; C_t and f walk slowly. At constant current and speed only
    their sum can be known.
    """

    __slots__ = (
        "_coulomb_nm",
        "_inertia_kgm2",
        "_noise",
        "_p00",
        "_p01",
        "_p02",
        "_p12",
        "_viscous_nm_s",
        "friction_nm",
        "friction_variance",
        "gain",
        "gain_variance",
        "speed_rad_s",
    )

    def __init__(self, inertia_kgm2: float, coulomb_nm: float, viscous_nm_s: float, noise_rad_s: float) -> None:
        self._inertia_kgm2 = inertia_kgm2
        self._coulomb_nm = coulomb_nm
        self._viscous_nm_s = viscous_nm_s
        self._noise = noise_rad_s * noise_rad_s
        self.restart(0.0)

    def restart(self, speed_rad_s: float) -> None:
        """Start from a speed, with a sound wheel."""
        self.gain, self.friction_nm = 1.0, 0.0
        self._open(speed_rad_s, FIRST_GAIN, FIRST_FRICTION)

    def doubt(self) -> None:
        """Forget how sure gain and friction were, not what they are: from here on the data alone tell them apart."""
        self._open(self.speed_rad_s, AFTER_GAIN, AFTER_FRICTION)

    def anchor(self, speed_rad_s: float) -> None:
        """Take a speed as it is measured, after a time in which there was none; gain and friction stay."""
        self.speed_rad_s = speed_rad_s
        self._p00, self._p01, self._p02 = FIRST_SPEED, 0.0, 0.0

    def _open(self, speed_rad_s: float, gain_variance: float, friction_variance: float) -> None:
        self.anchor(speed_rad_s)
        self._p12 = 0.0
        self.gain_variance, self.friction_variance = gain_variance, friction_variance

    def step(self, dt_s: float, torque_nm: float, measured_rad_s: float, heard: bool) -> None:
        """Advance over dt_s with a mean torque, k_t I of a sound motor [N m]; without a measurement it predicts."""
        w, gain, f = self.speed_rad_s, self.gain, self.friction_nm
        t = dt_s / self._inertia_kgm2
        h = 0.25 * t
        dry, viscous, push = self._coulomb_nm + f, self._viscous_nm_s, gain * torque_nm
        y = 1.0 if w > 0.0 else -1.0
        left = t * (abs(push) + dry)
        if w * y > FAST_RAD_S and -NEAR_RAD_S < left < NEAR_RAD_S:  # dry friction is what it is throughout
            keep, more = 1.0 - h * viscous, h * (push - dry * y)
            c = -t * y
            w = keep * (keep * (keep * (keep * w + more) + more) + more) + more
            a = keep * keep
            a *= a
        else:
            slope, tanh = dry / DRY_RAD_S, math.tanh
            y = tanh(w / DRY_RAD_S)
            c = -t * y
            a = 1.0 - h * (slope * (1.0 - y * y) + viscous)
            w += h * (push - dry * y - viscous * w)
            for _ in (1, 2, 3):
                y = tanh(w / DRY_RAD_S)
                a *= 1.0 - h * (slope * (1.0 - y * y) + viscous)
                w += h * (push - dry * y - viscous * w)
        b = t * torque_nm
        p01, p02, p11, p12, p22 = self._p01, self._p02, self.gain_variance, self._p12, self.friction_variance
        r0, r1, r2 = a * self._p00 + b * p01 + c * p02, a * p01 + b * p11 + c * p12, a * p02 + b * p12 + c * p22
        p00 = a * r0 + b * r1 + c * r2 + SPEED_WALK * dt_s
        p11 += GAIN_WALK * dt_s
        p22 += FRICTION_WALK * dt_s
        if heard:
            k = 1.0 / (p00 + self._noise)
            innovation = k * (measured_rad_s - w)
            w += p00 * innovation
            gain += r1 * innovation
            f += r2 * innovation
            gain = 0.0 if gain < 0.0 else GAIN_LIMIT if gain > GAIN_LIMIT else gain
            f = -FRICTION_LIMIT_NM if f < -FRICTION_LIMIT_NM else FRICTION_LIMIT_NM if f > FRICTION_LIMIT_NM else f
            p11 -= k * r1 * r1
            p12 -= k * r1 * r2
            p22 -= k * r2 * r2
            left = 1.0 - k * p00
            p00, r1, r2 = left * p00, left * r1, left * r2
        self.speed_rad_s, self.gain, self.friction_nm = w, gain, f
        self._p00, self._p01, self._p02, self._p12 = p00, r1, r2, p12
        self.gain_variance, self.friction_variance = p11, p22

    def weigh_gain(self) -> float:
        """Return the log of the odds that gain alone explains what was seen, against friction alone."""
        off = self.gain - 1.0
        return 0.5 * (off * off / self.gain_variance - self.friction_nm * self.friction_nm / self.friction_variance)
