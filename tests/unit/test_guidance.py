"""Courses of the target: limits, ends, and rates that are the derivatives of the attitudes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from bus.attitude import angle_between
from bus.commands import Command
from bus.errors import ConfigError
from bus.units import Vec4
from fsw.families import Guide
from fsw.guidance.guidance import Guidance, feed_forward
from fsw.guidance.settings import HoldConfig, SlewConfig, TrackConfig
from fsw.guidance.slew import Slew
from fsw.guidance.timeline import GUIDES, make_command, make_guide
from fsw.guidance.track import Track
from fsw.records import Target

DEG = math.pi / 180.0
STEP_S = 1e-3


def to_q(rotation: Rotation) -> Vec4:
    x, y, z, w = rotation.as_quat().tolist()
    return (w, x, y, z)


def to_scipy(q: Vec4) -> Rotation:
    return Rotation.from_quat([q[1], q[2], q[3], q[0]])


START = to_q(Rotation.from_rotvec([0.3, -0.5, 0.2]))
END = to_q(Rotation.from_rotvec([0.3, -0.5, 0.2]) * Rotation.from_rotvec(np.array([0.48, 0.6, -0.64]) * 40.0 * DEG))


def make_slew(rate_deg_s: float, acceleration_deg_s2: float, end: Vec4 = END) -> Slew:
    config = SlewConfig(
        do="slew", at_s=0.0, target_q=end, max_rate_deg_s=rate_deg_s, max_acceleration_deg_s2=acceleration_deg_s2
    )
    return Slew(config, Target(START), 7.0)


def assert_rates_are_derivatives(guide: Guide, times_s: list[float]) -> None:
    """Rate and acceleration against central differences of attitude and rate (scipy), target axes."""
    for t_s in times_s:
        before, now, after = (guide.point(t_s + dt) for dt in (-STEP_S, 0.0, STEP_S))
        turned = (to_scipy(before.q_it).inv() * to_scipy(after.q_it)).as_rotvec() / (2.0 * STEP_S)
        assert now.omega_ti_t_rad_s == pytest.approx(turned, abs=1e-8)
        gained = (np.array(after.omega_ti_t_rad_s) - np.array(before.omega_ti_t_rad_s)) / (2.0 * STEP_S)
        assert now.alpha_ti_t_rad_s2 == pytest.approx(gained, abs=1e-9)


SLEWS = [
    pytest.param(1.0, 0.1, 10.0 + 40.0, id="trapezoid"),  # ramp of 10 s, 40 deg at 1 deg/s
    pytest.param(5.0, 0.1, 2.0 * math.sqrt(400.0), id="triangle"),  # 2 sqrt(40 / 0.1), 2 deg/s at the peak
]


@pytest.mark.parametrize(("rate_deg_s", "acceleration_deg_s2", "duration_s"), SLEWS)
def test_a_slew_keeps_its_limits_and_ends_at_rest_at_its_target(
    rate_deg_s: float, acceleration_deg_s2: float, duration_s: float
) -> None:
    """About one axis all the way, never above either limit, the rate adds up to the angle, at rest at both ends."""
    slew = make_slew(rate_deg_s, acceleration_deg_s2)
    assert slew.duration_s == pytest.approx(duration_s)
    times = np.linspace(0.0, duration_s, 4001)
    targets = [slew.point(7.0 + t) for t in times.tolist()]
    rates = np.array([target.omega_ti_t_rad_s for target in targets]) / DEG
    speed = np.linalg.norm(rates, axis=1)
    assert speed.max() <= rate_deg_s * (1.0 + 1e-12)
    assert speed.max() == pytest.approx(min(rate_deg_s, 2.0))
    accelerations = np.linalg.norm([target.alpha_ti_t_rad_s2 for target in targets], axis=1) / DEG
    assert accelerations.max() <= acceleration_deg_s2 * (1.0 + 1e-12)
    assert float(speed[:-1].sum() * (times[1] - times[0])) == pytest.approx(40.0, rel=1e-5)
    turned = [(to_scipy(START).inv() * to_scipy(target.q_it)).magnitude() / DEG for target in targets]
    step_s = float(times[1] - times[0])
    assert turned == pytest.approx(step_s * (np.cumsum(speed) - 0.5 * speed), abs=1e-3)
    moving = speed > 1e-9
    assert rates[moving] / speed[moving, None] == pytest.approx(
        np.tile([0.48, 0.6, -0.64], (moving.sum(), 1)), abs=1e-9
    )
    assert targets[0].q_it == pytest.approx(START)
    for after_s in (duration_s, duration_s + 100.0):
        end = slew.point(7.0 + after_s + 1e-9)
        assert end.at_rest
        assert end.q_it == pytest.approx(END)
    nearly = slew.point(7.0 + duration_s - 1e-6)
    assert nearly.q_it == pytest.approx(END, abs=1e-9)
    assert nearly.omega_ti_t_rad_s == pytest.approx((0.0, 0.0, 0.0), abs=1e-8)


@pytest.mark.parametrize(("rate_deg_s", "acceleration_deg_s2", "duration_s"), SLEWS)
def test_a_slews_rate_is_the_derivative_of_its_attitude(
    rate_deg_s: float, acceleration_deg_s2: float, duration_s: float
) -> None:
    """While it speeds up, coasts and slows down."""
    parts = [0.05, 0.15, 0.3, 0.45, 0.55, 0.7, 0.85, 0.95]
    assert_rates_are_derivatives(
        make_slew(rate_deg_s, acceleration_deg_s2), [7.0 + part * duration_s for part in parts]
    )


def test_a_slew_takes_the_short_way() -> None:
    """The other sign of the end's quaternion is the same attitude: 40 degrees, not 320."""
    a, b, c, d = END
    for end in (END, (-a, -b, -c, -d), (2.0 * a, 2.0 * b, 2.0 * c, 2.0 * d)):
        assert make_slew(1.0, 0.1, end).duration_s == pytest.approx(50.0)


