"""Integral of the pointing error that stops while the wheels cannot follow."""

from __future__ import annotations

from bus.linear import ZERO3
from bus.units import Vec3, Vec4
from fsw.records import ALL_WHEELS, WheelHealth
from fsw.vehicle import Vehicle

FULL: Vec4 = (1.0, 1.0, 1.0, 1.0)
AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class ErrorIntegral:
    """z' = -sigma per axis, while |u| is below what the wheels can give about that axis or u pushes away from the target.

    What they can give about an axis alone comes from their axes and limits, times what `health` says that they deliver: a
    wheel judged weak or lost makes the limit smaller. There is no zone outside of which nothing is integrated ("only when
    the error is small"): after a wheel's gain fell in hold, the error would stand outside of it for ever.
    """

    __slots__ = ("_available", "_effectiveness", "_fixed", "_limit_nm", "_wheels", "z_b_rad_s")

    def __init__(self, limit_nm: float | None, vehicle: Vehicle) -> None:
        """limit_nm: for each axis, whatever the wheels; None: what they can give."""
        self._wheels = vehicle.wheels
        self._fixed = limit_nm is not None
        self._limit_nm: Vec3 = ZERO3 if limit_nm is None else (limit_nm, limit_nm, limit_nm)
        self.reset()

    def reset(self) -> None:
        """Back to zero."""
        self.z_b_rad_s: Vec3 = ZERO3
        self._effectiveness, self._available = FULL, ALL_WHEELS
        if not self._fixed:
            self._limit_nm = self._find_limits(FULL)

    def find_limit(self, health: WheelHealth) -> Vec3:
        """Return the torque that can be had about each body axis alone [N m]."""
        if not self._fixed and (
            health.effectiveness != self._effectiveness or health.available != self._available
        ):  # most cycles: no
            self._effectiveness, self._available = health.effectiveness, health.available
            (a, b, c, d), (p, q, r, s) = health.effectiveness, health.available
            self._limit_nm = self._find_limits((a if p else 0.0, b if q else 0.0, c if r else 0.0, d if s else 0.0))
        return self._limit_nm

    def step(self, dt_s: float, sigma_b_rad: Vec3, torque_b_nm: Vec3, health: WheelHealth) -> None:
        """Advance by dt_s with the torque that was just asked for, body axes [N m]."""
        lx, ly, lz = self.find_limit(health)
        sx, sy, sz = sigma_b_rad
        ux, uy, uz = torque_b_nm
        x, y, z = self.z_b_rad_s
        self.z_b_rad_s = (
            x - sx * dt_s if -lx < ux < lx or ux * sx > 0.0 else x,
            y - sy * dt_s if -ly < uy < ly or uy * sy > 0.0 else y,
            z - sz * dt_s if -lz < uz < lz or uz * sz > 0.0 else z,
        )

    def _find_limits(self, share: Vec4) -> Vec3:
        wheels = self._wheels
        (la, lb, lc, ld), (a, b, c, d) = wheels.max_torque_nm, share
        limits = (a * la, b * lb, c * lc, d * ld)
        x, y, z = AXES
        return (
            wheels.find_authority(x, limits)[0],
            wheels.find_authority(y, limits)[0],
            wheels.find_authority(z, limits)[0],
        )
