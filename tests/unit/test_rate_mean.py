"""What a slower rate group is given of a fast gyro: the mean over its period, and not one sample of many."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bus.units import Vec3
from fsw.families import Observer
from fsw.rate_mean import RateMean
from tools.run.bench import Bench

RATES = [(0.1, -0.2, 0.3), (0.4, 0.0, -0.3), (-0.2, 0.5, 0.9)]


def test_the_mean_is_numpys_and_starts_anew_each_time() -> None:
    """Over three rates, then over the one that came since."""
    mean = RateMean()
    for rate in RATES:
        mean.add(rate)
    assert mean.take() == pytest.approx(np.mean(RATES, axis=0), abs=1e-15)
    mean.add(RATES[0])
    assert mean.take() == RATES[0]


def test_a_jump_of_the_rate_source_moves_what_was_taken_in() -> None:
    """As if every rate before it had been measured by the new source."""
    mean, step = RateMean(), (0.01, -0.02, 0.03)
    mean.add(RATES[0])
    mean.add(RATES[1])
    mean.shift(step)
    mean.add(RATES[2])
    expected = np.mean([np.add(RATES[0], step), np.add(RATES[1], step), RATES[2]], axis=0)
    assert mean.take() == pytest.approx(expected, abs=1e-15)


class RateKeeper(Observer):
    """Passes everything on to an observer and keeps the rates."""

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self.rates: list[Vec3] = []

    @property
    def internals(self) -> tuple[Any, ...]:
        return self._observer.internals

    def reset(self) -> None:
        self._observer.reset()

    def shift_rate(self, step_b_rad_s: Vec3) -> None:
        self._observer.shift_rate(step_b_rad_s)

    def step(self, dt_s: float, omega_bi_b_rad_s: Vec3, tau_cmd_b_nm: Vec3, h_rw_b_nms: Vec3) -> Vec3:
        self.rates.append(omega_bi_b_rad_s)
        return self._observer.step(dt_s, omega_bi_b_rad_s, tau_cmd_b_nm, h_rw_b_nms)


def test_the_observer_gets_the_mean_over_its_period() -> None:
    """In flight with a noisy gyro at 100 Hz and control at 10 Hz, from the estimates of every tick."""
    bench = Bench.open("zhang2018-flight", ["expect=[]"])
    bench.flight.observer = keeper = RateKeeper(bench.flight.observer)
    estimates = []
    for _ in range(500):
        bench.step()
        estimates.append(bench.flight.detection.estimate.omega_bi_b_rad_s)
    means = np.reshape(estimates[1:491], (49, 10, 3)).mean(axis=1)  # control runs on ticks 0, 10, 20, ...
    assert len(keeper.rates) >= 40
    assert np.array(keeper.rates[-40:]) == pytest.approx(means[-40:], abs=1e-15)
    assert not np.allclose(means[-40:], np.array(estimates[1:491])[9::10][-40:], atol=1e-7)
