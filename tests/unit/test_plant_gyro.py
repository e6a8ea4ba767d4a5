"""Gyro: what a clean one reports, each error term and fault by itself, and the Allan deviation against its formula."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from bus.attitude import rotate
from plant_server.config import BodyConfig, GyroConfig, PlantConfig, WheelConfig
from plant_server.faults import FaultTimeline, make_fault
from plant_server.gyro.presets import PRESETS
from plant_server.gyro.triad import Gyro
from plant_server.noise import open_normals, open_stream, open_uniforms
from plant_server.plant import Plant

DATA = Path(__file__).parent.parent / "data"
RATE = (0.011, -0.023, 0.005)
DT_S = 0.05
CLEAN = {
    "preset": "space", "arw_rad_sqrt_s": 0.0, "bias_instability_rad_s": 0.0, "rrw_rad_s_sqrt_s": 0.0,
    "scale_factor": (0.0, 0.0, 0.0), "angle_lsb_rad": 0.0,
}  # fmt: skip


def make_gyro(faults=(), dt_s=DT_S, seed=11, **settings):
    timeline = FaultTimeline(tuple(faults), step_s=dt_s, steps_per_tick=1, seed=seed)
    return Gyro(GyroConfig(**settings), timeline, dt_s, seed)


def read(gyro, ticks, rate=RATE, dt_s=DT_S, start=0):
    """Readings, silence and status over some ticks at a constant true rate."""
    readings, silent, status = [], [], []
    for k in range(start, start + ticks):
        readings.append(gyro.sample(rate, k, k * dt_s))
        silent.append(gyro.silent)
        status.append(gyro.status)
    return np.array(readings), np.array(silent), np.array(status)


def gyro_fault(kind, at_s=1.0, until_s=None, unit="gyro.y", **magnitudes):
    return make_fault(unit=unit, kind=kind, at_s=at_s, until_s=until_s, **magnitudes)


# -- without faults ------------------------------------------------------------------------------------------------


def test_ideal_gives_the_rate_itself():
    """Bit for bit, at the tick."""
    readings, silent, status = read(make_gyro(), 10)
    assert (readings == RATE).all()
    assert not silent.any()
    assert not status.any()


def test_ideal_is_instantaneous_and_the_others_give_the_mean_over_the_tick():
    """A body accelerated at a: ideal reads a t, the others a (t - dt/2)."""
    inertia = ((40.0, 0.0, 0.0), (0.0, 40.0, 0.0), (0.0, 0.0, 40.0))
    wheels = tuple(WheelConfig(mount=m) for m in ("x", "y", "z", "skew"))
    for settings, expected in (({"preset": "ideal"}, 0.1 / 40.0 * 0.5), (CLEAN, 0.1 / 40.0 * 0.45)):
        config = PlantConfig(body=BodyConfig(inertia_kgm2=inertia), wheels=wheels, gyro=GyroConfig(**settings))
        plant = Plant(config, (), 0.1, 1)
        for _ in range(5):
            plant.sample()
            plant.step((0.1, 0.0, 0.0, 0.0))
        assert plant.sample().gyro_rate_rad_s[0] == pytest.approx(expected, rel=1e-9)


def test_scale_factor_bias_and_misalignment():
    """y = (1 + s) w' + b with w' the rate about the turned sensing axes."""
    settings = {**CLEAN, "scale_factor": (0.01, -0.02, 0.03), "bias_rad_s": (1e-3, 2e-3, -3e-3)}
    readings, _, _ = read(make_gyro(**settings), 3)
    np.testing.assert_allclose(readings[-1], np.array(RATE) * (1.01, 0.98, 1.03) + (1e-3, 2e-3, -3e-3), rtol=1e-13)
    readings, _, _ = read(make_gyro(**{**CLEAN, "misalignment_deg": (0.0, 0.0, 30.0)}), 3)
    c, s = math.cos(math.pi / 6), math.sin(math.pi / 6)
    np.testing.assert_allclose(readings[-1], (c * RATE[0] + s * RATE[1], -s * RATE[0] + c * RATE[1], RATE[2]))
    # the sensing triad turned by q reads R(q)^T w
    half = math.pi / 12
    np.testing.assert_allclose(rotate((math.cos(half), 0.0, 0.0, math.sin(half)), tuple(readings[-1])), RATE)


def test_scale_factor_is_drawn_from_the_preset():
    """Over 400 seeds its spread is the preset's sigma, within 5 standard errors, and its mean 0."""
    quiet = dict.fromkeys(("arw_rad_sqrt_s", "bias_instability_rad_s", "rrw_rad_s_sqrt_s", "angle_lsb_rad"), 0.0)
    drawn = np.array(
        [make_gyro(seed=k, preset="tactical", **quiet).sample((1.0, 1.0, 1.0), 0, 0.0) for k in range(400)]
    )
    errors = drawn.ravel() - 1.0
    assert errors.std() == pytest.approx(300e-6, rel=5 / math.sqrt(2 * 1200))
    assert abs(errors.mean()) < 5 * 300e-6 / math.sqrt(1200)


