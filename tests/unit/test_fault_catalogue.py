"""The catalogue of a wheel's faults: what each changes, its defaults and ranges, how several compose, and its page."""

from __future__ import annotations

import itertools
import math
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from bus.errors import ConfigError
from bus.settings import build, plain
from plant_server.config import BodyConfig, PlantConfig, WheelConfig
from plant_server.faults import KINDS, Fault, FaultTimeline, make_fault
from plant_server.faults.effects import WheelDisturbance
from tools.design.fault_catalogue import PAGE, format_page
from tools.design.fault_pictures import PICTURES, name_picture, show_fault, trace_fault

STEP_S = 0.1
PAPER_KINDS = ("loss", "bias", "stuck_torque", "dead", "silent")
# What a kind with its defaults makes of a healthy wheel once it is fully there: spec's default column, in SI.
FULL = {
    "gain_kt": {"torque_gain": 0.6}, "gain_driver": {"driver_gain": 0.6}, "friction_coulomb": {"coulomb_gain": 3.0},
    "friction_viscous": {"viscous_gain": 2.5}, "friction_extra": {"friction_nm": 0.003},
    "drag_burst": {"friction_nm": 0.004, "offset_nm": None}, "low_speed_friction": {"static_nm": 0.002},
    "seize": {"seize_nm": 0.8}, "idle": {"motor_on": False}, "runaway": {"is_stuck": True, "stuck_current_a": 0.95},
    "bias_torque": {"offset_nm": 0.002}, "jump": {"offset_nm": 0.02}, "bus_sag": {"has_bus": True, "bus_v": 14.0},
    "tach_bias": {"speed_offset_rad_s": 5.0}, "tach_scale": {"speed_gain": 0.9}, "tach_freeze": {"speed_frozen": True},
    "tach_quantise": {"speed_lsb_rad_s": 1.0}, "current_bias": {"current_offset_a": 0.05},
    "current_scale": {"current_gain": 0.9}, "current_freeze": {"current_frozen": True},
    "current_quantise": {"current_lsb_a": 0.02}, "late": {"late_ticks": 5}, "frozen_counter": {"counter_frozen": True},
    "total_failure": {"motor_on": False, "silent": True},
}  # fmt: skip
CHANCE = {"tach_dropout": {"speed_gain": 0.0}, "current_dropout": {"current_gain": 0.0}, "drop": {"silent": True}}
RANGES = {  # inside, outside
    ("gain_kt", "torque_gain"): ([0.2, 0.99], [0.19, 1.01]),
    ("gain_driver", "driver_gain"): ([-1.0, 0.0, 1.2], [-1.01, 1.21]),
    ("friction_coulomb", "coulomb_gain"): ([1.1, 10.0], [0.9, 10.1]),
    ("friction_viscous", "viscous_gain"): ([1.1, 5.0], [0.9, 5.1]),
    ("friction_extra", "friction_nm"): ([0.0002, 0.01], [0.0001, 0.011]),
    ("drag_burst", "friction_nm"): ([0.0002, 0.01], [0.0001, 0.011]),
    ("seize", "torque_nm"): ([0.3, 2.0], [0.29, 2.1]),
    ("bias_torque", "torque_nm"): ([-0.01, 0.01], [-0.011, 0.011]),
    ("jump", "torque_nm"): ([-0.05, 0.005, 0.05], [-0.051, 0.051]),
    ("runaway", "current_a"): ([-0.95, 0.95], [-5.1, 5.1]),
}


def motor_fault(kind, **keys):
    return make_fault(**{"unit": "wheel.1", "kind": kind, "at_s": 0.0, **keys})


def compose(*faults, t_s=50.0, speed_rad_s=10.0, seed=1):
    """What faults make of a wheel at a moment, as a wheel's model does it: those that act, in the order of the chain."""
    timeline = FaultTimeline(faults, step_s=STEP_S, steps_per_tick=1, seed=seed)
    chain = timeline.chains["wheel.1"]
    chain.refresh(round(t_s / STEP_S))
    wheel = WheelDisturbance()
    for entry in chain.active:
        entry.bring_to(t_s + 0.5 * STEP_S, speed_rad_s)
        entry.effect.disturb(wheel, entry.now)
    return wheel


def changes_of(wheel):
    healthy = WheelDisturbance()
    return {
        name: getattr(wheel, name)
        for name in WheelDisturbance.__slots__
        if getattr(wheel, name) != getattr(healthy, name)
    }


def test_the_catalogue_is_whole():
    """Every kind of wheel fault is in one of the tables of this file."""
    assert sorted(KINDS["wheel"]) == sorted([*PAPER_KINDS, *FULL, *CHANCE])


