"""Star tracker: rate, latency, noise statistics, blindness and dropout."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bus.attitude import IDENTITY, exp_map, normalise
from plant_server.config import ExclusionConfig, StarTrackerConfig
from plant_server.faults import FaultTimeline, make_fault
from plant_server.star_tracker import NOT_VALID, StarFrame, StarTracker

STILL = (0.0, 0.0, 0.0)
Q = normalise((0.5, -0.3, 0.7, 0.1))
DT_S = 0.01


def make_tracker(faults=(), seed=2, **settings):
    timeline = FaultTimeline(tuple(faults), step_s=DT_S, steps_per_tick=1, seed=seed)
    return StarTracker(StarTrackerConfig(**settings), timeline, DT_S, seed)


def run(tracker, ticks, q=lambda k: Q, omega=STILL):
    return [tracker.sample(k, q(k), omega, k, k * DT_S) for k in range(ticks)]


def test_frames_come_at_the_trackers_rate_with_the_attitude():
    """4 Hz on a 100 Hz loop: every 25th tick, age 0, without noise the attitude itself."""
    frames = run(make_tracker(rate_hz=4.0), 101)
    assert [k for k, frame in enumerate(frames) if frame is not None] == [0, 25, 50, 75, 100]
    assert frames[25] == StarFrame(Q, 0)


@pytest.mark.parametrize(("latency_s", "ticks"), [(0.07, 7), (0.14, 14)])
def test_a_frame_is_late_by_the_latency_and_says_so(latency_s, ticks):
    """The attitude is that of the measurement, the age the ticks since; also when frames overtake the rate (10 Hz)."""
    turning = lambda k: exp_map((0.0, 0.001 * k, 0.0))  # noqa: E731
    frames = run(make_tracker(rate_hz=10.0, latency_s=latency_s), 60, turning)
    sent = {k: frame for k, frame in enumerate(frames) if frame is not None}
    assert sorted(sent) == list(range(ticks, 60, 10))
    for k, frame in sent.items():
        assert frame == StarFrame(turning(k - ticks), ticks)


def test_noise_has_its_sigma_about_each_body_axis():
    """Per-axis mean 0, sigma as configured, no correlation, each within 5 standard errors over 4000 frames."""
    arcsec = np.array([10.0, 20.0, 52.0])
    frames = run(make_tracker(rate_hz=100.0, noise_arcsec=tuple(arcsec.tolist())), 4000)
    measured = Rotation.from_quat([[f.q_ib[1], f.q_ib[2], f.q_ib[3], f.q_ib[0]] for f in frames])
    errors = (Rotation.from_quat([Q[1], Q[2], Q[3], Q[0]]).inv() * measured).as_rotvec() / math.radians(1 / 3600)
    assert (np.abs(errors.mean(axis=0)) < 5 * arcsec / math.sqrt(4000)).all()
    np.testing.assert_allclose(errors.std(axis=0), arcsec, rtol=5 / math.sqrt(8000))
    assert np.abs(np.corrcoef(errors.T) - np.eye(3)).max() < 5 / math.sqrt(4000)


def test_blind_above_its_rate_limit_but_not_silent():
    """Frames go on, marked not valid, carrying no attitude."""
    tracker = make_tracker(rate_hz=100.0, max_rate_deg_s=2.0)
    fast, slow = (0.0, math.radians(2.01), 0.0), (0.0, math.radians(1.99), 0.0)
    assert run(tracker, 3, omega=fast) == [StarFrame(IDENTITY, NOT_VALID)] * 3
    assert run(tracker, 3, omega=slow) == [StarFrame(Q, 0)] * 3


def test_blind_near_a_bright_body():
    """Boresight +z, Sun on +x, half-cone 30 deg: tilting z towards x by 59 deg sees, by 61 deg does not."""
    exclusion = ExclusionConfig(boresight_b=(0.0, 0.0, 2.0), direction_i=(3.0, 0.0, 0.0), angle_deg=30.0)
    tracker = make_tracker(rate_hz=100.0, exclusion=exclusion)
    for degrees, valid in ((0.0, True), (59.0, True), (61.0, False), (90.0, False), (121.0, True)):
        frame = tracker.sample(0, exp_map((0.0, math.radians(degrees), 0.0)), STILL, 0, 0.0)
        assert frame is not None
        assert (frame.age_ticks == 0) == valid


def test_dropout_loses_frames_without_shifting_the_noise():
    """All frames by default, the given share otherwise; those that come are the same as without the fault."""
    noise = (10.0, 10.0, 50.0)
    healthy = run(make_tracker(rate_hz=100.0, noise_arcsec=noise), 4000)
    gone = run(
        make_tracker(
            [make_fault(unit="star_tracker", kind="dropout", at_s=10.0, until_s=20.0)],
            rate_hz=100.0, noise_arcsec=noise,
        ),
        4000,
    )  # fmt: skip
    assert gone[:1000] == healthy[:1000]
    assert gone[1000:2000] == [None] * 1000
    assert gone[2000:] == healthy[2000:]
    some = run(
        make_tracker(
            [make_fault(unit="star_tracker", kind="dropout", at_s=0.0, probability=0.7)],
            rate_hz=100.0, noise_arcsec=noise,
        ),
        4000,
    )  # fmt: skip
    assert sum(f is None for f in some) / 4000 == pytest.approx(0.7, abs=5 * math.sqrt(0.21 / 4000))
    assert all(a is None or a == b for a, b in zip(some, healthy, strict=True))


def test_blindness_does_not_shift_the_noise():
    """A blind spell spends the same draws, so what comes after is what would have come."""
    noise = {"rate_hz": 100.0, "noise_arcsec": (10.0, 10.0, 50.0), "max_rate_deg_s": 1.0}
    healthy = run(make_tracker(**noise), 20)
    tracker = make_tracker(**noise)
    run(tracker, 10, omega=(1.0, 0.0, 0.0))
    assert run(tracker, 10) == healthy[10:]