def test_quantised_angle_keeps_every_quantum():
    """Each reading is a whole number of quanta per tick, and the sum never strays more than half a quantum."""
    lsb = 1e-4
    readings, _, _ = read(make_gyro(**{**CLEAN, "angle_lsb_rad": lsb}), 2000)
    quanta = readings * DT_S / lsb
    np.testing.assert_allclose(quanta, np.round(quanta), atol=1e-9)
    angle = np.cumsum(readings, axis=0) * DT_S
    exact = np.arange(1, 2001)[:, None] * np.array(RATE) * DT_S
    assert np.abs(angle - exact).max() <= 0.5 * lsb * (1 + 1e-6)


def test_range_saturates_and_says_so():
    """Beyond the range the reading stays at it, with its sign, status 2; each axis by itself; also for ideal."""
    for settings in (CLEAN, {"preset": "ideal"}):
        gyro = make_gyro(**settings, range_rad_s=0.02)
        readings, _, status = read(gyro, 3)
        np.testing.assert_allclose(readings[-1], (0.011, -0.02, 0.005))
        assert status[-1].tolist() == [0, 2, 0]
        read(gyro, 3, rate=(0.0, 0.0, 0.0))
        assert gyro.status == (0, 0, 0)


def test_bandwidth_is_a_first_order_lag():
    """After a step the reading closes in as 1 - exp(-2 pi f t)."""
    gyro = make_gyro(**{**CLEAN, "bandwidth_hz": 2.0})
    read(gyro, 5, rate=(0.0, 0.0, 0.0))
    readings, _, _ = read(gyro, 20, rate=(0.1, 0.0, 0.0))
    t = DT_S * np.arange(1, 21)
    np.testing.assert_allclose(readings[:, 0], 0.1 * (1.0 - np.exp(-2.0 * math.pi * 2.0 * t)), rtol=1e-9)


# -- noise ---------------------------------------------------------------------------------------------------------


def overlapping_allan_deviation(rate, dt_s, m):
    """From its definition (IEEE Std 952-1997, annex C), on the integrated angle."""
    angle = np.concatenate([[0.0], np.cumsum(rate) * dt_s])
    second = angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m]
    return math.sqrt(0.5 * np.mean(second**2)) / (m * dt_s)


def read_theory():
    with (DATA / "plant_fog_allan_theory_tactical.csv").open() as file:
        rows = [(float(row["tau_s"]), float(row["adev_rad_s"])) for row in csv.DictReader(file)]
    return np.array(rows).T


def run_fog(hours, seed, preset="tactical"):
    gyro = make_gyro(seed=seed, preset=preset)
    still, sample = (0.0, 0.0, 0.0), gyro.sample
    return np.array([sample(still, k, k * DT_S) for k in range(int(hours * 3600 / DT_S))])


def assert_allan(rates, longest_s, low, high):
    tau, theory = read_theory()
    for m in np.unique(np.round(np.geomspace(1, longest_s / DT_S, 16)).astype(int)):
        expected = math.exp(np.interp(math.log(m * DT_S), np.log(tau), np.log(theory)))
        measured = np.mean([overlapping_allan_deviation(axis, DT_S, m) ** 2 for axis in rates.T]) ** 0.5
        assert low < measured / expected < high, f"tau {m * DT_S} s: {measured / expected}"


