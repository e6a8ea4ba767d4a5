"""The kinds of fault, what is refused and how, what the timeline announces, and when a fault has had an effect."""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from bus.errors import ConfigError
from bus.settings import Reading, build, plain
from plant_server.config import BodyConfig, GyroConfig, PlantConfig, StarTrackerConfig, WheelConfig
from plant_server.faults import KINDS, Fault, check_faults, fault_ids, make_fault
from plant_server.plant import Plant

ROOT = Path(__file__).resolve().parents[2]
J = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))
EXAMPLES = {  # magnitudes for every kind
    "loss": {"effectiveness": 0.5}, "bias": {"torque_nm": 0.01}, "stuck_torque": {"torque_nm": 0.02}, "dead": {},
    "silent": {}, "constant": {"rate_rad_s": 0.01}, "periodic": {"rate_rad_s": 0.01, "frequency_rad_s": 2.0},
    "ramp": {"slope_rad_s2": 1e-3}, "stuck": {}, "noise": {"factor": 5.0}, "scale": {"factor": 0.1},
    "spikes": {"rate_rad_s": 0.05, "probability": 0.5}, "intermittent": {"probability": 0.5}, "dropout": {},
    "garbage": {}, "half_rate": {}, "late": {}, "frozen": {}, "misaligned": {}, "rotating": {"rate_deg_s": 1.0},
    "torque_noise": {},
    "idle": {}, "jump": {"torque_nm": 0.01}, "bias_torque": {"torque_nm": 0.01}, "total_failure": {},
}  # fmt: skip
UNIT_OF = {"wheel": "wheel.2", "gyro": "gyro.y", "star_tracker": "star_tracker"}
# the kinds of a plant of ideal wheels; other ones of wheels: test_fault_catalogue.py, those of the bus: test_wire.py
EVERY = [(unit, kind) for family, unit in UNIT_OF.items() for kind in KINDS[family] if kind in EXAMPLES]
EVERY.remove(("wheel.2", "late"))  # of its telemetry frames, which other units have by the same name


def make_plant(faults=(), tick_s=0.1, preset="tactical"):
    wheels = tuple(WheelConfig(mount=mount) for mount in ("x", "y", "z", "skew"))
    config = PlantConfig(
        body=BodyConfig(inertia_kgm2=J, rate_deg_s=(1.0, -2.0, 3.0)),
        wheels=wheels,
        gyro=GyroConfig(preset=preset),
        star_tracker=StarTrackerConfig(noise_arcsec=(10.0, 10.0, 50.0)),
    )
    return Plant(config, tuple(faults), tick_s, 7)


def run(plant, ticks=40):
    """Samples and applied wheel torques of a few ticks."""
    history = []
    for k in range(ticks):
        samples = plant.sample()
        plant.step((0.02, -0.03 + 0.001 * k, 0.01, 0.02))
        history.append((samples, plant.truth().tau_rw_true_nm))
    return history


@pytest.mark.parametrize(("unit", "kind"), EVERY)
def test_every_kind_of_the_catalogue_bites_on_its_unit_alone(unit, kind):
    """Against a run without the fault: the same before onset, different after, and no other unit's output differs.

    This is the promise that no accepted fault is silently ignored, and that adding one shifts nobody else's noise.
    """
    fault = make_fault(unit=unit, kind=kind, at_s=1.0, **EXAMPLES[kind])
    healthy, faulty = run(make_plant()), run(make_plant([fault]))

    def report(samples, torque, name):
        if name.startswith("wheel"):
            i = int(name[-1]) - 1
            return (torque[i], samples.wheel_silent[i])
        if name.startswith("gyro"):
            i = "xyz".index(name[-1])
            return None if samples.gyro_silent[i] else samples.gyro_rate_rad_s[i]
        return samples.star

    units = ["star_tracker", "gyro.x", "gyro.y", "gyro.z", "wheel.1", "wheel.2", "wheel.3", "wheel.4"]
    if unit.startswith("wheel") and kind != "silent":
        units = [name for name in units if name.startswith("wheel")]  # the body really moves differently then
    for name in units:
        differs = [report(*a, name) != report(*b, name) for a, b in zip(healthy, faulty, strict=True)]
        assert not any(differs[:10])
        assert any(differs[10:]) == (name == unit)
    events = [(e.tick, e.phase) for samples, _ in faulty for e in samples.events if e.phase != "end"]
    first = next(
        k for k, (a, b) in enumerate(zip(healthy, faulty, strict=True)) if report(*a, unit) != report(*b, unit)
    )
    assert events == [(10, "onset"), (first, "effect")]


