"""Faults of what gyro and star tracker say: each against what the same plant says without it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bus.attitude import angle_between
from bus.units import DEG
from plant_server.config import BodyConfig, GyroConfig, PlantConfig, StarTrackerConfig, WheelConfig
from plant_server.faults import make_fault
from plant_server.plant import Plant

J = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))
ONSET = 20  # tick


def fly(ticks, *faults, tick_s=0.1, rate_hz=10.0, latency_s=0.0, preset="tactical", seed=3):
    """Samples of a tumbling plant, and its true attitude at each."""
    config = PlantConfig(
        body=BodyConfig(inertia_kgm2=J, rate_deg_s=(1.0, -2.0, 3.0)),
        wheels=tuple(WheelConfig(mount=mount) for mount in ("x", "y", "z", "skew")),
        gyro=GyroConfig(preset=preset),
        star_tracker=StarTrackerConfig(rate_hz=rate_hz, noise_arcsec=(10.0, 10.0, 50.0), latency_s=latency_s),
    )
    made = tuple(make_fault(**{"at_s": ONSET * tick_s, **fault}) for fault in faults)
    plant = Plant(config, made, tick_s, seed)
    samples, truth = [], []
    for k in range(ticks):
        truth.append(plant.truth().q_ib)
        samples.append(plant.sample())
        plant.step((0.01 * math.sin(0.1 * k), 0.0, -0.01, 0.0))
    return samples, truth


def star(**fault):
    return {"unit": "star_tracker", **fault}


def gyro(**fault):
    return {"unit": "gyro.y", **fault}


def test_a_frozen_star_tracker_repeats_its_last_attitude():
    """Every frame from the onset to the end carries what the last one before it had; then those without the fault."""
    healthy, _ = fly(60)
    frozen, _ = fly(60, star(kind="frozen", until_s=4.0))
    assert [s.star.q_ib for s in frozen[ONSET:40]] == [healthy[ONSET - 1].star.q_ib] * 20
    assert [s.star.q_ib for s in frozen[40:]] == [s.star.q_ib for s in healthy[40:]]


def test_a_garbled_star_tracker_gives_every_attitude_alike():
    """Unit quaternions; the mean of each square is 1/4 and of each product 0, within 5 sigma of 4000 frames."""
    samples, _ = fly(ONSET + 4000, star(kind="garbage"))
    q = np.array([s.star.q_ib for s in samples[ONSET:]])
    assert np.allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-12)
    sigma = math.sqrt((1 / 8 - 1 / 16) / len(q))  # E q^4 = 1/8 on the sphere in four dimensions
    assert np.all(np.abs((q * q).mean(axis=0) - 0.25) < 5 * sigma)
    for i, j in ((0, 1), (1, 2), (2, 3), (0, 3)):
        assert abs((q[:, i] * q[:, j]).mean()) < 5 * math.sqrt(1 / 24 / len(q))


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_turned_star_tracker_is_off_by_the_angle_about_the_axis(axis):
    """The turn between frame and the healthy frame, in body axes, is the angle about that axis; half way up, half."""
    healthy, _ = fly(60)
    turned, _ = fly(60, star(kind="misaligned", angle_deg=-3.0, axis=axis, rise_s=2.0))
    index = "xyz".index(axis)
    for k in range(ONSET, 60):
        level = min(1.0, (k - ONSET) / 20)
        vector = body_turn(healthy[k].star.q_ib, turned[k].star.q_ib)
        expected = [0.0, 0.0, 0.0]
        expected[index] = -3.0 * DEG * level
        assert vector == pytest.approx(expected, abs=1e-9)


def body_turn(before, after):
    """Rotation vector, body axes, from one attitude to another: 2 vec(before* after) for small turns, exactly."""
    a, b = np.array(before), np.array(after)
    scalar = a @ b
    vector = a[0] * b[1:] - b[0] * a[1:] - np.cross(a[1:], b[1:])
    return 2.0 * math.atan2(np.linalg.norm(vector), scalar) * vector / (np.linalg.norm(vector) or 1.0)


def test_a_star_tracker_that_turns_away_is_off_by_rate_times_time():
    """From nothing at the onset."""
    healthy, _ = fly(120)
    turning, _ = fly(120, star(kind="rotating", rate_deg_s=0.5))
    for k in (ONSET, ONSET + 1, 70, 119):
        angle = angle_between(healthy[k].star.q_ib, turning[k].star.q_ib)
        assert angle == pytest.approx(0.5 * DEG * 0.1 * (k - ONSET), abs=1e-7)


@pytest.mark.parametrize("latency_s", [0.0, 0.3])
@pytest.mark.parametrize("rate_hz", [10.0, 5.0])
def test_a_late_star_tracker_gives_the_frames_of_before(latency_s, rate_hz):
    """Each frame some ticks later than without, with the same age in it; at the end those held back are lost."""
    healthy, _ = fly(80, latency_s=latency_s, rate_hz=rate_hz)
    late, _ = fly(80, star(kind="late", ticks=7, until_s=5.0), latency_s=latency_s, rate_hz=rate_hz)
    lag = round(latency_s / 0.1)
    every = round(10 / rate_hz)
    for k in range(80):
        measured, delayed = k - lag, k - lag - 7
        expected = None
        if measured % every == 0 and measured >= 0 and not ONSET <= measured < 50:
            expected = healthy[k].star
        elif delayed % every == 0 and ONSET <= delayed < 50 and k < 50 + lag:
            expected = healthy[k - 7].star
        got = late[k].star
        assert (got is None) == (expected is None), k
        if got is not None:
            assert (got.q_ib, got.age_ticks) == (expected.q_ib, expected.age_ticks)


@pytest.mark.parametrize(("unit", "index"), [("star_tracker", None), ("gyro.y", 1)])
def test_half_the_frames_are_missing(unit, index):
    """Every second one from the onset on; those that come are what they are without the fault."""
    healthy, _ = fly(60)
    half, _ = fly(60, {"unit": unit, "kind": "half_rate", "until_s": 4.0})
    for k in range(60):
        missing = ONSET <= k < 40 and (k - ONSET) % 2 == 1
        if index is None:
            assert (half[k].star is None) == missing
            assert missing or half[k].star.q_ib == healthy[k].star.q_ib
        else:
            assert half[k].gyro_silent[index] == missing
            assert half[k].gyro_rate_rad_s[index] == healthy[k].gyro_rate_rad_s[index]


def test_a_late_gyro_gives_the_rates_of_before():
    """Of so many samples ago, and the last one before the onset until there is one; then those of now."""
    healthy, _ = fly(80, preset="ideal")
    late, _ = fly(80, gyro(kind="late", ticks=6, until_s=6.0), preset="ideal")
    for k in range(80):
        at = k if not ONSET <= k < 60 else max(k - 6, ONSET - 1)
        assert late[k].gyro_rate_rad_s[1] == pytest.approx(healthy[at].gyro_rate_rad_s[1], abs=1e-12)
        assert late[k].gyro_rate_rad_s[0] == healthy[k].gyro_rate_rad_s[0]


def test_a_garbled_gyro_gives_every_rate_within_its_range_alike():
    """Mean and mean square of 4000 samples are those of a uniform distribution, within 5 sigma; other axes are as ever."""
    samples, _ = fly(ONSET + 4000, gyro(kind="garbage", rate_rad_s=0.3))
    healthy, _ = fly(ONSET + 100)
    rates = np.array([s.gyro_rate_rad_s[1] for s in samples[ONSET:]])
    assert np.all(np.abs(rates) < 0.3 + 1e-4)
    assert abs(rates.mean()) < 5 * 0.3 / math.sqrt(3 * len(rates))
    assert abs((rates**2).mean() - 0.03) < 5 * 0.09 * math.sqrt((1 / 5 - 1 / 9) / len(rates))
    assert [s.gyro_rate_rad_s[2] for s in samples[: ONSET + 100]] == [s.gyro_rate_rad_s[2] for s in healthy]


@pytest.mark.parametrize("kind", ["frozen", "garbage", "misaligned", "half_rate", "late", "rotating"])
def test_a_fault_of_the_star_tracker_shifts_no_noise(kind):
    """Before its onset and after its end every frame is the same as without it, to the bit."""
    healthy, _ = fly(80)
    faulty, _ = fly(80, star(kind=kind, until_s=4.0))
    for k in [*range(ONSET), *range(50, 80)]:
        assert faulty[k].star.q_ib == healthy[k].star.q_ib


def test_random_torque_of_a_motor_has_its_size():
    """1 sigma of 5 mN m, anew each step, on the wheel alone: the mean square of what the wheel gives beside its command."""
    config = PlantConfig(
        body=BodyConfig(inertia_kgm2=J), wheels=tuple(WheelConfig(mount=m) for m in ("x", "y", "z", "skew"))
    )
    plant = Plant(config, (make_fault(unit="wheel.2", kind="torque_noise", at_s=0.0),), 0.01, 1)
    noise = []
    for _ in range(4000):
        plant.sample()
        plant.step((0.01, 0.02, 0.0, 0.0))
        torque = plant.truth().tau_rw_true_nm
        noise.append(torque[1] - 0.02)
        assert torque[0] == pytest.approx(0.01, abs=1e-12)
    assert np.std(noise) == pytest.approx(0.005, rel=5 / math.sqrt(2 * 4000))
    assert abs(np.mean(noise)) < 5 * 0.005 / math.sqrt(4000)
    assert abs(np.corrcoef(noise[:-1], noise[1:])[0, 1]) < 5 / math.sqrt(4000)


def test_a_wheel_whose_command_is_lost_says_so_at_once():
    """Also where the torque in effect stays the same 0 N m: status 2 of that wheel alone, 0 again with the next command."""
    config = PlantConfig(
        body=BodyConfig(inertia_kgm2=J), wheels=tuple(WheelConfig(mount=m) for m in ("x", "y", "z", "skew"))
    )
    plant = Plant(config, (), 0.01, 1)
    seen = []
    for lost in (False, True, False, True, True, False):
        plant.step((0.0, None if lost else 0.0, 0.0, 0.0))
        seen.append(plant.sample().wheel_status)
    assert seen == [(0, 2 if lost else 0, 0, 0) for lost in (False, True, False, True, True, False)]
