"""Gains of the engineering PID from the frequency, damping and integral pole of the loop that they make."""

from __future__ import annotations

from bus.errors import ConfigError
from bus.units import Vec3
from fsw.vehicle import Vehicle

Gains = tuple[Vec3, Vec3, Vec3]  # kp, ki, kd, each per body axis


def place_poles(frequency_rad_s: float, damping: float, integral_rad_s: float, vehicle: Vehicle) -> Gains:
    """Return kp [N m/rad], ki [N m/(rad s)] and kd [N m s/rad] per axis, from the diagonal of the inertia.

    With u = -kp s - ki (integral of s) - kd w, s' = w and I w' = u, the loop's poles are those of
    (p^2 + 2 damping f p + f^2)(p + integral): the products of inertia are left to the feedback.
    """
    f, p = frequency_rad_s, integral_rad_s
    (x, _, _), (_, y, _), (_, _, z) = vehicle.inertia_kgm2
    kp, ki, kd = f * f + 2.0 * damping * f * p, f * f * p, 2.0 * damping * f + p
    return (x * kp, y * kp, z * kp), (x * ki, y * ki, z * ki), (x * kd, y * kd, z * kd)


def choose_gains(given: tuple[Vec3 | None, Vec3 | None, Vec3 | None], placed: Gains, kind: str) -> Gains:
    """Return the gains given, or those placed where none is. Raises ConfigError where one or two of the three are given."""
    kp, ki, kd = given
    if kp is None and ki is None and kd is None:
        return placed
    if kp is None or ki is None or kd is None:
        missing = ", ".join(key for key, value in (("kp", kp), ("ki", ki), ("kd", kd)) if value is None)
        raise ConfigError(
            f"controller {kind}: {missing} not given, but another gain is; give kp, ki and kd, or none of them"
        )
    return kp, ki, kd
