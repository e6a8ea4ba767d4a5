"""Faults that stay: what a latch holds on to, and what a reset, a power cycle, the test bench and time take away."""

from __future__ import annotations

import pytest

from bus.errors import ConfigError
from bus.settings import Reading, build, plain
from plant_server.config import BodyConfig, PlantConfig, WheelConfig
from plant_server.faults import Fault, FaultTimeline, make_fault
from plant_server.plant import Plant

STEP_S = 0.1
BODY = BodyConfig(inertia_kgm2=((40.0, 0.0, 0.0), (0.0, 40.0, 0.0), (0.0, 0.0, 40.0)))
WHEELS = tuple(WheelConfig(mount=mount) for mount in ("x", "y", "z", "skew"))


def make_timeline(*faults):
    return FaultTimeline(tuple(faults), step_s=STEP_S, steps_per_tick=1, seed=1)


def loss(**keys):
    return make_fault(**{"unit": "wheel.1", "kind": "loss", "effectiveness": 0.5, "at_s": 1.0, **keys})


def level_at(timeline, t_s, unit="wheel.1"):
    """Level of the one fault of a unit on the step that begins at t_s; None when it does not act."""
    step = round(t_s / STEP_S)
    chain = timeline.chains[unit]
    if step >= chain.next_edge:
        chain.refresh(step)
    for entry in chain.active:
        entry.bring_to((step + 0.5) * STEP_S)
    return next((entry.now.level for entry in chain.active), None)


def step_of(t_s):
    return round(t_s / STEP_S)


def told(timeline):
    return [(event.phase, round(event.t_s, 9), event.by) for event in timeline.take_events(10**9)]


@pytest.mark.parametrize(
    ("latch", "by_reset", "by_cycle"),
    [(None, False, False), ("until_reset", True, True), ("until_power_cycle", False, True), (True, False, False)],
)
def test_each_latch_opens_to_what_it_names(latch, by_reset, by_cycle):
    """A power cycle does all that a reset does; a fault without latch or with `true` stays as it is through both."""
    for opens, action, by in ((by_reset, "reset_unit", "reset"), (by_cycle, "power_cycle_unit", "power cycle")):
        timeline = make_timeline(loss(latch=latch))
        assert level_at(timeline, 5.0) == 1.0
        ids = getattr(timeline, action)("wheel.1", step_of(6.0))
        assert ids == (("faults[0]",) if opens else ())
        assert level_at(timeline, 6.0) == (None if opens else 1.0)
        expected = [("onset", 1.0, "")] + ([("cleared", 6.0, by)] if opens else [])
        assert told(timeline) == expected


def test_until_s_is_when_the_cause_of_a_latched_fault_is_gone():
    """It does not end the fault; before it a reset helps nothing, from it on a reset heals."""
    timeline = make_timeline(loss(latch="until_reset", until_s=10.0))
    assert level_at(timeline, 5.0) == 1.0
    assert timeline.reset_unit("wheel.1", step_of(9.9)) == ()
    assert level_at(timeline, 9.9) == level_at(timeline, 10.0) == level_at(timeline, 500.0) == 1.0
    assert timeline.reset_unit("wheel.1", step_of(600.0)) == ("faults[0]",)
    assert level_at(timeline, 600.0) is None
    assert told(timeline) == [("onset", 1.0, ""), ("cleared", 600.0, "reset")]
    early = make_timeline(loss(latch="until_reset", until_s=10.0))
    assert early.reset_unit("wheel.1", step_of(10.0)) == ("faults[0]",)


def test_a_latch_keeps_the_highest_level():
    """A pulse stays, a window stays at its top, one that is caught on its way up goes on up."""
    pulse = make_timeline(loss(latch="until_power_cycle", length_s=0.5))
    assert [level_at(pulse, t) for t in (0.5, 1.0, 2.0, 99.0)] == [None, 1.0, 1.0, 1.0]
    window = make_timeline(loss(latch="until_power_cycle", rise_s=2.0, length_s=1.0, fall_s=2.0, profile="window"))
    levels = [level_at(window, t) for t in (1.0, 2.0, 3.5, 5.0, 50.0)]
    assert levels == [pytest.approx(0.025), pytest.approx(0.525), 1.0, 1.0, 1.0]
    assert (
        pulse.power_cycle_unit("wheel.1", step_of(100.0)) == window.power_cycle_unit("wheel.1", 1000) == ("faults[0]",)
    )
    without = make_timeline(loss(length_s=0.5))
    assert level_at(without, 2.0) is None


def test_one_that_comes_again_is_caught_again():
    """Latch-ups of 0.5 s every 10 s: from the first one on, until a power cycle; then free until the next one."""
    timeline = make_timeline(loss(latch="until_power_cycle", period_s=10.0, duty=0.05))
    assert [level_at(timeline, t) for t in (1.0, 2.0, 6.0)] == [1.0, 1.0, 1.0]
    assert timeline.power_cycle_unit("wheel.1", step_of(6.0)) == ("faults[0]",)
    assert [level_at(timeline, t) for t in (6.0, 10.9, 11.0, 12.0, 30.0)] == [0.0, 0.0, 1.0, 1.0, 1.0]
    assert timeline.power_cycle_unit("wheel.1", step_of(31.2)) == ("faults[0]",)  # while the cause is there
    assert level_at(timeline, 31.2) == 1.0
    assert timeline.reset_unit("wheel.1", step_of(35.0)) == ()
    assert [(phase, t) for phase, t, _ in told(timeline)] == [("onset", 1.0), ("cleared", 6.0), ("cleared", 31.2)]