def test_gyro_as_a_unit_means_all_three_axes_once():
    """One fault, one event, three axes."""
    history = run(make_plant([make_fault(unit="gyro", kind="dead", at_s=1.0, until_s=2.0)]))
    assert [s.gyro_silent for s, _ in history] == [(False,) * 3] * 10 + [(True,) * 3] * 10 + [(False,) * 3] * 20
    events = [e for s, _ in history for e in s.events]
    assert [(e.tick, e.id, e.fault.unit, e.phase) for e in events] == [
        (10, "faults[0]", "gyro", "onset"),
        (10, "faults[0]", "gyro", "effect"),
        (20, "faults[0]", "gyro", "end"),
    ]


def problems_of(**keys):
    """Key paths and messages of everything wrong with the keys of one fault, read and then checked."""
    reading = Reading(Fault, keys)
    problems = list(reading.problems)
    if not problems:
        problems = reading.value.check()
    return [(problem.path, problem.message) for problem in problems]


def test_a_unit_misspelt_is_named_with_the_near_miss():
    """Unit and kind: what is known, and what was probably meant; a kind is one of its unit's family."""
    ((path, message),) = problems_of(unit="wheel.5", kind="dead", at_s=0.0)
    assert path == ("unit",)
    assert 'did you mean "wheel.' in message
    assert "wheel.1, wheel.2" in message
    ((path, message),) = problems_of(unit="wheel.1", kind="stuck_torqe", at_s=0.0)
    assert path == ("kind",)
    assert 'did you mean "stuck_torque"?' in message
    ((path, message),) = problems_of(unit="gyro.x", kind="loss", at_s=0.0)
    assert "there are: constant, periodic" in message


@pytest.mark.parametrize(
    ("settings", "path", "word"),
    [
        ({"kind": "loss"}, ("effectiveness",), "is missing"),
        ({"kind": "dead", "torque_nm": 0.1}, ("torque_nm",), "no use for torque_nm; it takes profile, rise_s"),
        ({"kind": "loss", "effectiveness": 1.5}, ("effectiveness",), "allowed: >= 0, < 1"),
        ({"kind": "loss", "effectiveness": math.nan}, ("effectiveness",), "finite"),
        ({"kind": "bias", "torque_nm": math.inf}, ("torque_nm",), "finite"),
        ({"kind": "bias", "torqe_nm": 0.1}, ("torqe_nm",), 'did you mean "torque_nm" [N m]?'),
        ({"kind": "dead", "until_s": 5.0}, ("until_s",), "not after the onset"),
        ({"kind": "dead", "at_s": math.nan}, ("at_s",), "finite"),
        ({"kind": "dead", "rise_s": -1.0}, ("rise_s",), "allowed: >= 0"),
        ({"kind": "silent", "rise_s": 1.0}, ("rise_s",), "no use for rise_s"),
        ({"kind": "dead", "phase": "absolute"}, ("phase",), "no use for phase"),
        ({"kind": "dead", "profile": "stp"}, ("profile",), 'did you mean "step"?'),
        ({"kind": "dead", "profile": "linear"}, ("rise_s",), "is missing"),
        ({"unit": "gyro.x", "kind": "periodic", "rate_rad_s": 0.1}, ("frequency_rad_s",), "is missing"),
        (
            {"unit": "gyro.x", "kind": "periodic", "rate_rad_s": 0.1, "frequency_rad_s": -1.0},
            ("frequency_rad_s",),
            "> 0",
        ),
        ({"unit": "gyro.x", "kind": "noise", "factor": -2.0}, ("factor",), ">= 0"),
        ({"unit": "star_tracker", "kind": "dropout", "probability": 2.0}, ("probability",), "allowed: > 0, <= 1"),
        ({"kind": "dead", "id": " "}, ("id",), "1 to 80"),
    ],
)
def test_what_is_wrong_is_refused_where_it_is(settings, path, word):
    """Each wrong setting gives one problem, at its key, saying what is wrong."""
    keys = {"unit": "wheel.1", "at_s": 10.0, **settings}
    ((found, message),) = problems_of(**keys)[:1] if "torqe_nm" in keys else problems_of(**keys)
    assert found == path
    assert word in message
    with pytest.raises(ConfigError, match=path[0]):
        make_fault(**keys)


