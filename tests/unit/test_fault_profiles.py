"""How faults come on: levels against closed forms and distributions, whatever the step and whatever else there is."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from bus.errors import ConfigError
from bus.settings import build, plain
from plant_server.config import BodyConfig, PlantConfig, WheelConfig
from plant_server.faults import PROFILES, Fault, FaultTimeline, make_fault
from plant_server.faults.effects import WheelDisturbance
from plant_server.faults.profiles import Intermittent, LinearRise, Poisson, Pulse, Step, Walk, Window
from plant_server.plant import Plant

KEYS = {  # of every profile
    "step": {}, "linear": {"rise_s": 5.0}, "exp": {"tau_s": 2.0}, "pulse": {"length_s": 3.0},
    "window": {"rise_s": 2.0, "length_s": 3.0, "fall_s": 4.0},
    "intermittent": {"period_s": 2.0, "duty": 0.25, "jitter": 0.5},
    "poisson": {"rate_per_h": 900.0, "length_s": 0.5}, "walk": {"sigma_per_sqrt_s": 0.2},
}  # fmt: skip
CHANCE = ("intermittent", "poisson", "walk")


def make_timeline(*faults, step_s=0.01, seed=1):
    return FaultTimeline(tuple(faults), step_s=step_s, steps_per_tick=1, seed=seed)


def fault_of(profile, unit="wheel.1", kind="loss", at_s=0.0, **keys):
    magnitudes = {"effectiveness": 0.0} if kind == "loss" else {}
    return make_fault(unit=unit, kind=kind, at_s=at_s, profile=profile, **magnitudes, **KEYS[profile], **keys)


def levels_of(timeline, count, step_s=0.01, unit="wheel.1", which=0):
    """Level of one fault in the middle of each step, 0 where it does not act."""
    chain, found = timeline.chains[unit], []
    for step in range(count):
        if step >= chain.next_edge:
            chain.refresh(step)
        for entry in chain.active:
            entry.bring_to((step + 0.5) * step_s)
        found.append(next((e.now.level for e in chain.active if e.occurrence.number == which), 0.0))
    return np.array(found)


def middles(count, step_s=0.01):
    return (np.arange(count) + 0.5) * step_s


def open_course(profile, seed=1, stream="a"):
    return profile.open(seed, stream)


def test_every_profile_is_tried_here():
    """The table of this file is that of the register."""
    assert list(KEYS) == list(PROFILES)


# -- shapes --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("profile", "form"),
    [
        ("step", lambda t: np.ones_like(t)),
        ("linear", lambda t: np.clip(t / 5.0, 0.0, 1.0)),
        ("exp", lambda t: 1.0 - np.exp(-t / 2.0)),
        ("pulse", lambda t: np.where(t < 3.0, 1.0, 0.0)),
        ("window", lambda t: np.interp(t, [0.0, 2.0, 5.0, 9.0], [0.0, 1.0, 1.0, 0.0])),
    ],
)
def test_levels_follow_their_closed_form(profile, form):
    """From an onset that is not at 0, over 20 s; none before it."""
    levels = levels_of(make_timeline(fault_of(profile, at_s=1.0)), 2000)
    t = middles(2000)
    expected = np.where(t < 1.0, 0.0, form(t - 1.0))
    np.testing.assert_allclose(levels, expected, rtol=0.0, atol=1e-12)


def test_a_value_goes_from_what_it_was_to_what_it_is_to_be():
    """value = base + level (value - base): a gain of 0.6 half way is 0.8 of what there was."""
    timeline = make_timeline(make_fault(unit="wheel.1", kind="loss", effectiveness=0.6, at_s=0.0, rise_s=10.0))
    chain = timeline.chains["wheel.1"]
    chain.refresh(0)
    for t_s, expected in ((2.5, 0.9), (5.0, 0.8), (10.0, 0.6), (99.0, 0.6)):
        (entry,) = chain.active
        entry.bring_to(t_s)
        wheel = WheelDisturbance()
        entry.effect.disturb(wheel, entry.now)
        assert wheel.gain == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("profile", ["pulse", "window"])
def test_a_profile_that_is_over_ends_the_fault(profile):
    """`end` is announced when the profile is over, or at until_s when that is sooner."""
    span_s = {"pulse": 3.0, "window": 9.0}[profile]
    for keys, end_s in (({}, 1.0 + span_s), ({"until_s": 2.0}, 2.0), ({"until_s": 50.0}, 1.0 + span_s)):
        events = make_timeline(fault_of(profile, at_s=1.0, **keys)).take_events(10_000)
        assert [(event.phase, event.t_s) for event in events] == [
            ("onset", pytest.approx(1.0)),
            ("end", pytest.approx(end_s)),
        ]


def test_a_pulse_shorter_than_a_step_acts_for_one_step():
    """It is never lost between two steps, and never counted twice."""
    fault = make_fault(unit="wheel.1", kind="loss", effectiveness=0.5, at_s=0.503, length_s=0.001)
    levels = levels_of(make_timeline(fault, step_s=0.1), 20, step_s=0.1)
    assert np.flatnonzero(levels).tolist() == [6]


def test_a_commanded_pulse_lasts_from_the_moment_it_is_commanded():
    """With an onset in the past the length counts from now."""
    timeline = make_timeline(step_s=0.1)
    timeline.add(make_fault(unit="wheel.1", kind="jump", at_s=0.0, length_s=2.0), 100)
    assert [(e.phase, e.t_s) for e in timeline.take_events(1000)] == [("onset", 10.0), ("end", 12.0)]


# -- chance --------------------------------------------------------------------------------------------------------


def spells_of(levels, step_s):
    """(start, end) of every run of ones that has ended [s]."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0.0], levels))))
    return [(a * step_s, b * step_s) for a, b in zip(edges[::2], edges[1::2], strict=False)]