def test_a_slew_to_where_it_is_ends_at_once() -> None:
    """No angle, no time, no division by nothing."""
    slew = make_slew(1.0, 0.1, START)
    assert slew.duration_s < 1e-3
    assert slew.point(7.0 + 1e-3).at_rest


def make_track(rise_s: float, target_q: Vec4 | None = None) -> Track:
    config = TrackConfig(do="track", at_s=0.0, rate_deg_s=(0.3, -0.4, 1.2), rise_s=rise_s, target_q=target_q)
    return Track(config, Target(START), 5.0)


def test_a_tracks_rate_is_the_derivative_of_its_attitude() -> None:
    """While the rate comes up and after; then the rate is the one asked for, and the turn begins at the start."""
    track = make_track(10.0)
    assert_rates_are_derivatives(track, [5.5, 8.0, 14.9, 15.1, 40.0, 1000.0])
    assert np.array(track.point(30.0).omega_ti_t_rad_s) / DEG == pytest.approx([0.3, -0.4, 1.2])
    assert track.point(5.0).q_it == pytest.approx(START)
    assert track.point(5.0).omega_ti_t_rad_s == (0.0, 0.0, 0.0)
    turned = to_scipy(START).inv() * to_scipy(track.point(35.0).q_it)
    assert turned.as_rotvec() / DEG == pytest.approx(np.array([0.3, -0.4, 1.2]) * 25.0, abs=1e-9)


def test_a_track_without_a_rise_turns_at_once_from_the_attitude_given() -> None:
    """A step in rate, from target_q."""
    track = make_track(0.0, (0.0, 0.0, 3.0, 0.0))
    assert track.point(5.0).q_it == (0.0, 0.0, 1.0, 0.0)
    assert np.array(track.point(5.0).omega_ti_t_rad_s) / DEG == pytest.approx([0.3, -0.4, 1.2])


def test_hold_is_a_step_to_an_attitude_or_stays_where_the_target_is() -> None:
    """Without target_q a target that moves stops where it stands."""
    moving = Target(START, (0.1, 0.0, 0.0), (0.0, 0.1, 0.0))
    stay = make_guide(Command(0, "target.hold", {}), moving, 3.0).point(9.0)
    assert stay == Target(START)
    assert stay.at_rest
    go = make_guide(Command(0, "target.hold", {"target_q": [0.0, 2.0, 0.0, 0.0]}), moving, 3.0).point(3.0)
    assert go == Target((0.0, 1.0, 0.0, 0.0))


