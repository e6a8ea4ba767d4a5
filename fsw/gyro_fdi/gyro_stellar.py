"""Attitude and gyro bias while the gyro is healthy: gyro integrated, pulled slowly to the star tracker.

Fixed gains of a 0.02 rad/s complementary filter. Slow on purpose: a filter that follows the star tracker quickly would
learn a gyro fault as bias before it is found.
"""

from __future__ import annotations

from typing import Final

from bus.attitude import conjugate, log_map, multiply, normalise
from bus.linear import ZERO3
from bus.units import Vec3, Vec4
from fsw.rotation import turn

_ATTITUDE_RATE: Final = 0.08  # [1/s]: 0.02 per frame at 4 Hz
_BIAS_RATE: Final = 4e-4  # [1/s^2]: 1e-4 per frame at 4 Hz
_MAX_FRAME_AGE_S: Final = 1.0  # gains do not grow beyond frames this far apart


class GyroStellarFilter:
    """Attitude and bias, body axes."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget attitude and bias."""
        self.q_ib: Vec4 = (1.0, 0.0, 0.0, 0.0)
        self.bias_b_rad_s = ZERO3

    def propagate(self, angle_b_rad: Vec3) -> None:
        """Turn by the rotation that the gyro measured over the tick, bias taken off, body axes [rad]."""
        self.q_ib = turn(self.q_ib, *angle_b_rad)

    def correct(self, q_ib_meas: Vec4, since_last_s: float) -> None:
        """Use a star-tracker attitude of this tick, `since_last_s` after the one before."""
        age = min(since_last_s, _MAX_FRAME_AGE_S)
        x, y, z = log_map(multiply(conjugate(self.q_ib), q_ib_meas))
        k_q, k_b = _ATTITUDE_RATE * age, _BIAS_RATE * age
        self.q_ib = normalise(turn(self.q_ib, k_q * x, k_q * y, k_q * z))
        b = self.bias_b_rad_s
        self.bias_b_rad_s = (b[0] - k_b * x, b[1] - k_b * y, b[2] - k_b * z)