@pytest.mark.parametrize("kind", FULL)
def test_a_kind_changes_what_it_says_and_nothing_else(kind):
    """Fully there, with its defaults; and nothing any more after its end."""
    settings = {"profile": "step"}
    changes = changes_of(compose(motor_fault(kind, **settings, until_s=60.0)))
    assert changes.keys() == FULL[kind].keys()
    assert all(changes[name] == pytest.approx(value) for name, value in FULL[kind].items() if value is not None)
    assert changes_of(compose(motor_fault(kind, **settings, until_s=60.0), t_s=61.0)) == {}


@pytest.mark.parametrize("kind", [kind for kind in FULL if KINDS["wheel"][kind].rises and kind != "drag_burst"])
def test_half_a_fault_is_half_the_way_from_the_healthy_value(kind):
    """Half way up a line: base + (value - base) / 2."""
    changes = changes_of(compose(motor_fault(kind, rise_s=100.0), t_s=50.0 - 0.5 * STEP_S))
    healthy = WheelDisturbance()
    for name, value in FULL[kind].items():
        base = getattr(healthy, name)
        assert changes[name] == pytest.approx(base + 0.5 * (value - base), rel=1e-12)


@pytest.mark.parametrize("kind", CHANCE)
def test_what_falls_by_chance_falls_as_often_as_it_says(kind):
    """Of 20000 readings one in ten (5 sigma), each only what it says; a look that is repeated draws nothing anew."""
    timeline = FaultTimeline((motor_fault(kind),), step_s=STEP_S, steps_per_tick=1, seed=4)
    chain = timeline.chains["wheel.1"]
    chain.refresh(0)
    (entry,) = chain.active
    hits = 0
    for step in range(20_000):
        seen = []
        for _ in range(2):
            entry.bring_to((step + 0.5) * STEP_S)
            wheel = WheelDisturbance()
            entry.effect.disturb(wheel, entry.now)
            seen.append(changes_of(wheel))
        assert seen[0] == seen[1]
        assert seen[0] in ({}, CHANCE[kind])
        hits += bool(seen[0])
    assert abs(hits - 2000) < 5 * math.sqrt(1800)


def test_bursts_of_drag_come_with_noise():
    """3 s of 11 s, with Gaussian torque noise of 0.5 mN m while they last and none between."""
    timeline = FaultTimeline((motor_fault("drag_burst"),), step_s=0.01, steps_per_tick=1, seed=4)
    chain = timeline.chains["wheel.1"]
    chain.refresh(0)
    (entry,) = chain.active
    noise, bursts = [], []
    for step in range(110_000):
        entry.bring_to((step + 0.5) * 0.01)
        wheel = WheelDisturbance()
        entry.effect.disturb(wheel, entry.now)
        bursts.append(wheel.friction_nm == 0.004)
        if bursts[-1]:
            noise.append(wheel.offset_nm)
        else:
            assert wheel.offset_nm == wheel.friction_nm == 0.0
    assert np.mean(bursts) == pytest.approx(3.0 / 11.0, abs=1e-3)
    assert np.std(noise) == pytest.approx(0.0005, rel=0.02)
    assert abs(np.mean(noise)) < 5 * 0.0005 / math.sqrt(len(noise))
    assert abs(np.corrcoef(noise[:-1], noise[1:])[0, 1]) < 0.02


def test_friction_of_low_speed_is_there_below_50_rad_s_alone():
    """Either way round."""
    fault = motor_fault("low_speed_friction")
    for speed, there in ((0.0, True), (-49.9, True), (49.9, True), (50.1, False), (-200.0, False)):
        assert changes_of(compose(fault, speed_rad_s=speed)) == ({"static_nm": 0.002} if there else {})


@pytest.mark.parametrize(("kind", "key"), RANGES)
def test_ranges_are_those_of_the_specification(kind, key):
    """The borders are in, what is beyond is refused at its key with what is allowed."""
    inside, outside = RANGES[kind, key]
    for value in inside:
        fault = motor_fault(kind, **{key: value})
        assert build(Fault, plain(fault), "x") == fault
    for value in outside:
        with pytest.raises(ConfigError, match=f"{key}: .* out of range; allowed: "):
            motor_fault(kind, **{key: value})


@pytest.mark.parametrize("kind", [*FULL, *CHANCE])
def test_a_kind_needs_no_magnitude(kind):
    """Unit, kind and onset are enough, and read back as the same."""
    fault = motor_fault(kind)
    assert build(Fault, plain(fault), "x") == fault


# -- several -------------------------------------------------------------------------------------------------------


