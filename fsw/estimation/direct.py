"""Attitude straight from the star tracker, carried forward with the gyro rate: for ideal sensors, no filtering."""

from __future__ import annotations

import math

from bus.units import Vec3, Vec4
from fsw.config import DirectConfig, ModelConfig
from fsw.interfaces import Estimate, Sensors

ZERO: Vec3 = (0.0, 0.0, 0.0)
IDENTITY: Vec4 = (1.0, 0.0, 0.0, 0.0)


def turn_attitude(q_ib: Vec4, omega_bi_b_rad_s: Vec3, dt_s: float) -> Vec4:
    """Return q_ib after dt_s of constant body rate: q_ib * exp(omega dt / 2), scalar first.

    Its length is that of q_ib but for rounding, 1e-16 a call; the next star-tracker attitude ends that.
    """
    rx, ry, rz = omega_bi_b_rad_s
    half_s = 0.5 * dt_s
    rx *= half_s
    ry *= half_s
    rz *= half_s
    square = rx * rx + ry * ry + rz * rz  # of half the angle
    if square < 1e-5:  # 0.3 rad/s for 20 ms; what the series leave out is below the last bit
        r0 = 1.0 - square * (0.5 - square * (1.0 / 24.0))
        ratio = 1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0))
    else:
        half_angle = math.sqrt(square)
        r0 = math.cos(half_angle)
        ratio = math.sin(half_angle) / half_angle
    rx *= ratio
    ry *= ratio
    rz *= ratio
    q0, qx, qy, qz = q_ib
    return (
        q0 * r0 - qx * rx - qy * ry - qz * rz,
        q0 * rx + qx * r0 + qy * rz - qz * ry,
        q0 * ry + qy * r0 + qz * rx - qx * rz,
        q0 * rz + qz * r0 + qx * ry - qy * rx,
    )


class Direct:
    """Estimator without a filter.

    On a tick with a new star-tracker attitude the estimate is that attitude, carried over its age with the present
    gyro rate; of age zero it is the measurement, digit for digit. On other ticks the last estimate is carried over the
    tick with the gyro rate, which is the mean over it. No gyro bias is estimated.
    """

    __slots__ = ("_known", "_q", "_t_s")

    def __init__(self, config: DirectConfig, model: ModelConfig) -> None:
        """`config` and `model` carry nothing that this estimator needs."""
        self.reset()

    def reset(self) -> None:
        """Forget the attitude; not valid again before the next star-tracker attitude."""
        self._known = False
        self._q = IDENTITY
        self._t_s = 0.0

    def step(self, sensors: Sensors) -> Estimate:
        """Return attitude and rate [rad/s]; valid once an attitude was seen, while star tracker and gyro are good."""
        _, t_s, omega, (valid_x, valid_y, valid_z), q_ib_meas, star_new, star_valid, age_s, _, _, _ = sensors
        if star_new:
            self._known = True
            self._q = turn_attitude(q_ib_meas, omega, age_s) if age_s > 0.0 else q_ib_meas
        elif self._known:
            self._q = turn_attitude(self._q, omega, t_s - self._t_s)
        self._t_s = t_s
        valid = self._known and star_valid and valid_x and valid_y and valid_z
        return tuple.__new__(Estimate, (self._q, omega, ZERO, valid))
