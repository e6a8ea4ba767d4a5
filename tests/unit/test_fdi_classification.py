"""What kind a gyro fault is called that has no mean: noise, spikes, drop-outs. From the residual that each leaves."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from fsw.gyro_fdi.classification import Classifier, FaultKind

TICK_S = 0.05
HEALTHY_RAD_S = 1.5e-5  # drift that a tactical gyro may have
WHITE_RAD_S = 1.3e-4  # its white noise in a sample of TICK_S
RUNS = 8
FOUR_LOOKS = 3200  # samples: past the longest window that is looked at


def classify(signal: Iterable[float]) -> Classifier:
    classifier = Classifier(TICK_S, 20.0, HEALTHY_RAD_S)
    for value in signal:
        classifier.add(float(value))
    return classifier


@pytest.mark.parametrize("factor", [2.0, 3.0, 10.0, 30.0])
def test_noise_is_never_called_constant(factor: float) -> None:
    """More angle random walk, by any factor: OTHER, from the first look to the last."""
    for seed in range(RUNS):
        noise = factor * WHITE_RAD_S * np.random.default_rng(seed).normal(size=FOUR_LOOKS)
        for count in (600, FOUR_LOOKS):
            assert classify(noise[:count]).verdict.kind == FaultKind.OTHER


@pytest.mark.parametrize(("rate_rad_s", "probability"), [(1e-3, 0.3), (0.01, 0.01), (0.01, 0.3), (0.1, 0.01)])
def test_spikes_are_never_called_constant(rate_rad_s: float, probability: float) -> None:
    """Spikes of either sign by chance, rare and frequent, small and large, on healthy noise."""
    for seed in range(RUNS):
        rng = np.random.default_rng(seed)
        hit, sign = rng.random(FOUR_LOOKS) < probability, rng.choice([-1.0, 1.0], FOUR_LOOKS)
        assert (
            classify(WHITE_RAD_S * rng.normal(size=FOUR_LOOKS) + rate_rad_s * hit * sign).verdict.kind
            == FaultKind.OTHER
        )


def test_drop_outs_are_never_called_constant() -> None:
    """A rate that is held while frames fail lags behind the turn by little and then not at all: nothing that stays."""
    for seed in range(RUNS):
        rng = np.random.default_rng(seed)
        rate = 0.002 * np.sin(0.1 * TICK_S * np.arange(FOUR_LOOKS)) + WHITE_RAD_S * rng.normal(size=FOUR_LOOKS)
        held = rate.copy()
        for k in np.flatnonzero(rng.random(FOUR_LOOKS) < 0.3):
            held[k] = held[k - 1] if k else held[k]
        residual = held - 0.002 * np.sin(0.1 * TICK_S * np.arange(FOUR_LOOKS))
        assert classify(residual).verdict.kind == FaultKind.OTHER


@pytest.mark.parametrize("size", [1e-4, -2e-4, 5e-4])
def test_a_small_constant_still_stands_out(size: float) -> None:
    """A drift a few times what a healthy axis may have, in the scatter that flights show (7e-5 rad/s in 0.2 s): CONSTANT."""
    for seed in range(RUNS):
        verdict = classify(size + WHITE_RAD_S * np.random.default_rng(seed).normal(size=600)).verdict
        assert verdict.kind == FaultKind.CONSTANT
        assert verdict.magnitude_rad_s == pytest.approx(size, abs=3e-5)


def test_a_drift_that_a_healthy_axis_may_have_is_not_a_constant_fault() -> None:
    """Hardly any scatter and a mean below the class's own drift: OTHER. The same above it: CONSTANT."""
    quiet = 1e-6 * np.random.default_rng(1).normal(size=FOUR_LOOKS)
    assert classify(0.9 * HEALTHY_RAD_S + quiet).verdict.kind == FaultKind.OTHER
    assert classify(1.2 * HEALTHY_RAD_S + quiet).verdict.kind == FaultKind.CONSTANT