def test_all_problems_of_one_fault_come_at_once_and_its_sound_keys_are_known():
    """A wrong magnitude hides neither a wrong time nor a foreign key; what is sound can be checked further."""
    reading = Reading(
        Fault, {"unit": "wheel.1", "kind": "loss", "effectiveness": 7, "at_s": -1, "torque_nm": 1, "until_s": 3}
    )
    assert sorted(problem.path for problem in reading.problems) == [("at_s",), ("effectiveness",), ("torque_nm",)]
    assert reading.parts[("until_s",)] == 3.0
    assert reading.parts[("unit",)] == "wheel.1"
    assert () not in reading.parts


@pytest.mark.parametrize(
    "keys",
    [
        {"unit": "wheel.1", "kind": "bias", "torque_nm": 0.0},
        {"unit": "wheel.1", "kind": "loss", "effectiveness": 1.0},
        {"unit": "gyro.x", "kind": "constant", "rate_rad_s": 0.0},
        {"unit": "gyro.x", "kind": "periodic", "rate_rad_s": 0.0, "frequency_rad_s": 1.0},
        {"unit": "gyro.x", "kind": "ramp", "slope_rad_s2": 0.0},
        {"unit": "gyro.x", "kind": "noise", "factor": 1.0},
        {"unit": "gyro.x", "kind": "scale", "factor": 0.0},
        {"unit": "gyro.x", "kind": "spikes", "rate_rad_s": 0.0, "probability": 0.5},
        {"unit": "gyro.x", "kind": "spikes", "rate_rad_s": 0.1, "probability": 0.0},
        {"unit": "gyro.x", "kind": "intermittent", "probability": 0.0},
        {"unit": "star_tracker", "kind": "dropout", "probability": 0.0},
    ],
    ids=lambda keys: "-".join(str(word) for word in keys.values()),
)
def test_a_fault_that_can_have_no_effect_is_refused(keys):
    """Whatever the plant and the run: zero magnitudes, a loss of nothing, a probability of 0."""
    assert len(problems_of(**keys, at_s=0.0)) == 1


def test_more_noise_on_a_gyro_without_noise_is_refused():
    """What a fault can do depends on the plant: the same fault is sound on a gyro that has an angle random walk."""
    noise = make_fault(unit="gyro.z", kind="noise", factor=10.0, at_s=0.0)
    make_plant([noise])
    with pytest.raises(ConfigError, match="no angle random walk"):
        make_plant([noise], preset="ideal")


@pytest.mark.parametrize("name", ["wheel.1", "gyro", "star_tracker", "bus", "all"])
def test_an_id_is_not_what_a_unit_is_called_by(name):
    """Who clears by a name means the unit: such an id could never be reached."""
    with pytest.raises(ConfigError, match="give another id"):
        make_fault(unit="wheel.1", kind="dead", at_s=1, id=name)


def test_ids_are_unique_and_a_fault_without_one_is_called_by_its_place():
    """The second of an id is refused, also when it is the name that another has by its place."""
    dead = {"unit": "wheel.1", "kind": "dead", "at_s": 1.0}
    faults = (
        make_fault(**dead),
        make_fault(**dead, id="mine"),
        make_fault(**dead, id="mine"),
        make_fault(**dead, id="faults[0]"),
    )
    assert fault_ids(faults) == ("faults[0]", "mine", "mine", "faults[0]")
    assert [problem.path for problem in check_faults(faults)] == [(2, "id"), (3, "id")]
    with pytest.raises(ConfigError, match="is the id of faults\\[1\\] too"):
        make_plant(faults)


@pytest.mark.parametrize(("unit", "kind"), EVERY)
def test_a_fault_reads_back_as_itself(unit, kind):
    """Its flat form, in JSON types, is what a scenario file would say: nothing is lost and nothing is left over."""
    keys = {"unit": unit, "kind": kind, "at_s": 1.0, "until_s": 2.5, "id": "x", **EXAMPLES[kind]}
    if KINDS[unit.partition(".")[0]][kind].rises:
        keys["rise_s"] = 0.5
    fault = make_fault(**keys)
    assert plain(fault).items() >= keys.items()
    assert build(Fault, plain(fault), "x") == fault
    defaults = KINDS[unit.partition(".")[0]][kind].__dataclass_fields__
    assert set(plain(make_fault(unit=unit, kind=kind, at_s=1.0, **EXAMPLES[kind]))) <= {*keys, "phase", *defaults} - {
        "until_s", "id", "rise_s",
    }  # fmt: skip