def test_the_test_bench_clears_whatever_is_latched():
    """fault.clear is the engineer's hand: every latch, before the cause is gone as well."""
    for latch, until_s in ((True, None), ("until_reset", 50.0), ("until_power_cycle", None)):
        timeline = make_timeline(loss(latch=latch, until_s=until_s))
        assert level_at(timeline, 3.0) == 1.0
        assert timeline.clear(step_of(4.0), id="faults[0]") == ("faults[0]",)
        assert level_at(timeline, 4.0) is None
        assert told(timeline) == [("onset", 1.0, ""), ("cleared", 4.0, "")]


def test_what_waits_is_over_or_is_elsewhere_is_not_reset():
    """A fault of another unit, one that has not begun, one that has ended."""
    timeline = make_timeline(
        loss(latch="until_reset", id="later", at_s=50.0),
        loss(latch="until_reset", id="other", unit="wheel.2"),
        loss(latch="until_reset", id="mine"),
    )
    assert timeline.reset_unit("wheel.1", step_of(5.0)) == ("mine",)
    assert timeline.reset_unit("wheel.1", step_of(6.0)) == ()
    assert [(item.id, item.state) for item in timeline.list(step_of(60.0))] == [
        ("later", "active"), ("other", "active"), ("mine", "over"),
    ]  # fmt: skip


def test_an_idle_motor_is_healed_by_a_reset_and_a_dead_one_is_not():
    """The difference between the two; with a latch an idle motor waits for what that names."""
    idle = {"unit": "wheel.1", "kind": "idle", "at_s": 1.0}
    for action in ("reset_unit", "power_cycle_unit"):
        assert getattr(make_timeline(make_fault(**idle)), action)("wheel.1", 50) == ("faults[0]",)
        assert getattr(make_timeline(make_fault(**{**idle, "kind": "dead"})), action)("wheel.1", 50) == ()
    assert make_timeline(make_fault(**idle, until_s=90.0)).reset_unit("wheel.1", 50) == ("faults[0]",)
    assert make_timeline(make_fault(**idle, latch="until_power_cycle")).reset_unit("wheel.1", 50) == ()
    assert make_timeline(make_fault(**idle, latch=True)).power_cycle_unit("wheel.1", 50) == ()


def test_a_reset_wheel_has_its_torque_back_on_that_very_step():
    """In the plant: no torque while the motor idles, all of it from the step of the reset on, one event for each change."""
    plant = Plant(PlantConfig(body=BODY, wheels=WHEELS), (make_fault(unit="wheel.2", kind="idle", at_s=0.5),), 0.1, 1)
    torques, events = [], []
    for tick in range(20):
        if tick == 12:
            assert plant._timeline.reset_unit("wheel.2", plant._step) == ("faults[0]",)
            plant._wheels.look_again()
        events += plant.sample().events
        plant.step((0.0, 0.02, 0.0, 0.0))
        torques.append(plant.truth().tau_rw_true_nm[1])
    assert torques == [pytest.approx(0.0 if 5 <= tick < 12 else 0.02, abs=1e-15) for tick in range(20)]
    assert [(e.tick, e.phase, e.by) for e in events] == [
        (5, "onset", ""), (5, "effect", ""), (12, "cleared", "reset"),
    ]  # fmt: skip


def test_friction_of_low_speed_heals_by_running_fast():
    """300 s above 150 rad/s in all, not in one piece; slower does not count; then it is over, and the log says why."""
    timeline = FaultTimeline(
        (make_fault(unit="wheel.1", kind="low_speed_friction", at_s=0.0),), step_s=1.0, steps_per_tick=1, seed=1
    )
    chain = timeline.chains["wheel.1"]
    speeds = [149.0] * 400 + [151.0] * 100 + [0.0] * 50 + [-151.0] * 250
    acts = []
    for step, speed in enumerate(speeds):
        if step >= chain.next_edge:
            chain.refresh(step)
        for entry in chain.active:
            entry.bring_to(step + 0.5, speed)
            entry.bring_to(step + 0.5, speed)  # looked at twice on one step: time passes once
            assert not entry.is_settled()
        acts.append(bool(chain.active))
    assert acts.index(False) == pytest.approx(400 + 100 + 50 + 200, abs=1)
    assert not any(acts[acts.index(False) :])
    (onset, cleared) = timeline.take_events(10_000)
    assert (onset.phase, cleared.phase) == ("onset", "cleared")
    assert cleared.by == "running above 150 rad/s for 300 s"


# -- keys ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("latch", [True, "until_reset", "until_power_cycle"])
def test_a_latch_reads_back_as_itself(latch):
    """As YAML and JSON have it: true is true, not a word."""
    fault = loss(latch=latch)
    assert fault.latch == latch
    assert plain(fault)["latch"] == latch
    assert build(Fault, plain(fault), "x") == fault
    assert "latch" not in plain(loss())


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"latch": "until_rest"}, 'did you mean "until_reset"? there are: true, until_reset, until_power_cycle'),
        ({"latch": False}, "false is not known; there are: true, until_reset, until_power_cycle"),
        ({"latch": 1}, "1 is not known; there are: true, until_reset"),
        ({"latch": "True"}, '"True" is not known;'),
        (
            {"unit": "gyro.x", "kind": "dead", "latch": True},
            "gyro fault dead has no use for latch; it takes no magnitude",
        ),
    ],
)
def test_a_wrong_latch_is_refused(keys, said):
    """What there is instead, and that only wheels are reset."""
    (problem,) = Reading(Fault, {"unit": "wheel.1", "kind": "dead", "at_s": 1.0, **keys}).problems
    assert problem.path == ("latch",)
    assert said in problem.message


def test_an_end_beside_a_latch_that_has_none_is_refused():
    """`true` stays to the end of the run: two keys that say two things."""
    with pytest.raises(ConfigError, match="until_s: a fault with latch: true stays to the end of the run"):
        make_timeline(loss(latch=True, until_s=5.0))
