"""Multiplicative extended Kalman filter: attitude from the star tracker, rate and bias from the gyro.

Lefferts, Markley & Shuster, "Kalman filtering for spacecraft attitude estimation", J. Guidance 5(5), 1982. Written here
with the attitude error in inertial axes: its transition is then the identity, which makes the covariance cheap, and a
correction multiplies the quaternion from the left, which makes a late star-tracker frame as easy as a prompt one.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, NamedTuple

from bus.attitude import conjugate, dcm_from_quaternion, log_map, multiply, normalise
from bus.linear import ZERO3, times
from bus.units import Mat3, Vec3, Vec4
from fsw.estimation.settings import MekfConfig
from fsw.families import Estimator
from fsw.records import Estimate, Sensors
from fsw.rotation import turn
from fsw.vehicle import Vehicle

_ARCSEC: Final = math.pi / 648000.0  # rad per second of arc
_COVARIANCE_PERIOD_S: Final = 0.25  # the covariance is carried forward at least this often
_HISTORY_S: Final = 1.0  # longest star-tracker latency that can be handled
_REJECTIONS_TO_RESTART: Final = 5  # as many frames refused in a row mean that the filter is wrong, not the star tracker
_DEAD_AXIS_RATE_RAD_S: Final = (
    0.05  # what a rate without a gyro may be, 1 sigma: the filter then follows the star tracker
)
_VALID_SIGMA_RAD: Final = 0.02  # attitude known worse than this is not fit for pointing

_Sym3 = tuple[float, float, float, float, float, float]  # xx, xy, xz, yy, yz, zz
_Mat9 = tuple[float, float, float, float, float, float, float, float, float]  # row by row


class MekfInternals(NamedTuple):
    """What the filter thinks of itself, for telemetry and consistency tests."""

    attitude_cov_i_rad2: _Sym3  # attitude error, inertial axes
    cross_cov_rad2_s: _Mat9  # attitude error (rows) with bias error (columns)
    bias_cov_b_rad2_s2: _Sym3  # bias error, body axes
    innovation_nis: float  # last normalised innovation squared, 3 degrees of freedom
    accepted: int
    rejected: int
    restarts: int


class Mekf(Estimator):
    """Attitude, rate and gyro bias with their covariance."""

    def __init__(self, config: MekfConfig, vehicle: Vehicle, tick_s: float) -> None:
        """tick_s: period between calls of `step` [s]. The filter is kinematic: nothing of the vehicle is used."""
        self._tick_s = tick_s
        self._arw2 = config.gyro_arw_rad_sqrt_s**2
        self._rrw2 = config.gyro_rrw_rad_s_sqrt_s**2
        star = config.star_noise_arcsec
        # A star tracker without noise in the settings still has the resolution of its telegram (2^-23).
        floor = 2.0**-22
        self._star_var: Vec3 = (
            max(star[0] * _ARCSEC, floor) ** 2,
            max(star[1] * _ARCSEC, floor) ** 2,
            max(star[2] * _ARCSEC, floor) ** 2,
        )
        self._attitude_var0 = math.radians(config.initial_attitude_sigma_deg) ** 2
        self._bias_var0 = config.initial_bias_sigma_rad_s**2
        self._gate2 = config.gate_sigma**2
        self._covariance_ticks = max(1, round(_COVARIANCE_PERIOD_S / tick_s))
        self._history: deque[tuple[Vec4, Vec4, int]] = deque(maxlen=max(2, round(_HISTORY_S / tick_s) + 1))
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next star-tracker frame starts the filter again."""
        self._started = False
        self._q: Vec4 = (1.0, 0.0, 0.0, 0.0)
        self._bias = ZERO3
        self._total: Vec4 = (1.0, 0.0, 0.0, 0.0)  # product of all corrections, inertial side,
        self._corrections = 0  # and how many they are
        self._rotation: Mat3 = dcm_from_quaternion(self._q)
        self._since = 0  # ticks since the covariance was last carried forward
        self._dead_ticks = 0  # of those, how many with a gyro axis missing
        self._refused_in_a_row = 0
        self._accepted = self._rejected = self._restarts = 0
        self._nis = 0.0
        self._late_noise = 0.0
        self._history.clear()
        self._set_covariance()

    def step(self, sensors: Sensors) -> Estimate:
        """Return attitude, rate [rad/s] and bias [rad/s] at this tick.

        The gyro rate is the mean over the tick that ends now, so its product with the tick is the rotation made.
        An axis without a gyro keeps its last rate and the covariance grows accordingly; the estimate is then marked
        not valid, because its rate on that axis is a memory.
        """
        y, b = sensors.omega_meas_b_rad_s, self._bias
        wx, wy, wz = y[0] - b[0], y[1] - b[1], y[2] - b[2]
        gyro_valid = sensors.gyro_valid[0] and sensors.gyro_valid[1] and sensors.gyro_valid[2]
        if not self._started:
            if sensors.star_new:
                self._start(sensors, (wx, wy, wz))
            return Estimate(self._q, (wx, wy, wz), b, self._started and gyro_valid)
        self._q = turn(self._q, wx * self._tick_s, wy * self._tick_s, wz * self._tick_s)
        self._history.append((self._q, self._total, self._corrections))
        self._since += 1
        if not gyro_valid:
            self._dead_ticks += 1
        if sensors.star_new:
            self._carry_covariance()
            self._correct(sensors, gyro_valid)
            b = self._bias
            wx, wy, wz = y[0] - b[0], y[1] - b[1], y[2] - b[2]
        elif self._since >= self._covariance_ticks:
            self._carry_covariance()
        return Estimate(self._q, (wx, wy, wz), b, gyro_valid and self._fit)

    @property
    def internals(self) -> MekfInternals:
        """Covariance and counters as they stand after the last star-tracker frame."""
        return MekfInternals(self._ptt, self._ptb, self._pbb, self._nis, self._accepted, self._rejected, self._restarts)

    # -- state --------------------------------------------------------------------------------------------------

    def _start(self, sensors: Sensors, omega_b_rad_s: Vec3) -> None:
        late = sensors.star_age_s
        wx, wy, wz = omega_b_rad_s
        self._q = turn(normalise(sensors.q_ib_meas), wx * late, wy * late, wz * late)
        self._rotation = dcm_from_quaternion(self._q)
        self._history.clear()
        self._history.append((self._q, self._total, self._corrections))
        self._since = self._dead_ticks = self._refused_in_a_row = 0
        self._started = True
        self._set_covariance()

    def _set_covariance(self) -> None:
        a, c = self._attitude_var0, self._bias_var0
        self._ptt: _Sym3 = (a, 0.0, 0.0, a, 0.0, a)
        self._ptb: _Mat9 = (0.0,) * 9
        self._pbb: _Sym3 = (c, 0.0, 0.0, c, 0.0, c)
        self._fit = True

    def _carry_covariance(self) -> None:
        """Covariance forward over the ticks since the last time: d(theta_i) = -R(q_ib) (d(bias) + noise)."""
        if self._since == 0:
            return
        duration = self._since * self._tick_s
        self._q = normalise(self._q)
        now = dcm_from_quaternion(self._q)
        self._shift_covariance(self._rotation, now, -0.5 * duration)
        self._rotation = now
        dead = self._dead_ticks * self._tick_s * _DEAD_AXIS_RATE_RAD_S
        grown = self._arw2 * duration + self._rrw2 * duration**3 / 3.0 + dead * dead
        p, c = self._ptt, self._pbb
        self._ptt = (p[0] + grown, p[1], p[2], p[3] + grown, p[4], p[5] + grown)
        walk = self._rrw2 * duration
        self._pbb = (c[0] + walk, c[1], c[2], c[3] + walk, c[4], c[5] + walk)
        self._since = self._dead_ticks = 0
        self._fit = max(self._ptt[0], self._ptt[3], self._ptt[5]) < _VALID_SIGMA_RAD**2

    def _shift_covariance(self, first: Mat3, last: Mat3, scale: float) -> None:
        """theta += B bias with B = scale (first + last): Ptb += B Pbb, Ptt += B Ptb' + Ptb B' + B Pbb B'."""
        (f00, f01, f02), (f10, f11, f12), (f20, f21, f22) = first
        (l00, l01, l02), (l10, l11, l12), (l20, l21, l22) = last
        b00, b01, b02 = scale * (f00 + l00), scale * (f01 + l01), scale * (f02 + l02)
        b10, b11, b12 = scale * (f10 + l10), scale * (f11 + l11), scale * (f12 + l12)
        b20, b21, b22 = scale * (f20 + l20), scale * (f21 + l21), scale * (f22 + l22)
        cxx, cxy, cxz, cyy, cyz, czz = self._pbb
        t00, t01, t02, t10, t11, t12, t20, t21, t22 = self._ptb
        n00 = t00 + b00 * cxx + b01 * cxy + b02 * cxz
        n01 = t01 + b00 * cxy + b01 * cyy + b02 * cyz
        n02 = t02 + b00 * cxz + b01 * cyz + b02 * czz
        n10 = t10 + b10 * cxx + b11 * cxy + b12 * cxz
        n11 = t11 + b10 * cxy + b11 * cyy + b12 * cyz
        n12 = t12 + b10 * cxz + b11 * cyz + b12 * czz
        n20 = t20 + b20 * cxx + b21 * cxy + b22 * cxz
        n21 = t21 + b20 * cxy + b21 * cyy + b22 * cyz
        n22 = t22 + b20 * cxz + b21 * cyz + b22 * czz
        pxx, pxy, pxz, pyy, pyz, pzz = self._ptt
        # Ptb B' + B Ptb' + B Pbb B' = Ptb B' + B Ptb'(new), the new cross term holding B Pbb already.
        self._ptt = (
            pxx + (t00 + n00) * b00 + (t01 + n01) * b01 + (t02 + n02) * b02,
            pxy + t00 * b10 + t01 * b11 + t02 * b12 + b00 * n10 + b01 * n11 + b02 * n12,
            pxz + t00 * b20 + t01 * b21 + t02 * b22 + b00 * n20 + b01 * n21 + b02 * n22,
            pyy + (t10 + n10) * b10 + (t11 + n11) * b11 + (t12 + n12) * b12,
            pyz + t10 * b20 + t11 * b21 + t12 * b22 + b10 * n20 + b11 * n21 + b12 * n22,
            pzz + (t20 + n20) * b20 + (t21 + n21) * b21 + (t22 + n22) * b22,
        )
        self._ptb = (n00, n01, n02, n10, n11, n12, n20, n21, n22)

    # -- star tracker ------------------------------------------------------------------------------------------

    def _correct(self, sensors: Sensors, gyro_valid: bool) -> None:
        """Use one star-tracker frame, however late: compare it with the attitude of the tick it was taken at."""
        late_s = sensors.star_age_s
        ticks = round(late_s / self._tick_s)
        if ticks >= len(self._history):
            return  # taken before the filter started, or longer ago than it remembers
        then, total_then, corrections = self._history[-1 - ticks]
        if corrections != self._corrections:
            then = multiply(multiply(self._total, conjugate(total_then)), then)
        nu = log_map(multiply(normalise(sensors.q_ib_meas), conjugate(then)))
        rotation = self._rotation
        if ticks:
            self._step_back(late_s)
        inverse = _inverse(self._innovation_covariance())
        self._nis = _quadratic(inverse, nu)
        if self._nis > self._gate2:
            self._rejected += 1
            self._refused_in_a_row += 1
            if ticks:
                self._step_forward(late_s)
            if self._refused_in_a_row >= _REJECTIONS_TO_RESTART:
                self._restart_attitude(sensors)
            return
        self._accepted += 1
        self._refused_in_a_row = 0
        theta, bias = self._update_covariance(inverse, nu, gyro_valid)
        if ticks:
            self._step_forward(late_s)
            turned = times(rotation, bias)
            theta = (theta[0] - late_s * turned[0], theta[1] - late_s * turned[1], theta[2] - late_s * turned[2])
        self._apply(theta, bias)

    def _step_back(self, late_s: float) -> None:
        """Covariance as it was `late_s` ago: without the gyro noise of that time, which no frame has yet seen."""
        self._shift_covariance(self._rotation, self._rotation, 0.5 * late_s)
        p = self._ptt
        self._late_noise = min(self._arw2 * late_s, 0.5 * min(p[0], p[3], p[5]))
        n = self._late_noise
        self._ptt = (p[0] - n, p[1], p[2], p[3] - n, p[4], p[5] - n)

    def _step_forward(self, late_s: float) -> None:
        n, p = self._late_noise, self._ptt
        self._ptt = (p[0] + n, p[1], p[2], p[3] + n, p[4], p[5] + n)
        self._shift_covariance(self._rotation, self._rotation, -0.5 * late_s)

    def _innovation_covariance(self) -> _Sym3:
        """Ptt + R(q_ib) diag(star) R', inertial axes."""
        vx, vy, vz = self._star_var
        (a, b, c), (d, e, f), (g, h, i) = self._rotation
        p = self._ptt
        return (
            p[0] + a * a * vx + b * b * vy + c * c * vz,
            p[1] + a * d * vx + b * e * vy + c * f * vz,
            p[2] + a * g * vx + b * h * vy + c * i * vz,
            p[3] + d * d * vx + e * e * vy + f * f * vz,
            p[4] + d * g * vx + e * h * vy + f * i * vz,
            p[5] + g * g * vx + h * h * vy + i * i * vz,
        )

    def _update_covariance(self, inverse: _Sym3, nu: Vec3, gyro_valid: bool) -> tuple[Vec3, Vec3]:
        """P -= K H P; return the corrections K nu of attitude (inertial axes) and bias (body axes)."""
        nx, ny, nz = nu
        k00, k01, k02, k10, k11, k12, k20, k21, k22 = _times_symmetric_rows(self._ptt, inverse)
        t00, t01, t02, t10, t11, t12, t20, t21, t22 = self._ptb
        pxx, pxy, pxz, pyy, pyz, pzz = self._ptt
        theta = (k00 * nx + k01 * ny + k02 * nz, k10 * nx + k11 * ny + k12 * nz, k20 * nx + k21 * ny + k22 * nz)
        # Bias gain = Ptb' S^-1, row j from column j of Ptb.
        gx = _symmetric_times(inverse, t00, t10, t20)
        gy = _symmetric_times(inverse, t01, t11, t21)
        gz = _symmetric_times(inverse, t02, t12, t22)
        bias = ZERO3
        if gyro_valid:
            bias = (
                gx[0] * nx + gx[1] * ny + gx[2] * nz,
                gy[0] * nx + gy[1] * ny + gy[2] * nz,
                gz[0] * nx + gz[1] * ny + gz[2] * nz,
            )
            cxx, cxy, cxz, cyy, cyz, czz = self._pbb
            self._pbb = (
                cxx - gx[0] * t00 - gx[1] * t10 - gx[2] * t20,
                cxy - gx[0] * t01 - gx[1] * t11 - gx[2] * t21,
                cxz - gx[0] * t02 - gx[1] * t12 - gx[2] * t22,
                cyy - gy[0] * t01 - gy[1] * t11 - gy[2] * t21,
                cyz - gy[0] * t02 - gy[1] * t12 - gy[2] * t22,
                czz - gz[0] * t02 - gz[1] * t12 - gz[2] * t22,
            )
        self._ptt = (
            pxx - k00 * pxx - k01 * pxy - k02 * pxz,
            pxy - k00 * pxy - k01 * pyy - k02 * pyz,
            pxz - k00 * pxz - k01 * pyz - k02 * pzz,
            pyy - k10 * pxy - k11 * pyy - k12 * pyz,
            pyz - k10 * pxz - k11 * pyz - k12 * pzz,
            pzz - k20 * pxz - k21 * pyz - k22 * pzz,
        )
        self._ptb = (
            t00 - k00 * t00 - k01 * t10 - k02 * t20,
            t01 - k00 * t01 - k01 * t11 - k02 * t21,
            t02 - k00 * t02 - k01 * t12 - k02 * t22,
            t10 - k10 * t00 - k11 * t10 - k12 * t20,
            t11 - k10 * t01 - k11 * t11 - k12 * t21,
            t12 - k10 * t02 - k11 * t12 - k12 * t22,
            t20 - k20 * t00 - k21 * t10 - k22 * t20,
            t21 - k20 * t01 - k21 * t11 - k22 * t21,
            t22 - k20 * t02 - k21 * t12 - k22 * t22,
        )
        return theta, bias

    def _apply(self, theta_i_rad: Vec3, bias_b_rad_s: Vec3) -> None:
        correction = turn((1.0, 0.0, 0.0, 0.0), *theta_i_rad)
        self._q = normalise(multiply(correction, self._q))
        self._total = normalise(multiply(correction, self._total))
        self._corrections += 1
        b = self._bias
        self._bias = (b[0] + bias_b_rad_s[0], b[1] + bias_b_rad_s[1], b[2] + bias_b_rad_s[2])
        self._rotation = dcm_from_quaternion(self._q)
        self._history[-1] = (self._q, self._total, self._corrections)
        self._fit = max(self._ptt[0], self._ptt[3], self._ptt[5]) < _VALID_SIGMA_RAD**2

    def _restart_attitude(self, sensors: Sensors) -> None:
        """Take the star tracker at its word again: its frames agree with one another and not with the filter."""
        self._restarts += 1
        y, b = sensors.omega_meas_b_rad_s, self._bias
        self._start(sensors, (y[0] - b[0], y[1] - b[1], y[2] - b[2]))


# -- symmetric 3 x 3 matrices (xx, xy, xz, yy, yz, zz) -----------------------------------------------------------------


def _inverse(s: _Sym3) -> _Sym3:
    xx, xy, xz, yy, yz, zz = s
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    k = 1.0 / (xx * a + xy * b + xz * c)
    return (a * k, b * k, c * k, (xx * zz - xz * xz) * k, (xy * xz - xx * yz) * k, (xx * yy - xy * xy) * k)


def _symmetric_times(s: _Sym3, x: float, y: float, z: float) -> Vec3:
    return (s[0] * x + s[1] * y + s[2] * z, s[1] * x + s[3] * y + s[4] * z, s[2] * x + s[4] * y + s[5] * z)


def _times_symmetric_rows(p: _Sym3, s: _Sym3) -> _Mat9:
    """P S for two symmetric matrices, row by row."""
    return (
        *_symmetric_times(s, p[0], p[1], p[2]),
        *_symmetric_times(s, p[1], p[3], p[4]),
        *_symmetric_times(s, p[2], p[4], p[5]),
    )


def _quadratic(s: _Sym3, v: Vec3) -> float:
    x, y, z = _symmetric_times(s, *v)
    return x * v[0] + y * v[1] + z * v[2]
