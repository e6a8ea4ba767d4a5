"""Attitude straight from the star tracker, carried forward with the gyro rate: for ideal sensors, no filtering."""

from __future__ import annotations

from bus.units import Vec3, Vec4
from fsw.config import DirectConfig, ModelConfig
from fsw.estimation.rotation import turn
from fsw.records import Estimate, Sensors

ZERO: Vec3 = (0.0, 0.0, 0.0)
IDENTITY: Vec4 = (1.0, 0.0, 0.0, 0.0)


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
        x, y, z = omega
        if star_new:
            self._known = True
            self._q = turn(q_ib_meas, x * age_s, y * age_s, z * age_s) if age_s > 0.0 else q_ib_meas
        elif self._known:
            dt_s = t_s - self._t_s
            self._q = turn(self._q, x * dt_s, y * dt_s, z * dt_s)
        self._t_s = t_s
        valid = self._known and star_valid and valid_x and valid_y and valid_z
        return tuple.__new__(Estimate, (self._q, omega, ZERO, valid))