def test_intermittent_without_jitter_is_a_square_wave():
    """Period, duty and phase to the step."""
    fault = make_fault(unit="wheel.1", kind="dead", at_s=1.0, period_s=2.0, duty=0.25)
    levels = levels_of(make_timeline(fault), 2100)
    phase = np.mod(middles(2100) - 1.0, 2.0)
    np.testing.assert_array_equal(levels, np.where((middles(2100) > 1.0) & (phase < 0.5), 1.0, 0.0))


def test_jitter_makes_each_spell_late_within_its_pause():
    """One spell a period, of the same length, late by a uniform part of half the pause; another seed, other times."""
    spells = spells_of(levels_of(make_timeline(fault_of("intermittent")), 200_000), 0.01)
    assert len(spells) == 1000
    lengths = [b - a for a, b in spells]
    assert max(lengths) < 0.5 + 0.011
    assert min(lengths) > 0.5 - 0.011
    late = np.array([a - 2.0 * k for k, (a, _) in enumerate(spells)])
    assert late.min() > -0.011
    assert late.max() < 0.75 + 0.011
    assert stats.kstest(late, stats.uniform(0.0, 0.75).cdf).pvalue > 1e-3
    other = levels_of(make_timeline(fault_of("intermittent"), seed=2), 2000)
    assert not np.array_equal(other, levels_of(make_timeline(fault_of("intermittent")), 2000))


def test_strikes_come_as_a_poisson_process():
    """Gaps between strikes are exponential with the mean of the rate, and the count fits it (5 sigma)."""
    course = open_course(Poisson(rate_per_h=3600.0, length_s=0.001))
    levels = np.array([course.level(0.001 * k) for k in range(2_000_000)])
    starts = np.flatnonzero(np.diff(levels) > 0.0) * 0.001
    assert abs(len(starts) - 2000) < 5 * math.sqrt(2000)
    assert stats.kstest(np.diff(starts), stats.expon(scale=1.0).cdf).pvalue > 1e-3


def test_strikes_last_as_long_as_they_say_and_join_where_they_overlap():
    """The part of time in which it is there is that of an infinite-server queue, 1 - exp(-rate length)."""
    course = open_course(Poisson(rate_per_h=3600.0, length_s=0.7))
    there = np.mean([course.level(x) for x in np.arange(0.0, 20_000.0, 0.05)])
    assert there == pytest.approx(1.0 - math.exp(-0.7), abs=0.01)


def test_a_walk_spreads_with_the_square_root_of_time_and_stays_within_its_bounds():
    """Folded at 0, the level after t is |N(0, sigma^2 t)|; over long times its points are uniform on 0..1."""
    for t_s in (1.0, 4.0, 9.0):
        ends = [open_course(Walk(sigma_per_sqrt_s=0.05), seed).level(t_s) for seed in range(1500)]
        assert stats.kstest(ends, stats.halfnorm(scale=0.05 * math.sqrt(t_s)).cdf).pvalue > 1e-3
    course = open_course(Walk(sigma_per_sqrt_s=1.0))
    levels = np.array([course.level(x) for x in np.arange(0.0, 20_000.0, 0.5)])
    assert levels.min() >= 0.0
    assert levels.max() <= 1.0
    assert np.abs(np.histogram(levels, 10, (0.0, 1.0))[0] / len(levels) - 0.1).max() < 0.02
    wild = open_course(Walk(sigma_per_sqrt_s=1e6))
    assert all(0.0 <= wild.level(0.1 * k) <= 1.0 for k in range(1000))


