"""Gyro faults without a star tracker: the torque observer's residual against what wheels and model can be wrong by."""

from __future__ import annotations

import math
from typing import Final

from bus.linear import ZERO3
from bus.units import Mat3, Vec3, Vec4

_MISALIGNMENT: Final = 0.174  # sin 10 deg: how far a wheel's axis may be off
_INERTIA_ERROR: Final = 0.03
_CONFIRM_CYCLES: Final = 4
_LEARNT_MARGIN: Final = 1.5  # the bound stays this factor above the worst model error that the star tracker showed ...
_LEARNT_FOR_S: Final = 60.0  # ... and comes down over this time


class ModelErrorBound:
    """Adaptive threshold of the observer residual [rad/s] for wheels 10 deg off and inertia wrong by 3 %."""

    def __init__(self, inertia_kgm2: Mat3, cycle_s: float, memory_rad_s: float, floor_rad_s: float) -> None:
        """memory_rad_s: the observer forgets at this rate; floor_rad_s: threshold at rest."""
        self._diagonal = (inertia_kgm2[0][0], inertia_kgm2[1][1], inertia_kgm2[2][2])
        self._memory_s = 1.0 / memory_rad_s
        self._gain = min(1.0, cycle_s * memory_rad_s)
        self._floor = floor_rad_s
        self._fade = 1.0 - min(1.0, cycle_s / _LEARNT_FOR_S)
        self.reset()

    def reset(self) -> None:
        """Forget wheels, rate and counts."""
        self._h: Vec4 | None = None
        self._w: Vec3 = ZERO3
        self._counts = [0, 0, 0]
        self._scale = [1.0, 1.0, 1.0]

    def bound(self, h_rw_nms: Vec4, omega_b_rad_s: Vec3) -> Vec3:
        """Return the threshold of each axis [rad/s] for this cycle's wheel momenta [N m s] and rate [rad/s]."""
        if self._h is None:
            self._h, self._w = h_rw_nms, omega_b_rad_s
        g, slow, h, w = self._gain, self._h, h_rw_nms, omega_b_rad_s
        a = slow[0] + g * (h[0] - slow[0])
        b = slow[1] + g * (h[1] - slow[1])
        c = slow[2] + g * (h[2] - slow[2])
        d = slow[3] + g * (h[3] - slow[3])
        self._h = (a, b, c, d)
        u = self._w
        u = self._w = (u[0] + g * (w[0] - u[0]), u[1] + g * (w[1] - u[1]), u[2] + g * (w[2] - u[2]))
        moved = abs(h[0] - a) + abs(h[1] - b) + abs(h[2] - c) + abs(h[3] - d)
        stored = abs(h[0]) + abs(h[1]) + abs(h[2]) + abs(h[3])
        speed = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
        wheels = _MISALIGNMENT * (moved + stored * speed * self._memory_s)
        slewed = math.sqrt((w[0] - u[0]) ** 2 + (w[1] - u[1]) ** 2 + (w[2] - u[2]) ** 2)
        rest = self._floor + _INERTIA_ERROR * slewed
        j = self._diagonal
        return (rest + wheels / j[0], rest + wheels / j[1], rest + wheels / j[2])

    def count(self, residual_b_rad_s: Vec3, bound_b_rad_s: Vec3) -> tuple[bool, bool, bool]:
        """Return for each axis whether its residual has been beyond the bound for four cycles running."""
        counts, scale = self._counts, self._scale
        for axis in (0, 1, 2):
            beyond = abs(residual_b_rad_s[axis]) > scale[axis] * bound_b_rad_s[axis]
            counts[axis] = counts[axis] + 1 if beyond else 0
        return (counts[0] >= _CONFIRM_CYCLES, counts[1] >= _CONFIRM_CYCLES, counts[2] >= _CONFIRM_CYCLES)

    def learn(self, model_error_b_rad_s: Vec3, bound_b_rad_s: Vec3) -> None:
        """While the star tracker has the say: widen the bound to what the model is seen to be wrong by.

        model_error_b_rad_s : gyro-less rate less the torque observer's; no gyro in it, so no gyro fault widens it
        """
        fade, scale = self._fade, self._scale
        for axis in (0, 1, 2):
            seen = _LEARNT_MARGIN * abs(model_error_b_rad_s[axis]) / bound_b_rad_s[axis]
            scale[axis] = max(1.0 + fade * (scale[axis] - 1.0), seen)
        self._counts = [0, 0, 0]
