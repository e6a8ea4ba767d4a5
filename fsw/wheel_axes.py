"""The four reaction wheels as the flight software knows them: axes x, y, z and a skew wheel along (1, 1, 1)/sqrt(3).

D0 maps wheel torques to body torque, tau_b = D0 tau_rw (Zhang, Ye & Sun 2018, eq (5)):

    D0 = [[1, 0, 0, s],
          [0, 1, 0, s],
          [0, 0, 1, s]],   s = 1/sqrt(3)

Every product is unrolled: fixed summation order, no matrix library in the cycle.
"""

from __future__ import annotations

import math

from bus.units import Vec3, Vec4

S = 1.0 / math.sqrt(3.0)
D0_B_RW: tuple[Vec4, Vec4, Vec4] = ((1.0, 0.0, 0.0, S), (0.0, 1.0, 0.0, S), (0.0, 0.0, 1.0, S))


def combine_wheels(per_wheel: Vec4) -> Vec3:
    """D0 @ per_wheel: body vector of a per-wheel quantity, in that quantity's unit (torque or momentum)."""
    x, y, z, w = per_wheel
    sw = S * w
    return (x + sw, y + sw, z + sw)


def project_on_wheels(vector_b: Vec3) -> Vec4:
    """D0^T @ vector_b: component of a body vector along each wheel axis, in the vector's unit."""
    x, y, z = vector_b
    return (x, y, z, S * (x + y + z))


def spread_on_wheels(vector_b: Vec3) -> Vec4:
    """D0^T (D0 D0^T)^-1 @ vector_b: the least-squares wheel torques (or momenta) that add up to a body vector.

    D0 D0^T = I + (1/3) 1 1^T, whose inverse is I - (1/6) 1 1^T.
    """
    x, y, z = vector_b
    total = x + y + z
    sixth = total / 6.0
    return (x - sixth, y - sixth, z - sixth, 0.5 * S * total)