@pytest.mark.parametrize("profile", CHANCE)
def test_chance_is_of_simulated_time_not_of_the_step(profile):
    """Steps of 0.02 s and of 0.1 s, and times asked at random: the same bits at the times that are common to them."""
    shape = PROFILES[profile](**KEYS[profile])
    t = [k * 0.02 for k in range(5000)]
    fine = dict(zip(t, map(open_course(shape).level, t), strict=True))
    coarse = open_course(shape)
    assert all(coarse.level(x) == fine[x] for x in t[::5])
    now_and_then = open_course(shape)
    picks = sorted(np.random.default_rng(3).choice(t, 200, replace=False).tolist())
    assert all(now_and_then.level(x) == now_and_then.level(x) == fine[x] for x in picks)


@pytest.mark.parametrize("profile", CHANCE)
def test_chance_is_the_faults_own(profile):
    """With faults on other units and of other kinds on its own, before it and behind it, drawing too: the same bits."""
    alone = levels_of(make_timeline(fault_of(profile, at_s=0.5)), 3000)
    others = [
        fault_of(profile, kind="dead"),
        fault_of(profile, unit="wheel.2"),
        make_fault(unit="wheel.1", kind="drag_burst", at_s=0.0),
        make_fault(unit="gyro", kind="intermittent", probability=0.5, at_s=0.0),
    ]
    np.testing.assert_array_equal(levels_of(make_timeline(*others, fault_of(profile, at_s=0.5)), 3000, which=4), alone)
    np.testing.assert_array_equal(levels_of(make_timeline(fault_of(profile, at_s=0.5), *others), 3000), alone)
    second = levels_of(make_timeline(fault_of(profile), fault_of(profile, at_s=0.5)), 3000, which=1)
    assert not np.array_equal(second, alone)  # a second of the same sort on the same unit has a stream of its own


def test_the_three_axes_of_one_gyro_fault_come_and_go_together():
    """One fault has one course: an intermittent shift of the triad is there on all axes or on none."""
    fault = make_fault(unit="gyro", kind="constant", rate_rad_s=0.1, at_s=0.0, rate_per_h=3600.0)
    timeline = make_timeline(fault)
    histories = []
    for step in range(3000):
        row = []
        for unit in ("gyro.x", "gyro.y", "gyro.z"):
            chain = timeline.chains[unit]
            if step >= chain.next_edge:
                chain.refresh(step)
            chain.active[0].bring_to(step * 0.01)
            row.append(chain.active[0].now.level)
        histories.append(tuple(row))
    assert set(histories) == {(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)}


# -- cost ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("profile", PROFILES)
def test_settled_means_that_the_level_stays(profile):
    """Once it says so the level is the same for an hour; a profile that goes on never says so."""
    course = open_course(PROFILES[profile](**KEYS[profile]))
    settled_at = None
    for t_s in np.arange(0.0, 100.0, 0.05).tolist():
        level = course.level(t_s)
        if settled_at is None and course.settled(t_s):
            settled_at, kept = t_s, level
        assert settled_at is None or level == kept
    assert (settled_at is None) == (profile in CHANCE)
    if settled_at is not None:
        assert course.level(3600.0) == kept


def test_a_settled_fault_costs_no_looks():
    """A wheel looks at its faults each step while a rise lasts or chance may fall, and no more after the rise."""
    wheels = tuple(WheelConfig(mount=mount) for mount in ("x", "y", "z", "skew"))
    config = PlantConfig(body=BodyConfig(inertia_kgm2=((40.0, 0, 0), (0, 40.0, 0), (0, 0, 40.0))), wheels=wheels)
    for profile, looks in (("linear", 501), ("step", 1), ("pulse", 2), ("walk", 2000)):
        plant = Plant(config, (fault_of(profile),), 0.01, 1)
        seen = 0
        for step in range(2000):
            seen += step >= plant.wheels._next_look
            plant.sample()
            plant.step((0.01, 0.01, 0.01, 0.01))
        assert abs(seen - looks) <= 1, (profile, seen)


