"""Attitude law that follows a braking profile, as fast as the wheels that are left allow.

After the surface s = w - w_d of docs/ilo-smc.md: w_d points along the eigenaxis at the rate from which the body can still
be stopped at the target. What "can" means is learnt in flight from the commanded wheel torques and from the fault torque
that the observer reports; nothing is known of the faults.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from bus.units import Vec3, Vec4
from fsw.config import BrakingProfileConfig, ModelConfig
from fsw.interfaces import Demand
from fsw.wheel_axes import S, combine_wheels

NO_TORQUE: Vec4 = (0.0, 0.0, 0.0, 0.0)
HEALTHY: Vec4 = (1.0, 1.0, 1.0, 1.0)
A_MIN_RAD_S2 = 2e-4  # slowest braking planned for; without it a wheel set judged dead would never move again
SHARE_MIN = 0.15  # a wheel judged weaker is still asked for this share, so that its recovery shows
LEARN_FLOOR_NM = 0.02  # commands far below it teach nothing: there, misalignment and drag look like lost torque
THETA_MIN_RAD = 1e-9


class BrakingProfileInternals(NamedTuple):
    """What the law holds, for telemetry."""

    s_b_rad_s: Vec3
    theta_rad: float
    rate_profile_rad_s: float  # length of w_d
    braking_rad_s2: float  # acceleration the wheels are thought to give along the eigenaxis, reserve taken off
    effectiveness: Vec4  # share of its command that each wheel is thought to deliver


def find_authority(t_x: float, t_y: float, t_z: float, limit_nm: Vec4) -> float:
    """Return the largest m for which D0 y = m t has a solution with |y_i| <= limit_i (infinite for t = 0) [1].

    With y_4 free, y_i = m t_i - S y_4 for i = 1..3. Eliminating y_4 between the two-sided limits of every pair of wheels
    leaves m |t_i - t_j| <= limit_i + limit_j and m |t_i| <= limit_i + S limit_4: exact for these four axes.
    """
    a, b, c, d = limit_nm
    skew = S * d
    m = math.inf
    for weight, room in (
        (abs(t_x), a + skew),
        (abs(t_y), b + skew),
        (abs(t_z), c + skew),
        (abs(t_x - t_y), a + b),
        (abs(t_y - t_z), b + c),
        (abs(t_z - t_x), c + a),
    ):
        if m * weight > room and weight > 0.0:
            m = room / weight
    return m