def test_allan_deviation_short():
    """1 h, three axes, tactical: within 5 % of the formula up to 10 s (quantisation and angle random walk)."""
    assert_allan(run_fog(1.0, 3), 10.0, 0.95, 1.05)


@pytest.mark.slow
def test_allan_deviation_long():
    """24 h, three axes, tactical: within 0.93..1.07 of the formula (noise, Gauss-Markov, walk, quanta) to 100 s."""
    assert_allan(run_fog(24.0, 4), 100.0, 0.93, 1.07)


def test_bias_instability_and_walk_have_their_statistics():
    """Of the bias alone over 600 seeds: variance at the start sigma^2, correlation exp(-t/tau), walk K^2 t."""
    b, tau, walk, seconds = 1e-4, 20.0, 3e-5, 30.0
    settings = {**CLEAN, "bias_instability_rad_s": b, "bias_time_s": tau, "rrw_rad_s_sqrt_s": walk}
    pairs = []
    for seed in range(600):
        gyro = make_gyro(seed=seed, dt_s=0.5, **settings)
        readings, _, _ = read(gyro, int(seconds / 0.5) + 1, rate=(0.0, 0.0, 0.0), dt_s=0.5)
        pairs.append((readings[0], readings[-1]))
    first, last = (np.array(x).ravel() for x in zip(*pairs, strict=True))
    sigma2 = (b * 0.664 / 0.617) ** 2
    error = 5 * math.sqrt(2 / first.size)
    assert first.var() == pytest.approx(sigma2, rel=error)
    assert last.var() == pytest.approx(sigma2 + walk**2 * seconds, rel=error)
    assert np.mean(first * last) == pytest.approx(sigma2 * math.exp(-seconds / tau), abs=error * sigma2)


def test_presets_are_ordered_and_the_given_term_wins():
    """Space is quieter than tactical in every term; a term beside the preset replaces only itself."""
    space, tactical = PRESETS["space"], PRESETS["tactical"]
    assert tactical.arw_rad_sqrt_s == pytest.approx(2.908882e-5, rel=1e-6)  # 0.1 deg/sqrt(h)
    assert tactical.bias_instability_rad_s == pytest.approx(4.848137e-6, rel=1e-6)  # 1 deg/h
    assert tactical.rrw_rad_s_sqrt_s == pytest.approx(2.424068e-8, rel=1e-6)  # 0.3 deg/h/sqrt(h)
    assert space.arw_rad_sqrt_s == pytest.approx(5.817764e-7, rel=1e-6)
    assert space.rrw_rad_s_sqrt_s == pytest.approx(8.080228e-11, rel=1e-6)
    loud = make_gyro(preset="space", arw_rad_sqrt_s=1e-3)
    readings, _, _ = read(loud, 4000, rate=(0.0, 0.0, 0.0))
    np.testing.assert_allclose(readings.std(axis=0), 1e-3 / math.sqrt(DT_S), rtol=5 / math.sqrt(2 * 4000))


def test_streams_are_named_independent_and_repeatable():
    """One name and seed: the same numbers. Another name or seed: uncorrelated ones."""

    def draws(seed, name):
        return open_stream(seed, name).standard_normal(20000)

    np.testing.assert_array_equal(draws(1, "gyro.x"), draws(1, "gyro.x"))
    for other in (draws(1, "gyro.y"), draws(2, "gyro.x")):
        assert abs(np.corrcoef(draws(1, "gyro.x"), other)[0, 1]) < 5 / math.sqrt(20000)
    normal, uniform = open_normals(1, "a"), open_uniforms(1, "a")
    normals = np.array([normal() for _ in range(5000)])
    uniforms = np.array([uniform() for _ in range(5000)])
    assert abs(normals.mean()) < 5 / math.sqrt(5000)
    assert normals.std() == pytest.approx(1.0, rel=5 / math.sqrt(10000))
    assert 0.0 <= uniforms.min() < 0.01
    assert 0.99 < uniforms.max() < 1.0