# -- keys ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "profile"),
    [
        ({}, Step()),
        ({"rise_s": 4}, LinearRise(rise_s=4.0)),
        ({"length_s": 4}, Pulse(length_s=4.0)),
        ({"rise_s": 1, "length_s": 4}, Window(rise_s=1.0, length_s=4.0)),
        ({"rate_per_h": 4}, Poisson(rate_per_h=4.0)),
        ({"rate_per_h": 4, "length_s": 1}, Poisson(rate_per_h=4.0, length_s=1.0)),
        ({"period_s": 4}, Intermittent(period_s=4.0)),
        ({"sigma_per_sqrt_s": 0.1}, Walk(sigma_per_sqrt_s=0.1)),
        ({"profile": "window", "length_s": 4}, Window(length_s=4.0)),
    ],
    ids=lambda item: str(item) if isinstance(item, dict) else "",
)
def test_the_keys_say_which_profile_it_is(keys, profile):
    """Named, or the first that takes all keys given; and what is written down reads back as the same."""
    fault = make_fault(unit="wheel.1", kind="dead", at_s=1.0, **keys)
    assert fault.profile == profile
    assert build(Fault, plain(fault), "x") == fault


def test_a_kind_has_its_usual_profile_and_what_is_given_changes_it():
    """A seizure takes 0.2 s, a jump 0.5 s, bursts 3 s of 11 s; a step has to be asked for, and is kept when it is."""
    cases = [
        ("seize", {}, LinearRise(rise_s=0.2)), ("seize", {"rise_s": 3}, LinearRise(rise_s=3.0)),
        ("seize", {"profile": "step"}, Step()), ("jump", {}, Pulse(length_s=0.5)),
        ("jump", {"rate_per_h": 60}, Poisson(rate_per_h=60.0)),
        ("drag_burst", {}, Intermittent(period_s=11.0, duty=3.0 / 11.0)),
        ("drag_burst", {"period_s": 20}, Intermittent(period_s=20.0, duty=3.0 / 11.0)),
        ("drag_burst", {"jitter": 0.5}, Intermittent(period_s=11.0, duty=3.0 / 11.0, jitter=0.5)),
        ("drag_burst", {"rate_per_h": 60}, Poisson(rate_per_h=60.0)), ("drag_burst", {"profile": "step"}, Step()),
    ]  # fmt: skip
    for kind, keys, profile in cases:
        fault = make_fault(unit="wheel.1", kind=kind, at_s=0.0, **keys)
        assert fault.profile == profile, (kind, keys)
        assert build(Fault, plain(fault), "x") == fault


@pytest.mark.parametrize(
    ("kind", "profile"), list(itertools.product(["loss", "tach_bias", "friction_extra"], PROFILES))
)
def test_every_profile_reads_back_as_itself(kind, profile):
    """Also where its keys alone would say another."""
    magnitudes = {"effectiveness": 0.5} if kind == "loss" else {}
    fault = make_fault(unit="wheel.1", kind=kind, at_s=0.0, profile=profile, **KEYS[profile], **magnitudes)
    assert type(fault.profile) is PROFILES[profile]
    assert build(Fault, plain(fault), "x") == fault


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"profile": "linear", "rise_s": 1, "tau_s": 2}, "tau_s: profile linear has no use for tau_s; it takes rise_s"),
        ({"profile": "step", "rise_s": 1}, "rise_s: profile step has no use for rise_s; it takes no key"),
        ({"profile": "poisson"}, "rate_per_h: is missing"),
        ({"profile": "intermittent", "period_s": 1, "duty": 1.0}, "duty: 1.0 is out of range; allowed: > 0, < 1"),
        ({"rate_per_h": 0}, "rate_per_h: 0.0 is out of range; allowed: > 0, <= 36000"),
        ({"sigma_per_sqrt_s": -1}, "sigma_per_sqrt_s: -1.0 is out of range; allowed: > 0"),
        ({"tau_s": 0}, r"tau_s: 0.0 s is out of range; allowed: > 0"),
        ({"profile": "poison"}, 'profile: "poison" is not known; did you mean "poisson"\\?'),
    ],
)
def test_wrong_keys_of_a_profile_are_refused_where_they_are(keys, said):
    """Which key, what is wrong with it, and what there is instead."""
    with pytest.raises(ConfigError, match=said):
        make_fault(unit="wheel.1", kind="dead", at_s=0.0, **keys)


def test_what_is_there_or_not_has_no_slope():
    """A frozen reading comes and goes with chance or a pulse; a rise is refused, and so is a walk."""
    assert make_fault(unit="wheel.1", kind="tach_freeze", at_s=0.0, period_s=5.0).profile == Intermittent(period_s=5.0)
    with pytest.raises(ConfigError, match="wheel fault tach_freeze has no use for rise_s; it takes profile, length_s"):
        make_fault(unit="wheel.1", kind="tach_freeze", at_s=0.0, rise_s=5.0)
    with pytest.raises(ConfigError, match='"walk" is not known; there are: step, pulse, intermittent, poisson'):
        make_fault(unit="wheel.1", kind="tach_freeze", at_s=0.0, profile="walk", sigma_per_sqrt_s=0.1)
