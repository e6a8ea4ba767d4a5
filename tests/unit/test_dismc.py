"""Discrete integral sliding mode: against an independent linear model, closed forms and the eigenvalues of its loop."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.errors import ConfigError
from fsw.controllers.dismc import DiscreteIntegralSlidingMode
from fsw.controllers.dismc_stability import find_radius, find_stable_range, is_stable_between
from fsw.controllers.settings import DismcConfig
from fsw.records import HEALTHY, PointingError
from fsw.settings import ModelConfig
from fsw.vehicle import Vehicle

DATA = Path(__file__).parents[1] / "data/control"
INERTIA = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))
J = np.array(INERTIA)
VEHICLE = Vehicle(ModelConfig(inertia_kgm2=INERTIA))
T = 0.1
F, ZETA = 0.1, 0.9
ZERO = (0.0, 0.0, 0.0)
PATENT = DismcConfig(kind="dismc", kappa=1.0, lam=1.0, c_1_s=0.0, stability="warn")


def make(config: DismcConfig) -> DiscreteIntegralSlidingMode:
    return DiscreteIntegralSlidingMode(config, VEHICLE, T)


def see(x: Any) -> PointingError:
    """The error whose theta and omega are x; its scalar part plays no role."""
    half = [0.5 * float(v) for v in x[:3]]
    return PointingError((1.0, *half), tuple(float(v) for v in x[3:]))  # type: ignore[arg-type]


def tell(v: Any) -> tuple[float, float, float]:
    return tuple(float(value) for value in v)  # type: ignore[return-value]


def fly(config: DismcConfig, x: Any, steps: int, d: Any, ratio: float = 1.0, limit: float = math.inf) -> dict[str, Any]:
    """The law on x+ = Phi x + ratio Gamma v + d(k), v late by the law's own latency and cut to `limit` per axis."""
    law = make(config)
    inverse = np.linalg.inv(J)
    x = np.array(x, dtype=float)
    queue = [np.zeros(3)] * config.latency
    rows: dict[str, list[Any]] = {"x": [], "v": [], "sigma": [], "acts": []}
    for k in range(steps):
        v = np.array(law.step(T, see(x), ZERO, HEALTHY))
        sent = np.clip(v, -limit, limit)
        law.note_sent(tell(sent))
        rows["x"].append(x.copy())
        rows["v"].append(v)
        rows["sigma"].append(law.internals.sigma_b_nms)
        queue.append(sent)
        acts = ratio * queue.pop(0)
        rows["acts"].append(acts)
        x = np.concatenate([x[:3] + T * x[3:], x[3:] + T * inverse @ acts]) + d(k)
        if np.abs(x).max() > 1e6:
            break
    return {key: np.array(value) for key, value in rows.items()}


def test_agrees_with_the_reference_on_the_linear_model() -> None:
    """States, torques, surface, integral and estimate of an independent implementation, kappa = lam = 1: 1e-12."""
    reference = np.load(DATA / "dismc_linear_k1l1.npz")
    found = fly(PATENT, reference["x"][0], 800, lambda k: reference["d"][k])
    for key in ("x", "v", "sigma"):
        assert np.abs(found[key] - reference[key]).max() < 1e-12, key


def test_the_patents_surface_is_the_change_of_the_disturbance() -> None:
    """kappa = lam = 1: sigma_(k+1) = G (d_k - d_(k-1)), for c = 0 and for c = 2 zeta f."""
    rng = np.random.default_rng(4)
    d = np.cumsum(1e-6 * rng.standard_normal((400, 6)), axis=0)
    for c in (0.0, 2.0 * ZETA * F):
        found = fly(replace(PATENT, c_1_s=c), [0.1, -0.2, 0.05, 0.001, -0.002, 0.0], 400, lambda k: d[k])
        change = d[1:-1] - d[:-2]
        expected = change[:, :3] @ (c * J).T + change[:, 3:] @ J.T
        assert np.abs(found["sigma"][2:] - expected).max() < 1e-13