def test_gains_multiply_and_torques_add_in_any_order():
    """Six orders of onset of three faults give one and the same wheel, for each group of fields."""
    groups = [
        ([("gain_kt", {"torque_gain": v}) for v in (0.5, 0.8, 0.9)], "torque_gain", 0.36),
        ([("gain_driver", {"driver_gain": v}) for v in (0.5, -1.0, 1.2)], "driver_gain", -0.6),
        ([("friction_coulomb", {"coulomb_gain": v}) for v in (2.0, 3.0, 1.5)], "coulomb_gain", 9.0),
        ([("friction_extra", {"friction_nm": v}) for v in (0.001, 0.002, 0.003)], "friction_nm", 0.006),
        ([("bias_torque", {"torque_nm": v}) for v in (0.001, -0.003, 0.004)], "offset_nm", 0.002),
        ([("seize", {"torque_nm": v}) for v in (0.3, 0.4, 0.5)], "seize_nm", 1.2),
        ([("tach_scale", {"factor": v}) for v in (0.5, 2.0, 3.0)], "speed_gain", 3.0),
        ([("tach_bias", {"speed_rad_s": v}) for v in (1.0, 2.0, -5.0)], "speed_offset_rad_s", -2.0),
        ([("late", {"ticks": v}) for v in (1, 2, 3)], "late_ticks", 6),
        ([("tach_quantise", {"step_rad_s": v}) for v in (1.0, 3.0, 2.0)], "speed_lsb_rad_s", 3.0),
    ]
    for faults, name, expected in groups:
        for order in itertools.permutations(faults):
            wheel = compose(*(motor_fault(kind, at_s=float(i), **keys) for i, (kind, keys) in enumerate(order)))
            assert changes_of(wheel) == {name: pytest.approx(expected, rel=1e-12)}


def test_the_last_current_and_the_last_bus_voltage_stand():
    """By onset, not by their place in the scenario."""
    up, down = motor_fault("runaway", at_s=2.0), motor_fault("runaway", current_a=-0.5, at_s=1.0)
    assert compose(up, down).stuck_current_a == compose(down, up).stuck_current_a == 0.95
    low, lower = motor_fault("bus_sag", at_s=1.0), motor_fault("bus_sag", voltage_v=10.0, at_s=2.0)
    assert compose(low, lower).bus_v == compose(lower, low).bus_v == 10.0


def test_of_a_held_torque_and_a_held_current_the_last_stands():
    """A runaway after a stuck torque gives the current; a stuck torque after a runaway gives the torque."""
    stuck = {"kind": "stuck_torque", "torque_nm": 0.015}
    runaway = changes_of(compose(motor_fault(**stuck), motor_fault("runaway", at_s=1.0)))
    assert runaway == {"is_stuck": True, "stuck_current_a": 0.95}
    wheel = compose(motor_fault("runaway"), motor_fault(**stuck, at_s=1.0))
    assert (wheel.gain, wheel.offset_nm) == (0.0, 0.015)


def test_torques_of_the_rotor_are_not_scaled_by_faults_of_the_motor():
    """A bias of the motor is lost with the motor's torque, one of the rotor and a jump are not, whenever they come."""
    dead, half = {"kind": "dead"}, {"kind": "loss", "effectiveness": 0.5}
    for motor, scale in ((dead, 0.0), (half, 0.5)):
        for onsets in ((0.0, 1.0), (1.0, 0.0)):
            wheel = compose(motor_fault(**motor, at_s=onsets[0]), motor_fault("bias_torque", at_s=onsets[1]))
            assert (wheel.gain, wheel.offset_nm) == (scale, 0.002)
        earlier = compose(motor_fault("bias", torque_nm=0.002), motor_fault(**motor, at_s=1.0))
        assert (earlier.gain, earlier.offset_nm) == (scale, pytest.approx(0.002 * scale))
        later = compose(motor_fault("bias", torque_nm=0.002, at_s=1.0), motor_fault(**motor))
        assert (later.gain, later.offset_nm) == (scale, 0.002)


def test_a_lost_reading_is_zero_whatever_else_is_wrong_with_it():
    """A bias that comes later does not show in it."""
    wheel = compose(motor_fault("tach_dropout", probability=1.0), motor_fault("tach_bias", at_s=1.0))
    assert (wheel.speed_gain, wheel.speed_offset_rad_s) == (0.0, 0.0)


# -- futile --------------------------------------------------------------------------------------------------------

BODY = BodyConfig(inertia_kgm2=((40.0, 0.0, 0.0), (0.0, 40.0, 0.0), (0.0, 0.0, 40.0)))


def make_plant_config(**settings):
    return PlantConfig(body=BODY, wheels=tuple(WheelConfig(mount=m, **settings) for m in ("x", "y", "z", "skew")))