def test_feed_forward_is_the_derivative_of_the_targets_rate_in_body_axes() -> None:
    """d/dt (w_t in body axes) while the body turns otherwise than its target: by central differences with scipy."""
    guidance = Guidance(START)
    guidance.follow(Command(0, "target.track", {"rate_deg_s": [2.0, -3.0, 1.0], "rise_s": 20.0}), 0.0)
    rate = np.array([0.05, 0.02, -0.04])
    body = Rotation.from_rotvec([0.2, 0.4, -0.1])

    def find(t_s: float) -> tuple[np.ndarray, np.ndarray]:
        guidance.advance(t_s)
        error = guidance.find_error(to_q(body * Rotation.from_rotvec(rate * (t_s - 8.0))), tuple(rate.tolist()))  # type: ignore[arg-type]
        return np.array(error.omega_ti_b_rad_s), np.array(feed_forward(error, tuple(rate.tolist())))  # type: ignore[arg-type]

    (before, _), (now, found), (after, _) = find(8.0 - STEP_S), find(8.0), find(8.0 + STEP_S)
    assert found == pytest.approx((after - before) / (2.0 * STEP_S), abs=1e-8)
    assert np.linalg.norm(found) > 1e-3
    error = guidance.find_error(to_q(body), tuple(rate.tolist()))  # type: ignore[arg-type]
    assert np.array(error.omega_bt_b_rad_s) == pytest.approx(rate - np.array(error.omega_ti_b_rad_s), abs=1e-15)
    target = guidance.target
    expected = body.inv().apply(to_scipy(target.q_it).apply(target.omega_ti_t_rad_s))
    assert np.array(error.omega_ti_b_rad_s) == pytest.approx(expected, abs=1e-3)
    assert now == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(
    ("at_s", "tick_s", "tick"),
    [
        (0.0, 0.1, 0),
        (1.0, 0.1, 10),
        (0.3, 0.1, 3),
        (0.31, 0.1, 4),
        (0.001, 0.01, 1),
        (30.0, 0.01, 3000),
        (7.0, 0.001, 7000),
    ],
)
def test_timeline_entries_come_on_the_first_tick_at_or_after_their_time(at_s: float, tick_s: float, tick: int) -> None:
    """Whole ticks in spite of rounding, and never early; the command carries the entry's settings."""
    command = make_command(TrackConfig(do="track", at_s=at_s, rate_deg_s=(0.0, 0.5, 0.0)), tick_s)
    assert (command.tick, command.verb) == (tick, "target.track")
    guide = make_guide(Command.from_json(command.to_json()), Target(START), 0.0)
    assert np.array(guide.point(1.0).omega_ti_t_rad_s) / DEG == pytest.approx([0.0, 0.5, 0.0])


@pytest.mark.parametrize(
    ("word", "settings", "words"),
    [
        ("hold", {"target_q": [0, 0, 0, 0]}, "no attitude"),
        ("hold", {"target": [1, 0, 0, 0]}, "target"),
        ("slew", {}, "target_q"),
        ("slew", {"target_q": [1, 0, 0, 0], "max_rate_deg_s": 0.0}, "max_rate_deg_s"),
        ("slew", {"target_q": [1, 0, 0, 0], "max_acceleration_deg_s2": -1.0}, "max_acceleration_deg_s2"),
        ("slew", {"target_q": [0, 0, 0, 0]}, "no attitude"),
        ("track", {"rate_deg_s": [0.0, 1.0]}, "rate_deg_s"),
        ("track", {"rate_deg_s": [0.0, 1.0, 0.0], "rise_s": -1.0}, "rise_s"),
        ("track", {"rate_deg_s": [0.0, 1.0, 0.0], "target_q": [0, 0, 0, 0]}, "no attitude"),
    ],
)
def test_wrong_settings_are_refused_and_the_course_is_kept(word: str, settings: dict[str, object], words: str) -> None:
    """Each names what is wrong; the target goes on as before."""
    guidance = Guidance(START)
    guidance.follow(Command(0, "target.track", {"rate_deg_s": [0.0, 1.0, 0.0]}), 0.0)
    before = guidance.advance(3.0)
    with pytest.raises(ConfigError, match=words):
        guidance.follow(Command(0, f"target.{word}", settings), 3.0)
    assert guidance.advance(3.0) == before
    assert not guidance.advance(4.0).at_rest


