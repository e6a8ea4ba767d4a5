"""Plausibility of gyro samples: a body that heavy, with wheels that weak, cannot have turned like that."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

from bus.units import Vec3
from fsw.vehicle import Vehicle

_MEAN_S: Final = 0.25  # means over the first are compared at the distance of the second
_SLOPE_S: Final = 1.0
_QUIET_START_S: Final = 2.0
_SIGMAS: Final = 7.0


def bound_acceleration(vehicle: Vehicle) -> float:
    """Return the largest angular acceleration about any body axis that the wheels can cause [rad/s^2]."""
    return max(vehicle.wheels.find_largest(row) for row in vehicle.inverse_inertia)


class Plausibility:
    """Marks an axis suspect at the very tick at which its rate jumps, or within a second when it ramps."""

    def __init__(
        self, tick_s: float, acceleration_rad_s2: float, arw_rad_sqrt_s: float, lsb_rad: float, suspect_s: float
    ) -> None:
        """acceleration_rad_s2: what the body can physically do; tick_s: period between samples [s]."""
        variance = arw_rad_sqrt_s**2 / tick_s + lsb_rad**2 / (6.0 * tick_s**2)
        self._mean_ticks = max(1, round(_MEAN_S / tick_s))
        self._slope_ticks = max(self._mean_ticks, round(_SLOPE_S / tick_s))
        self._jump = acceleration_rad_s2 * tick_s + _SIGMAS * math.sqrt(2.0 * variance)
        slope = acceleration_rad_s2 * self._slope_ticks * tick_s
        self._slope = slope + _SIGMAS * math.sqrt(2.0 * variance / self._mean_ticks)
        self._quiet = round(_QUIET_START_S / tick_s)
        self._hold = max(1, round(suspect_s / tick_s))
        self._samples: deque[Vec3] = deque(maxlen=self._mean_ticks)
        self._means: deque[Vec3] = deque(maxlen=self._slope_ticks + 1)
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        self._samples.clear()
        self._means.clear()
        self._seen = 0
        self._left = [0, 0, 0]

    def step(self, rate_b_rad_s: Vec3) -> tuple[bool, bool, bool]:
        """Return for each axis whether it is suspect at this tick, given its gyro sample [rad/s]."""
        samples, means = self._samples, self._means
        last = samples[-1] if samples else rate_b_rad_s
        samples.append(rate_b_rad_s)
        n = len(samples)
        sx = sy = sz = 0.0
        for x, y, z in samples:
            sx += x
            sy += y
            sz += z
        mean = (sx / n, sy / n, sz / n)
        means.append(mean)
        old = means[0] if len(means) > self._slope_ticks else mean
        self._seen += 1
        left = self._left
        if self._seen > self._quiet:
            for axis in (0, 1, 2):
                jumped = abs(rate_b_rad_s[axis] - last[axis]) > self._jump
                if jumped or abs(mean[axis] - old[axis]) > self._slope:
                    left[axis] = self._hold + 1
        for axis in (0, 1, 2):
            if left[axis]:
                left[axis] -= 1
        return (left[0] > 0, left[1] > 0, left[2] > 0)