@pytest.mark.parametrize("kind", [*FULL, *CHANCE])
def test_a_fault_of_what_an_ideal_wheel_has_not_is_refused(kind):
    """The driver, the motor, the supply, the lubricant, friction that is 0; on a wheel that has them all are taken."""
    needs = {
        "gain_kt",
        "gain_driver",
        "runaway",
        "bus_sag",
        "low_speed_friction",
        "friction_coulomb",
        "friction_viscous",
    }
    problems = motor_fault(kind, unit="wheel.3").check(make_plant_config())
    assert [problem.path for problem in problems] == ([("kind",)] if kind in needs else [])
    if kind in needs:
        assert "plant.wheels[2]" in problems[0].message
    ideal, motor = WheelConfig(mount="x"), SimpleNamespace(model="ithaco")
    mixed = SimpleNamespace(wheels=(ideal, ideal, motor, ideal))
    assert motor_fault(kind, unit="wheel.3").check(mixed) == []
    assert motor_fault(kind).check(None) == []


def test_a_factor_on_friction_bites_where_there_is_friction():
    """An ideal wheel with a coefficient has something to scale."""
    plant = make_plant_config(coulomb_nm=0.001, viscous_nm_s=1e-5)
    assert motor_fault("friction_coulomb").check(plant) == motor_fault("friction_viscous").check(plant) == []


@pytest.mark.parametrize(
    ("kind", "key", "value"),
    [
        ("gain_kt", "torque_gain", 1.0), ("gain_driver", "driver_gain", 1.0), ("friction_coulomb", "coulomb_gain", 1.0),
        ("friction_viscous", "viscous_gain", 1.0), ("bias_torque", "torque_nm", 0.0), ("jump", "torque_nm", 0.0),
        ("tach_bias", "speed_rad_s", 0.0), ("tach_scale", "factor", 1.0), ("current_bias", "current_a", 0.0),
        ("current_scale", "factor", 1.0),
    ],
)  # fmt: skip
def test_magnitudes_that_change_nothing_are_refused(kind, key, value):
    """Factors of 1 and offsets of 0, whatever the plant; the message names the key."""
    with pytest.raises(ConfigError, match=f"has no effect; give (it|{key}) another value"):
        motor_fault(kind, **{key: value})


# -- page ----------------------------------------------------------------------------------------------------------


def test_the_page_is_up_to_date():
    """docs/faults.md is what `python -P -m tools.design.fault_catalogue` writes."""
    assert PAGE.read_text(encoding="utf-8") == format_page()


def test_every_kind_is_on_the_page_with_its_picture_and_its_keys():
    """One section for each kind, each magnitude in it, a picture that is there, and no picture of anything else."""
    text = PAGE.read_text(encoding="utf-8")
    sections = re.split(r"^### ", text, flags=re.MULTILINE)
    pictures = set()
    for family, kinds in KINDS.items():
        for kind, cls in kinds.items():
            (section,) = [part for part in sections if part.startswith(f'<a id="{family}-{kind}"></a>`{kind}`\n')]
            assert all(f"| `{key}` |" in section for key in cls.__dataclass_fields__)
            picture = name_picture(cls)
            assert f"(img/faults/{picture})" in section
            pictures.add(picture)
    assert {path.name for path in PICTURES.iterdir()} == pictures
    for name in pictures:
        data = (PICTURES / name).read_bytes()
        assert data.startswith(b"\x89PNG")
        assert len(data) < 20_000


@pytest.mark.parametrize(("family", "kind"), [(family, kind) for family, kinds in KINDS.items() for kind in kinds])
def test_every_picture_shows_what_the_fault_does(family, kind):
    """The observable is the same without the fault before its onset, and another at some time while it acts."""
    times, healthy, faulty, label = trace_fault(show_fault(KINDS[family][kind]))
    differs = [a != b for a, b in zip(healthy, faulty, strict=True)]
    assert label
    before = [d for t, d, a in zip(times, differs, healthy, strict=True) if t < 10.0 and not math.isnan(a)]
    assert not any(before)
    assert any(d for t, d in zip(times, differs, strict=True) if 10.0 < t < 50.0)


def test_examples_on_the_page_are_faults():
    """Every line of the example reads as a fault."""

    text = PAGE.read_text(encoding="utf-8")
    block = text.split("```yaml\n")[1].split("```")[0]
    faults = [build(Fault, item, "page") for item in yaml.safe_load(block)["faults"]]
    assert [fault.kind for fault in faults] == ["gain_kt", "friction_coulomb", "jump", "runaway", "loss"]
    assert faults[3].latch == "until_power_cycle"
    assert not any(fault.check() for fault in faults)


def test_links_of_the_page_lead_somewhere():
    """Every anchor of the overview is the heading of a section."""
    text = Path(PAGE).read_text(encoding="utf-8")
    assert set(re.findall(r"\]\(#([\w-]+)\)", text)) == set(re.findall(r'<a id="([\w-]+)">', text))