def test_a_command_during_a_slew_starts_where_the_target_stands() -> None:
    """No jump in attitude; a new slew begins from rest there and ends at its own target."""
    guidance = Guidance(START)
    guidance.follow(Command(0, "target.slew", {"target_q": list(END), "max_rate_deg_s": 1.0}), 0.0)
    midway = guidance.advance(20.0)
    assert not midway.at_rest
    guidance.follow(Command(200, "target.slew", {"target_q": list(START), "max_rate_deg_s": 1.0}), 20.0)
    assert guidance.advance(20.0).q_it == pytest.approx(midway.q_it, abs=1e-12)
    assert guidance.advance(20.0).omega_ti_t_rad_s == pytest.approx((0.0, 0.0, 0.0))
    assert guidance.advance(1e4).q_it == pytest.approx(START)


def test_every_word_of_the_timeline_has_its_settings() -> None:
    """`do` of each settings class is the word that it is found under."""
    assert GUIDES["hold"][0] is HoldConfig
    assert set(GUIDES) == {"hold", "slew", "track", "rate"}


def test_a_rate_goes_on_from_how_the_target_moves() -> None:
    """From a turn about x to one about z: attitude and rate without a jump, and the attitude that scipy integrates."""
    guidance = Guidance(START)
    limits = {"max_acceleration_deg_s2": 0.1}
    guidance.follow(Command(0, "target.rate", {"rate_deg_s": [1.0, 0.0, 0.0]} | limits), 0.0)
    before = guidance.advance(30.0)
    guidance.follow(Command(300, "target.rate", {"rate_deg_s": [0.0, 0.5, 1.0]} | limits), 30.0)
    after = guidance.advance(30.0)
    assert after.q_it == pytest.approx(before.q_it, abs=1e-14)
    assert after.omega_ti_t_rad_s == pytest.approx((1.0 * DEG, 0.0, 0.0), abs=1e-15)
    ramp_s = 1.5 / 0.1  # the change is (-1, 0.5, 1) deg/s, 1.5 deg/s in length

    def derivative(t_s: float, q: np.ndarray) -> np.ndarray:
        share = min(1.0, t_s / ramp_s)
        x, y, z = DEG * (1.0 - share), DEG * 0.5 * share, DEG * share
        a, b, c, d = q
        return 0.5 * np.array(
            [-b * x - c * y - d * z, a * x + c * z - d * y, a * y + d * x - b * z, a * z + b * y - c * x]
        )

    for elapsed in (0.1, 7.0, 15.0, 40.0):
        solution = solve_ivp(derivative, (0.0, elapsed), before.q_it, rtol=1e-12, atol=1e-13, max_step=0.5)
        target = guidance.advance(30.0 + elapsed)
        assert angle_between(target.q_it, tuple(solution.y[:, -1])) < 1e-9
    assert target.omega_ti_t_rad_s == pytest.approx((0.0, 0.5 * DEG, DEG), abs=1e-15)
    assert target.alpha_ti_t_rad_s2 == (0.0, 0.0, 0.0)


def test_a_rate_of_zero_stops_the_target() -> None:
    """It comes to rest after rate over limit, and stays."""
    guidance = Guidance(START)
    guidance.follow(Command(0, "target.track", {"rate_deg_s": [0.0, 0.2, 0.0]}), 0.0)
    guidance.advance(5.0)
    guidance.follow(Command(50, "target.rate", {"rate_deg_s": [0.0, 0.0, 0.0], "max_acceleration_deg_s2": 0.1}), 5.0)
    assert not guidance.advance(6.9).at_rest
    assert guidance.advance(7.0).at_rest
    assert guidance.advance(7.0).q_it == pytest.approx(guidance.advance(9.0).q_it, abs=1e-15)
    assert angle_between(START, guidance.target.q_it) == pytest.approx((0.2 * 5.0 + 0.2) * DEG, abs=1e-12)