# -- faults --------------------------------------------------------------------------------------------------------

T = DT_S * np.arange(80)
ON = T >= 1.0 - 1e-9


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (gyro_fault("constant", rate_rad_s=0.1), RATE[1] + 0.1 * ON),
        (gyro_fault("constant", rate_rad_s=0.1, until_s=2.0), RATE[1] + 0.1 * (ON & (T < 2.0 - 1e-9))),
        (gyro_fault("constant", rate_rad_s=0.1, rise_s=2.0), RATE[1] + 0.05 * np.clip(T - 1.0, 0.0, 2.0)),
        (
            gyro_fault("periodic", rate_rad_s=0.05, frequency_rad_s=0.5),
            RATE[1] + 0.05 * np.sin(0.5 * (T - 1.0)) * ON,
        ),
        (
            gyro_fault("periodic", rate_rad_s=0.05, frequency_rad_s=0.5, phase="absolute"),
            RATE[1] + 0.05 * np.sin(0.5 * T) * ON,
        ),
        (gyro_fault("ramp", slope_rad_s2=1e-3), RATE[1] + 1e-3 * (T - 1.0) * ON),
        (gyro_fault("stuck", rate_rad_s=0.2), np.where(ON, 0.2, RATE[1])),
        (gyro_fault("scale", factor=-0.3), RATE[1] * np.where(ON, 0.7, 1.0)),
    ],
)
@pytest.mark.parametrize("settings", [CLEAN, {"preset": "ideal"}], ids=["clean", "ideal"])
def test_each_fault_by_its_formula(fault, expected, settings):
    """On its axis only, from its onset to its end, on a clean and on an ideal gyro."""
    readings, silent, _ = read(make_gyro([fault], **settings), 80)
    np.testing.assert_allclose(readings[:, 1], expected, atol=1e-13)
    assert (readings[:, (0, 2)] == (RATE[0], RATE[2])).all()
    assert not silent.any()


@pytest.mark.parametrize(
    ("faults", "expected"),
    [
        ([("constant", {"rate_rad_s": 0.1}), ("scale", {"factor": 1.0})], 2.0 * (RATE[1] + 0.1)),
        ([("scale", {"factor": 1.0}), ("constant", {"rate_rad_s": 0.1})], 2.0 * RATE[1] + 0.1),
        ([("constant", {"rate_rad_s": 0.1}), ("constant", {"rate_rad_s": 0.02})], RATE[1] + 0.12),
        ([("constant", {"rate_rad_s": 0.1}), ("stuck", {"rate_rad_s": 0.3})], 0.3),
        ([("stuck", {"rate_rad_s": 0.3}), ("constant", {"rate_rad_s": 0.1})], 0.4),
    ],
)
def test_faults_compose_in_the_order_of_onset(faults, expected):
    """None replaces another, whatever their order in the scenario."""
    timeline = [gyro_fault(kind, at_s=0.1 * (i + 1), **m) for i, (kind, m) in enumerate(faults)]
    readings, _, _ = read(make_gyro(reversed(timeline), **CLEAN), 20)
    assert readings[-1, 1] == pytest.approx(expected, abs=1e-15)


def test_stuck_freezes_at_the_last_output_to_the_bit():
    """A noisy, quantised axis freezes at what it last gave out, and moves again afterwards."""
    readings, _, _ = read(make_gyro([gyro_fault("stuck", until_s=2.0)], preset="tactical"), 60)
    assert (readings[20:40, 1] == readings[19, 1]).all()
    assert len(set(readings[:20, 1])) > 10
    assert len(set(readings[40:, 1])) > 10
    assert len(set(readings[20:40, 0])) > 10


def test_an_ideal_gyro_that_gets_stuck_holds_the_sample_before():
    """Not the rate at its onset: the output of the tick before it, to the bit; a quantised one goes on from its rest."""
    gyro = make_gyro([gyro_fault("stuck", unit="gyro.x", at_s=2 * DT_S)])
    rates = [gyro.sample((rate, 0.0, 0.0), k, k * DT_S)[0] for k, rate in enumerate([0.0, 0.5, 0.25, 0.125])]
    assert rates == [0.0, 0.5, 0.5, 0.5]