def test_an_empty_key_of_another_kind_is_as_good_as_left_out():
    """So that one override can change the kind of a fault and another take its old magnitude away."""
    keys = {"unit": "wheel.1", "kind": "bias", "torque_nm": 0.1, "at_s": 1.0}
    assert build(Fault, {**keys, "effectiveness": None}, "x") == make_fault(**keys)


# -- effect --------------------------------------------------------------------------------------------------------


def effects(faults, ticks=40, **settings):
    """Tick and id of every first effect."""
    history = run(make_plant([make_fault(**fault) for fault in faults], **settings), ticks)
    return [(e.tick, e.id) for samples, _ in history for e in samples.events if e.phase == "effect"]


def test_a_fault_behind_one_that_masks_it_has_no_effect_until_that_ends():
    """A loss on a dead wheel, a drift and spikes on a stuck or dead gyro axis: nothing is otherwise than without them."""
    dead = {"unit": "wheel.1", "kind": "dead", "at_s": 0.5}
    loss = {"unit": "wheel.1", "kind": "loss", "effectiveness": 0.5, "at_s": 1.0}
    assert effects([dead, loss]) == [(5, "faults[0]")]
    assert effects([{**dead, "until_s": 2.0}, loss]) == [(5, "faults[0]"), (20, "faults[1]")]
    silent = {"unit": "gyro.x", "kind": "dead", "at_s": 0.5}
    drift = {"unit": "gyro.x", "kind": "constant", "rate_rad_s": 0.1, "at_s": 1.0}
    assert effects([silent, drift]) == [(5, "faults[0]")]
    assert effects([drift, {**drift, "kind": "stuck", "at_s": 1.5}]) == [(10, "faults[0]"), (15, "faults[1]")]
    noise = {"unit": "gyro.y", "kind": "noise", "factor": 9.0, "at_s": 2.0}
    assert effects([{"unit": "gyro.y", "kind": "stuck", "at_s": 1.0}, noise]) == [(10, "faults[0]")]


def test_two_that_do_the_same_mask_each_other():
    """Of two dead wheels in one the second changes nothing, and of two drop-outs neither is the cause alone."""
    dead = {"unit": "wheel.1", "kind": "dead", "at_s": 0.5}
    assert effects([dead, {**dead, "at_s": 1.0}]) == [(5, "faults[0]")]
    silent = {"unit": "wheel.2", "kind": "silent", "at_s": 0.5}
    assert effects([silent, {**silent, "at_s": 1.0, "until_s": 2.0}]) == [(5, "faults[0]")]


def test_a_fault_on_a_wheel_at_rest_has_no_effect_until_it_is_commanded():
    """Half of nothing is nothing: the effect is announced with the first torque that is another."""
    plant = make_plant([make_fault(unit="wheel.1", kind="loss", effectiveness=0.5, at_s=0.5)])
    events = []
    for k in range(20):
        events += plant.sample().events
        plant.step((0.01 if k >= 12 else 0.0, 0.0, 0.0, 0.0))
    assert [(e.tick, e.phase) for e in events] == [(5, "onset"), (12, "effect")]


@pytest.mark.parametrize(
    "fault",
    [
        {"unit": "gyro.x", "kind": "periodic", "rate_rad_s": 0.1, "frequency_rad_s": 1e-12},
        {"unit": "gyro.x", "kind": "spikes", "rate_rad_s": 0.1, "probability": 1e-12},  # never drawn
        {"unit": "star_tracker", "kind": "dropout", "probability": 1e-12},
        {"unit": "star_tracker", "kind": "dropout", "until_s": 1.1},  # between two frames
    ],
    ids=["slow", "spikes", "dropout", "between frames"],
)
def test_what_changes_nothing_has_no_effect(fault):
    """Accepted, since nobody can tell beforehand, but never announced as having had an effect."""
    star = StarTrackerConfig(rate_hz=5.0)
    ticks = 40
    if "until_s" in fault:
        fault = {**fault, "at_s": 1.05}
    config = PlantConfig(
        body=BodyConfig(inertia_kgm2=J),
        wheels=tuple(WheelConfig(mount=m) for m in ("x", "y", "z", "skew")),
        star_tracker=star,
    )
    plant = Plant(config, (make_fault(**{"at_s": 1.0, **fault}),), 0.1, 1)
    events = [e.phase for samples, _ in run(plant, ticks) for e in samples.events]
    assert events[0] == "onset"
    assert "effect" not in events


