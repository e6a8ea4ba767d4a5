"""From numbers between 0 and 1 to values of a distribution, by the inverse of its distribution function.

Last bits may differ between versions of scipy and of the C library: what goes into a run's settings is rounded to
DIGITS significant digits (`round_value`), where they do not matter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

from tools.campaign.strategies.answers import DIGITS, round_value

__all__ = [
    "DIGITS", "draw_attitude", "draw_direction", "draw_normal", "draw_onset", "draw_truncated_normal", "draw_uniform",
    "draw_whole", "round_value",
]  # fmt: skip

LEAST_U: Final = 2.0**-53  # a draw of 0 or 1 would be infinity in a normal distribution
HALVINGS: Final = 60  # of the interval in which an angle is


def draw_uniform(u: float, lower: float, upper: float) -> float:
    """Uniform between two ends."""
    return lower + u * (upper - lower)


def draw_log_uniform(u: float, lower: float, upper: float) -> float:
    """Its logarithm is uniform between those of the ends, both above 0."""
    return lower * math.exp(u * math.log(upper / lower))


def draw_whole(u: float, lower: int, upper: int) -> int:
    """A whole number from lower to upper, both included, each as likely."""
    return lower + min(math.floor(u * (upper - lower + 1)), upper - lower)


def draw_normal(u: float, mean: float, sigma: float) -> float:
    """Normal."""
    from scipy.special import ndtri

    return mean + sigma * float(ndtri(_inside(u)))


def draw_truncated_normal(u: float, mean: float, sigma: float, lower: float, upper: float) -> float:
    """Normal, on condition that it is between the ends."""
    from scipy.stats import truncnorm

    a, b = (lower - mean) / sigma, (upper - mean) / sigma
    value = mean + sigma * float(truncnorm.ppf(_inside(u), a, b))
    return min(max(value, lower), upper)


def draw_onset(u: float, rate_per_s: float, from_s: float, until_s: float) -> float:
    """Time of the first event of a Poisson process that begins at from_s, on condition that it comes before until_s."""
    reached = -math.expm1(-rate_per_s * (until_s - from_s))
    return min(from_s - math.log1p(-u * reached) / rate_per_s, until_s)


def draw_train(u: Sequence[float], rate_per_s: float, from_s: float, until_s: float) -> list[float]:
    """Times of the events of a Poisson process before until_s: exponential gaps, at most len(u) events."""
    times, t_s = [], from_s
    for number in u:
        t_s -= math.log1p(-min(number, 1.0 - LEAST_U)) / rate_per_s
        if t_s >= until_s:
            break
        times.append(round_value(t_s))
    return times


def draw_direction(u: Sequence[float], length: float = 1.0) -> list[float]:
    """A vector of that length whose direction is uniform on the sphere (Archimedes: its z is uniform)."""
    z, phi = 2.0 * u[0] - 1.0, 2.0 * math.pi * u[1]
    r = math.sqrt(max(0.0, 1.0 - z * z))
    return [length * r * math.cos(phi), length * r * math.sin(phi), length * z]


def draw_attitude(u: Sequence[float], within_rad: float = math.pi) -> list[float]:
    """A unit quaternion, scalar first and not negative: uniform on SO(3) among the turns by at most within_rad.

    Haar's measure has the axis uniform on the sphere and the angle with density 1 - cos(angle) (Miles 1965); the angle is
    found by bisection of angle - sin(angle).
    """
    wanted = u[0] * (within_rad - math.sin(within_rad))
    low, high = 0.0, within_rad
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if middle - math.sin(middle) < wanted:
            low = middle
        else:
            high = middle
    angle = 0.5 * (low + high)
    return [math.cos(0.5 * angle), *draw_direction(u[1:], math.sin(0.5 * angle))]


def choose(u: float, weights: Sequence[float]) -> int:
    """Index of one of several, each as likely as its weight says."""
    at, total = 0.0, math.fsum(weights)
    for index, weight in enumerate(weights):
        at += weight / total
        if u < at and weight > 0.0:
            return index
    return max(index for index, weight in enumerate(weights) if weight > 0.0)


def round_all(value: Any) -> Any:
    """The value with every fraction rounded to DIGITS significant digits."""
    if isinstance(value, float):
        return round_value(value) + 0.0  # no negative zero
    return [round_all(item) for item in value] if isinstance(value, list) else value


def _inside(u: float) -> float:
    return min(max(u, LEAST_U), 1.0 - LEAST_U)