def test_the_literal_reading_diverges() -> None:
    """With the bracket as printed, v = -K0 x + G d + sigma, the surface grows by 1 + T a step; ours holds it."""
    d = 1e-6 * np.array([0.0, 0.0, 0.0, 1.0, -1.0, 0.5])
    g = np.hstack([np.zeros((3, 3)), J])
    k0 = np.hstack([F**2 * J, 2.0 * ZETA * F * J])
    drift = np.block([[np.zeros((3, 3)), T * np.eye(3)], [np.zeros((3, 6))]])
    gamma = T * np.vstack([np.zeros((3, 3)), np.linalg.inv(J)])
    begin = [0.05, -0.03, 0.02, 0.001, 0.002, -0.001]
    x, eps, sizes = np.array(begin), np.zeros(3), []
    for _ in range(400):
        sigma = g @ (x - begin) + eps
        sizes.append(np.abs(sigma).max())
        v = -k0 @ x + g @ d + sigma
        eps = eps - g @ (drift - gamma @ k0) @ x
        x = x + drift @ x + gamma @ v + d
    assert np.array(sizes[101:]) / np.array(sizes[100:-1]) == pytest.approx(1.0 + T, abs=1e-4)
    assert sizes[-1] > 1e6
    held = fly(PATENT, begin, 400, lambda k: d)["sigma"]
    assert np.abs(held[2:]).max() < 1e-12


TABLE = [  # kappa, lam, largest ratio at a latency of 0, 1, 2 samples; None: none is stable
    (1.0, 1.0, 1.32, 0.98, None),
    (0.5, 0.2, 3.02, 1.66, 1.14),
    (0.3, 0.3, 3.52, 2.14, 1.56),
    (0.3, 0.1, 5.0, 2.62, 1.72),
    (0.1, 0.1, 9.5, 5.06, 3.34),
]


@pytest.mark.parametrize(("kappa", "lam", "none", "one", "two"), TABLE)
def test_stable_ratios(kappa: float, lam: float, none: float, one: float, two: float | None) -> None:
    """The table of an independent eigenvalue analysis, to 0.04."""
    for latency, expected in enumerate((none, one, two)):
        config = DismcConfig(kind="dismc", kappa=kappa, lam=lam, latency=latency)
        least, most = find_stable_range(config, T, 2.0 * ZETA * F)
        if expected is None:
            assert least > most
        else:
            assert most == pytest.approx(expected, abs=0.04)
            assert least < 0.13
    if kappa + lam > 0.5:  # without K0 and latency: 0 < g < 4 / (2 (kappa + lam) - kappa lam)
        config = DismcConfig(kind="dismc", kappa=kappa, lam=lam)
        closed = 4.0 / (2.0 * (kappa + lam) - kappa * lam)
        assert find_stable_range(config, T, 0.18)[1] == pytest.approx(closed, rel=0.04)


@pytest.mark.parametrize("latency", [0, 1, 2])
def test_the_law_itself_turns_unstable_where_its_loop_does(latency: int) -> None:
    """Flown with 0.97 of the largest ratio it comes to rest, with 1.03 it runs away: the matrix is that of the law."""
    config = DismcConfig(kind="dismc", latency=latency, torque_ratio=(0.9, 1.1))
    most = find_stable_range(config, T, 0.18)[1]
    start = [1e-8, -2e-8, 1e-8, 0.0, 0.0, 0.0]
    for part in (0.97, 1.03):
        sizes = np.abs(fly(config, start, 600, lambda k: 0.0, ratio=part * most)["acts"]).max(axis=1)
        windows = [sizes[i : i + 100].max() for i in (300, 400, 500)]
        radius = find_radius(config, T, 0.18, part * most)
        assert (radius < 1.0) is (part < 1.0)
        for early, late in itertools.pairwise(windows):
            if part > 1.0:  # below it, the slow poles of the motion that is aimed at are what is left
                assert (late / early) ** 0.01 == pytest.approx(radius, rel=2e-3)
            else:
                assert late < early


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0, 2.0])
def test_offset_of_a_constant_drift(share: float) -> None:
    """A gyro bias d_u [rad/s] leaves theta = (2 zeta f - c) d_u / f^2: nothing for c = 2 zeta f, the default."""
    c = share * 2.0 * ZETA * F
    d = np.array([2e-4 * T, 0.0, -1e-4 * T, 0.0, 0.0, 0.0])
    found = fly(DismcConfig(kind="dismc", c_1_s=c), [0.0] * 6, 4000, lambda k: d)
    expected = (2.0 * ZETA * F - c) * np.array([2e-4, 0.0, -1e-4]) / F**2
    assert np.abs(found["x"][-1, :3] - expected).max() < 1e-9
    if share == 1.0:
        default = fly(DismcConfig(kind="dismc"), [0.0] * 6, 4000, lambda k: d)
        assert (default["x"] == found["x"]).all()


def test_a_matched_disturbance_leaves_no_offset() -> None:
    """A constant torque is taken out whole, with half the torque assumed and one sample of latency too."""
    torque = np.array([2e-3, -2e-3, 1e-3])
    push = np.concatenate([np.zeros(3), T * np.linalg.inv(J) @ torque])
    for ratio, latency in ((1.0, 0), (0.5, 1)):
        found = fly(DismcConfig(kind="dismc", latency=latency), [0.0] * 6, 4000, lambda k: push, ratio=ratio)
        assert np.abs(found["x"][-1]).max() < 1e-9
        assert found["acts"][-1] == pytest.approx(-torque, abs=1e-9)