def test_beyond_its_speed_limit_a_wheel_shows_no_fault():
    """The limit makes the torque zero either way."""
    wheels = tuple(WheelConfig(mount=m, speed_rad_s=-10.0, max_speed_rad_s=10.0) for m in ("x", "y", "z", "skew"))
    body = BodyConfig(inertia_kgm2=((1e9, 0.0, 0.0), (0.0, 1e9, 0.0), (0.0, 0.0, 1e9)))
    plant = Plant(
        PlantConfig(body=body, wheels=wheels),
        (make_fault(unit="wheel.1", kind="loss", effectiveness=0.5, at_s=0.0),),
        0.1,
        1,
    )
    events = []
    for k in range(10):
        events += plant.sample().events
        plant.step((0.01 if k < 6 else -0.01, 0.0, 0.0, 0.0))
    assert [(e.tick, e.phase) for e in events] == [(0, "onset"), (6, "effect")]


def test_events_come_once_in_order_with_the_whole_fault():
    """Onsets, effects and ends, ends first where they fall on one tick; nothing is announced twice."""
    faults = [
        make_fault(unit="wheel.1", kind="loss", effectiveness=0.6, at_s=1.0, until_s=2.0),
        make_fault(unit="wheel.1", kind="loss", effectiveness=0.4, at_s=2.0, id="second"),
        make_fault(unit="gyro.x", kind="constant", rate_rad_s=0.01, at_s=0.5),
    ]
    events = [e for s, _ in run(make_plant(faults)) for e in s.events]
    assert [(e.tick, e.id, e.number, e.phase) for e in events] == [
        (5, "faults[2]", 2, "onset"),
        (5, "faults[2]", 2, "effect"),
        (10, "faults[0]", 0, "onset"),
        (10, "faults[0]", 0, "effect"),
        (20, "faults[0]", 0, "end"),
        (20, "second", 1, "onset"),
        (20, "second", 1, "effect"),
    ]
    assert events[2].fault.describe() == "wheel.1 loss effectiveness 0.6"
    assert events[2].value == 0.6
    assert build(Fault, json.loads(events[2].fault.definition), "x") == faults[0]


def test_sensor_faults_round_up_to_the_next_sample():
    """An onset at 0.23 s with samples every 0.1 s shows first at 0.3 s, and is announced with that sample."""
    history = run(make_plant([make_fault(unit="gyro.x", kind="dead", at_s=0.23, until_s=0.51)]), 10)
    assert [s.gyro_silent[0] for s, _ in history] == [False] * 3 + [True] * 3 + [False] * 4
    assert [(k, e.tick) for k, (s, _) in enumerate(history) for e in s.events if e.phase != "effect"] == [
        (3, 3),
        (6, 6),
    ]


def test_a_commanded_fault_acts_from_the_next_tick_under_a_name_of_its_own():
    """An onset in the past is now; one in the future waits; what is over, wrong, futile or of another's id is refused."""
    plant = make_plant([make_fault(unit="wheel.1", kind="dead", at_s=50.0)], preset="ideal")
    run(plant, 10)
    assert plant.add_fault(make_fault(unit="wheel.2", kind="stuck_torque", torque_nm=0.015, at_s=0.0)) == "command[0]"
    assert plant.add_fault(make_fault(unit="gyro.y", kind="dead", at_s=1.2, id="y")) == "y"
    history = run(plant, 5)
    assert [torque[1] for _, torque in history] == [pytest.approx(0.015, abs=1e-15)] * 5
    assert [s.gyro_silent[1] for s, _ in history] == [False, False, True, True, True]
    onsets = [(e.tick, e.id, e.number) for s, _ in history for e in s.events if e.phase == "onset"]
    assert onsets == [(10, "command[0]", 1), (12, "y", 2)]
    with pytest.raises(ConfigError, match="has passed"):
        plant.add_fault(make_fault(unit="wheel.2", kind="dead", at_s=0.0, until_s=1.0))
    with pytest.raises(ConfigError, match="no angle random walk"):
        plant.add_fault(make_fault(unit="gyro.x", kind="noise", factor=2.0, at_s=0.0))
    with pytest.raises(ConfigError, match='"y" is the id of another'):
        plant.add_fault(make_fault(unit="gyro.x", kind="dead", at_s=0.0, id="y"))
    assert plant.add_fault(make_fault(unit="wheel.3", kind="dead", at_s=9.0)) == "command[2]"


