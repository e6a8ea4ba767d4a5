"""How large the gain of the power-integrator law must be for its proof to hold. Before a flight, not in its cycle.

With V = b V1 + sum W_i, V1 = 2 ln(1 + s.s) and W_i the integral of sig(s^(5/3) - w*_i^(5/3))^(7/5) from w*_i to w_i,
the law of fsw/controllers/power_integrator.py gives, for |sigma| <= 1 and m >= m_min(beta, b),

    V' <= -c sum (|sigma_i|^(8/5) + |xi_i|^(8/5)) <= -(c/K^(4/5)) V^(4/5),  c = b beta/3,  K = max(2 b, 2^(2/5))

so that the error is zero after at most 5 V(0)^(1/5) K^(4/5)/c. b is free; the least bound over it is what a gain is held to.
"""

from __future__ import annotations

import math
from typing import Final

from bus.units import Mat3

G_NORM: Final = math.sqrt(3.0) / 2.0  # most that the rows or columns of |G(sigma)| add up to, |sigma| <= 1
ROOT: Final = math.pow(2.0, 0.4)
SPAN: Final = 15.0  # natural logarithm: how far b is looked for on either side of beta^(10/3), near which it lies
LEAST_LOG: Final = -40.0  # and of the slopes that a gain may cover
MOST_LOG: Final = 20.0
GOLDEN: Final = (math.sqrt(5.0) - 1.0) / 2.0
SEARCHES: Final = 120  # steps of a golden-section or bisection search: to the last bits


def bound_gain(beta: float, weight: float) -> float:
    """Return m_min(beta, b) [1/s^2], b = weight: above it V' <= -c sum(...) is proven."""
    kappa = 1.4 * ROOT * math.pow(beta, 5.0 / 3.0)
    epsilon = (8.0 / 15.0) / ROOT * beta
    eta = math.pow(9.0 * kappa * G_NORM / (8.0 * weight), 0.6)
    share = weight * (beta / 3.0 + ROOT * 0.375 * math.pow(epsilon, -5.0 / 3.0))
    return share + kappa * G_NORM * (1.0 + 0.625 * beta * eta)


def find_least_gain(beta: float) -> tuple[float, float]:
    """Return the least m_min over b [1/s^2], and that b [1], for beta [rad/s]; by golden section over log b."""
    near = math.log(beta) * 10.0 / 3.0
    low, high = near - SPAN, near + SPAN
    a, b = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    at_a, at_b = bound_gain(beta, math.exp(a)), bound_gain(beta, math.exp(b))
    for _ in range(SEARCHES):
        if at_a <= at_b:
            high, b, at_b = b, a, at_a
            a = high - GOLDEN * (high - low)
            at_a = bound_gain(beta, math.exp(a))
        else:
            low, a, at_a = a, b, at_b
            b = low + GOLDEN * (high - low)
            at_b = bound_gain(beta, math.exp(b))
    weight = math.exp(0.5 * (low + high))
    return bound_gain(beta, weight), weight


def find_largest_beta(gain: float) -> float:
    """Return the largest beta [rad/s] that a gain [1/s^2] covers: find_least_gain rises with beta."""
    low, high = LEAST_LOG, MOST_LOG
    for _ in range(SEARCHES):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if find_least_gain(math.exp(middle))[0] <= gain else (low, middle)
    return math.exp(low)


def find_dominance(inverse_inertia: Mat3) -> float:
    """Return the least of J^-1_ii - sum_j |J^-1_ij| [1/(kg m^2)]: a gain in N m times this is a gain in 1/s^2.

    For the law without the factor J: sum_i b_i^7 (J^-1 b)_i >= dominance sum_i b_i^8 by Young's inequality,
    |b_i|^7 |b_j| <= 7/8 b_i^8 + 1/8 b_j^8. Not positive: the proof does not reach this inertia.
    """
    (a, b, c), (_, d, e), (_, _, f) = inverse_inertia
    b, c, e = abs(b), abs(c), abs(e)
    return min(a - b - c, d - b - e, f - c - e)