def test_torque_that_was_not_given_does_not_wind_up() -> None:
    """0.1 N m per axis from 60 degrees: half the effort without windup, and the angle overshoots far less."""
    start = [1.0, -0.8, 0.6, 0.0, 0.0, 0.0]
    guarded = fly(DismcConfig(kind="dismc"), start, 3000, lambda k: 0.0, limit=0.1)
    winding = fly(DismcConfig(kind="dismc", anti_windup=False), start, 3000, lambda k: 0.0, limit=0.1)
    effort = [np.sum(run["acts"] ** 2) * T for run in (guarded, winding)]
    assert effort[0] < 0.7 * effort[1]
    assert -guarded["x"][:, 0].min() < 0.5 * -winding["x"][:, 0].min()
    assert np.abs(guarded["x"][-1]).max() < 1e-3


def test_what_the_observer_reports_is_made_up_for_once() -> None:
    """An observer that knows the disturbing torque and one that knows nothing end with the same torque on the body."""
    torque = np.array([3e-3, 1e-3, -2e-3])
    push = T * np.linalg.inv(J) @ torque
    for known in (ZERO, tell(torque)):
        law, x = make(DismcConfig(kind="dismc")), np.zeros(6)
        for _ in range(4000):
            asked = law.step(T, see(x), known, HEALTHY)
            law.note_sent(asked)
            x = np.concatenate([x[:3] + T * x[3:], x[3:] + T * np.linalg.inv(J) @ np.array(asked) + push])
        assert np.abs(x).max() < 1e-9
        assert np.array(asked) == pytest.approx(-torque, abs=1e-9)


def test_a_new_target_begins_a_new_surface() -> None:
    """A step of the target by 40 degrees is no disturbance: the estimate stays, and the surface begins at zero."""
    law = make(DismcConfig(kind="dismc"))
    for _ in range(20):
        law.note_sent(law.step(T, see([0.0] * 6), ZERO, HEALTHY))
    law.step(T, see([0.7, 0.0, 0.0, 0.0, 0.0, 0.0]), ZERO, HEALTHY)
    assert law.internals.sigma_b_nms == ZERO
    assert law.internals.disturbance_b_nm == ZERO
    assert law.internals.drift_b_rad_s == ZERO


def test_a_long_period_is_no_disturbance() -> None:
    """Three lost ticks: the state is predicted over the time that passed, so that nothing is learnt of it."""
    law, x = make(DismcConfig(kind="dismc")), np.array([0.02, 0.0, -0.01, 1e-4, 0.0, 0.0])
    inverse, asked = np.linalg.inv(J), ZERO
    for k in range(60):
        dt = 4.0 * T if k == 30 else T
        if k:
            x = np.concatenate([x[:3] + dt * x[3:], x[3:] + dt * inverse @ np.array(asked)])
        asked = law.step(dt, see(x), ZERO, HEALTHY)
        law.note_sent(asked)
        assert np.abs(law.internals.disturbance_b_nm).max() < 1e-12


def test_start_up_checks_the_loop() -> None:
    """Refused with the range that is stable; with `warn` it flies and says so; a reference motion too fast is refused."""
    with pytest.raises(
        ConfigError, match=r"latency of 2 samples the loop is stable for 0\.07 to 1\.57 .* asks for 0\.5 to 2"
    ):
        make(DismcConfig(kind="dismc", latency=2))
    with pytest.raises(ConfigError, match="is stable for no ratio"):
        make(DismcConfig(kind="dismc", kappa=1.0, lam=1.0, latency=2))
    with pytest.raises(ConfigError, match="is too fast for a control period"):
        make(DismcConfig(kind="dismc", frequency_rad_s=18.1))
    with pytest.raises(ConfigError, match=r"c_1_s = 50 1/s .* at most 10 times 2 damping frequency, 1\.8 1/s"):
        make(DismcConfig(kind="dismc", c_1_s=50.0))
    with pytest.raises(ConfigError, match="the first must not be above the second"):
        make(DismcConfig(kind="dismc", torque_ratio=(2.0, 0.5)))
    assert "stable for 0.07 to 1.57" in make(DismcConfig(kind="dismc", latency=2, stability="warn")).caution
    assert make(DismcConfig(kind="dismc")).caution == ""
    assert is_stable_between(DismcConfig(kind="dismc", latency=1), T, 0.18, 0.5, 2.0)
