"""For which wheels the loop of the discrete integral sliding mode is stable: eigenvalues of its linear model, at start-up.

One axis with a moment of inertia of 1 stands for all: J multiplies every gain and divides every torque.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fsw.controllers.settings import DismcConfig

SAMPLES = 9  # of a range that start-up looks at
LARGEST = 10.0  # torque ratio beyond which nobody asks
STEPS = 200  # of the first search, over ratios from LARGEST / STEPS up
HALVINGS = 30


def is_stable_between(config: DismcConfig, period_s: float, c_1_s: float, low: float, high: float) -> bool:
    """Return whether the loop is stable at SAMPLES ratios from low to high: both ends and what lies between."""
    ratios = (low + (high - low) * i / (SAMPLES - 1) for i in range(SAMPLES))
    return all(find_radius(config, period_s, c_1_s, ratio) < 1.0 for ratio in ratios)


def find_stable_range(config: DismcConfig, period_s: float, c_1_s: float) -> tuple[float, float]:
    """Return the least and the largest ratio of true to assumed torque between which the loop is stable; (1, 0): none.

    The range is the one that holds 1, else the widest. At its lower end, 0 stands for a limit below the first step.
    """
    stable = [find_radius(config, period_s, c_1_s, LARGEST * i / STEPS) < 1.0 for i in range(1, STEPS + 1)]
    runs: list[tuple[int, int]] = []
    start = 0
    for i, good in enumerate([*stable, False]):
        if good:
            continue
        if i > start:
            runs.append((start, i - 1))
        start = i + 1
    if not runs:
        return (1.0, 0.0)
    one = STEPS / LARGEST - 1
    first, last = next((run for run in runs if run[0] <= one <= run[1]), max(runs, key=lambda run: run[1] - run[0]))
    width = LARGEST / STEPS
    low = 0.0 if first == 0 else _halve(config, period_s, c_1_s, (first + 1) * width, first * width)
    high = LARGEST if last == STEPS - 1 else _halve(config, period_s, c_1_s, (last + 1) * width, (last + 2) * width)
    return (low, high)


def find_radius(config: DismcConfig, period_s: float, c_1_s: float, ratio: float) -> float:
    """Return the spectral radius of the loop when the wheels give `ratio` times what is assumed of them [1]."""
    return float(np.abs(np.linalg.eigvals(make_loop(config, period_s, c_1_s, ratio))).max())


def make_loop(config: DismcConfig, period_s: float, c_1_s: float, ratio: float) -> npt.NDArray[np.float64]:
    """Return the loop's matrix, one step ahead, for an axis with J = 1.

    State: theta, omega, both one sample before, eps, d of theta and of omega per period, then the torques sent, newest
    first, as many as act or still wait.
    """
    t, f, count = period_s, config.frequency_rad_s, config.latency + 1
    stiffness, damping = f * f, 2.0 * config.damping * f
    size = 7 + count
    unit = np.eye(size)
    theta, omega, last_theta, last_omega, eps, d_theta, d_omega = unit[:7]
    acted = unit[size - 1]
    eps = eps + t * (stiffness * last_theta + (damping - c_1_s) * last_omega)
    d_theta = d_theta + config.lam * (theta - last_theta - t * last_omega - d_theta)
    d_omega = d_omega + config.lam * (omega - last_omega - t * acted - d_omega)
    sigma = c_1_s * theta + omega + eps
    v = -stiffness * theta - damping * omega - (c_1_s * d_theta + d_omega + config.kappa * sigma) / t
    queue = [v, *unit[7 : size - 1]]
    acts = queue[-1]
    rows = [theta + t * omega, omega + t * ratio * acts, theta, omega, eps, d_theta, d_omega, *queue]
    return np.array(rows)


def _halve(config: DismcConfig, period_s: float, c_1_s: float, good: float, bad: float) -> float:
    for _ in range(HALVINGS):
        middle = 0.5 * (good + bad)
        if find_radius(config, period_s, c_1_s, middle) < 1.0:
            good = middle
        else:
            bad = middle
    return good