def test_faults_are_cleared_by_id_by_unit_and_all():
    """From the next sample on the unit is healthy again; each is announced once, and never as having ended by itself."""
    faults = [
        make_fault(unit="gyro", kind="dead", at_s=0.5, until_s=3.0, id="all axes"),
        make_fault(unit="wheel.1", kind="dead", at_s=0.5),
        make_fault(unit="wheel.2", kind="silent", at_s=0.5, until_s=9.0),
        make_fault(unit="wheel.2", kind="dead", at_s=2.5),
    ]
    plant = make_plant(faults)
    run(plant, 10)
    assert plant.clear_faults(id="all axes") == ("all axes",)
    assert plant.clear_faults(unit="wheel.2") == ("faults[2]", "faults[3]")
    states = [(item.id, item.state, item.had_effect) for item in plant.list_faults()]
    assert states == [
        ("all axes", "over", True), ("faults[1]", "active", True), ("faults[2]", "over", True), ("faults[3]", "over", False),
    ]  # fmt: skip
    history = run(plant, 5)
    assert not any(any(s.gyro_silent) or any(s.wheel_silent) for s, _ in history)
    assert all(torque[0] == 0.0 and torque[1] != 0.0 for _, torque in history)
    assert plant.clear_faults() == ("faults[1]",)
    assert plant.clear_faults() == ()
    later = run(plant, 30)
    assert all(torque[0] != 0.0 and torque[1] != 0.0 for _, torque in later)
    events = [(e.tick, e.id, e.phase) for s, _ in history + later for e in s.events]
    assert events == [
        (10, "all axes", "cleared"),
        (10, "faults[2]", "cleared"),
        (10, "faults[3]", "cleared"),
        (15, "faults[1]", "cleared"),
    ]
    with pytest.raises(ConfigError, match='no fault with id "all axes" is waiting or active'):
        plant.clear_faults(id="all axes")


def test_clearing_the_gyro_clears_its_axes_and_clearing_an_axis_not_the_gyro():
    """A unit is what stands in the fault, but `gyro` is all of it."""
    dead = {"kind": "dead", "at_s": 0.0}
    plant = make_plant([make_fault(unit=unit, **dead) for unit in ("gyro", "gyro.x", "gyro.y", "wheel.1")])
    run(plant, 3)
    assert plant.clear_faults(unit="gyro.x") == ("faults[1]",)
    assert plant.clear_faults(unit="gyro") == ("faults[0]", "faults[2]")
    with pytest.raises(ConfigError, match='no fault with unit "star_tracker"'):
        plant.clear_faults(unit="star_tracker")


def test_a_run_repeats_bit_for_bit_and_another_seed_differs():
    """Two plants of one seed give the same samples and truth; the seed is what makes them so."""
    faults = [make_fault(unit=UNIT_OF["gyro"], kind="spikes", rate_rad_s=0.02, probability=0.3, at_s=0.5)]
    assert run(make_plant(faults)) == run(make_plant(faults))
    other = Plant(make_plant().config, tuple(faults), 0.1, 8)
    assert run(other) != run(make_plant(faults))


def test_a_new_kind_is_one_file(tmp_path):
    """A module dropped among the kinds is found by import alone: read, refused, flown, without another file touched."""
    package = tmp_path / "plant_server"
    shutil.copytree(ROOT / "plant_server", package, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "faults" / "kinds" / "weak.py").write_text(NEW_KIND)
    code = (
        "from plant_server.faults import make_fault; f = make_fault(unit='wheel.1', kind='weak', limit_nm=0.1, at_s=1);"
        "print(f.describe(), f.definition)"
    )
    env = {**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}"}
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], env=env, cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == (
        'wheel.1 weak limit_nm 0.1 {"unit":"wheel.1","kind":"weak","at_s":1.0,"limit_nm":0.1}'
    )


NEW_KIND = """
from dataclasses import dataclass

from bus.units import NewtonMetre
from plant_server.faults.effects import Acting, WheelDisturbance, WheelEffect, register


@register("wheel", "weak")
@dataclass(frozen=True, slots=True, kw_only=True)
class Weak(WheelEffect):
    limit_nm: NewtonMetre

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        wheel.offset_nm -= now.level * self.limit_nm
"""


def test_the_page_lists_every_fault_with_what_it_takes():
    """docs/plant.md has the table of kinds as the register makes it: `python -P -m tools.config.schema` writes it."""
    from tools.config.fault_reference import format_kinds, update_plant_page

    page = (ROOT / "docs" / "plant.md").read_text()
    assert update_plant_page(page) == page
    assert page.count(format_kinds()) == 1
    for _, kind in EVERY:
        assert f"| `{kind}` |" in page