def test_dead_is_silence_and_intermittent_is_silence_by_chance():
    """Dead: no frame at all. Intermittent: the given share of frames is missing (5 standard errors)."""
    _, silent, _ = read(make_gyro([gyro_fault("dead", until_s=2.0)]), 60)
    assert silent[:, 1].tolist() == [False] * 20 + [True] * 20 + [False] * 20
    assert not silent[:, (0, 2)].any()
    _, silent, _ = read(make_gyro([gyro_fault("intermittent", probability=0.3)]), 4020)
    assert not silent[:20].any()
    assert silent[20:, 1].mean() == pytest.approx(0.3, abs=5 * math.sqrt(0.21 / 4000))


def test_spikes_come_by_chance_with_either_sign():
    """Share, size and sign of the spikes; the readings between them are untouched."""
    readings, _, _ = read(make_gyro([gyro_fault("spikes", rate_rad_s=0.5, probability=0.1)], **CLEAN), 4020)
    off = np.round((readings[20:, 1] - RATE[1]) / 0.5, 12)
    assert set(off) == {-1.0, 0.0, 1.0}
    assert np.mean(off != 0.0) == pytest.approx(0.1, abs=5 * math.sqrt(0.09 / 4000))
    assert abs(off.sum()) < 5 * math.sqrt(400)


def test_noise_multiplies_the_angle_random_walk():
    """The very same noise, five times as large, on the faulty axis; the others keep theirs bit for bit."""
    settings = {"preset": "tactical", "angle_lsb_rad": 0.0}
    healthy, _, _ = read(make_gyro(**settings), 4000)
    noisy, _, _ = read(make_gyro([gyro_fault("noise", at_s=0.0, factor=5.0)], **settings), 4000)
    assert (healthy[:, (0, 2)] == noisy[:, (0, 2)]).all()
    bias = healthy[:, 1].mean()
    assert (noisy[:, 1] - bias).std() == pytest.approx(5.0 * 2.908882e-5 / math.sqrt(DT_S), rel=5 / math.sqrt(8000))
    assert np.corrcoef(healthy[:, 1], noisy[:, 1])[0, 1] > 0.999


def test_truth_tells_bias_and_fault_apart():
    """reading - true rate - white noise = bias + fault; here without white noise."""
    settings = {**CLEAN, "bias_rad_s": (0.0, 2e-3, 0.0)}
    gyro = make_gyro([gyro_fault("constant", rate_rad_s=0.1)], **settings)
    read(gyro, 30)
    assert gyro.axes[1].bias_rad_s == 2e-3
    assert gyro.axes[1].fault_rad_s == pytest.approx(0.1, abs=1e-15)
    assert gyro.axes[0].fault_rad_s == 0.0


def test_a_wheel_fault_does_not_touch_the_gyros_noise():
    """The body moves differently, but reading minus true mean rate is the same sequence to rounding."""
    wheels = tuple(WheelConfig(mount=m) for m in ("x", "y", "z", "skew"))
    inertia = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))
    gyro = GyroConfig(preset="tactical", angle_lsb_rad=0.0, scale_factor=(0.0, 0.0, 0.0))
    config = PlantConfig(body=BodyConfig(inertia_kgm2=inertia), wheels=wheels, gyro=gyro, step_s=0.05)

    def errors(faults):
        plant = Plant(config, faults, DT_S, 9)
        out = []
        for _ in range(100):
            before = np.array(plant.truth().omega_bi_b_rad_s)
            plant.step((0.05, 0.0, 0.0, 0.0))
            after = np.array(plant.truth().omega_bi_b_rad_s)
            out.append(np.array(plant.sample().gyro_rate_rad_s) - 0.5 * (before + after))
        return np.array(out)

    faulty = errors((make_fault(unit="wheel.1", kind="loss", effectiveness=0.3, at_s=1.0),))
    np.testing.assert_allclose(errors(()), faulty, atol=1e-8)  # sigma is 1.3e-4; the rest is the trapezium's error
