"""Attitude straight from the star tracker, carried forward with the gyro rate: for ideal sensors, no filtering."""

from __future__ import annotations

from bus.attitude import IDENTITY
from bus.linear import ZERO3
from fsw.estimation.settings import DirectConfig
from fsw.families import Estimator
from fsw.records import Estimate, Sensors
from fsw.rotation import turn
from fsw.vehicle import Vehicle


class Direct(Estimator):
    """Estimator without a filter.

    On a tick with a new star-tracker attitude the estimate is that attitude, carried over its age with the present
    gyro rate; of age zero it is the measurement, digit for digit. On other ticks the last estimate is carried over the
    tick with the gyro rate, which is the mean over it. No gyro bias is estimated.
    """

    __slots__ = ("_known", "_q", "_t_s")

    def __init__(self, config: DirectConfig, vehicle: Vehicle, period_s: float) -> None:
        """Nothing of these is needed: it reads the time from the sensors."""
        self.reset()

    def reset(self) -> None:
        """Forget the attitude; not valid again before the next star-tracker attitude."""
        self._known = False
        self._q = IDENTITY
        self._t_s = 0.0

    def step(self, sensors: Sensors) -> Estimate:
        """Return attitude and rate [rad/s]; valid once an attitude was seen, while star tracker and gyro are good."""
        omega = sensors.omega_meas_b_rad_s
        x, y, z = omega
        if sensors.star_new:
            self._known = True
            age_s = sensors.star_age_s
            self._q = turn(sensors.q_ib_meas, x * age_s, y * age_s, z * age_s) if age_s > 0.0 else sensors.q_ib_meas
        elif self._known:
            dt_s = sensors.t_s - self._t_s
            self._q = turn(self._q, x * dt_s, y * dt_s, z * dt_s)
        self._t_s = sensors.t_s
        valid = self._known and sensors.star_valid and False not in sensors.gyro_valid
        return Estimate(self._q, omega, ZERO3, valid)
