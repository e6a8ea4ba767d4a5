"""The fault catalogue, what is refused and how, and the announcements of the timeline."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from bus.errors import ConfigError
from plant_server.config import BodyConfig, FaultConfig, GyroConfig, PlantConfig, StarTrackerConfig, WheelConfig
from plant_server.faults import CATALOGUE, FaultTimeline, check_fault, check_faults
from plant_server.plant import Plant

J = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))
EXAMPLES = {  # magnitudes for every kind
    "loss": {"effectiveness": 0.5}, "bias": {"torque_nm": 0.01}, "stuck_torque": {"torque_nm": 0.02}, "dead": {},
    "silent": {}, "constant": {"rate_rad_s": 0.01}, "periodic": {"rate_rad_s": 0.01, "frequency_rad_s": 2.0},
    "ramp": {"slope_rad_s2": 1e-3}, "stuck": {}, "noise": {"factor": 5.0}, "scale": {"factor": 0.1},
    "spikes": {"rate_rad_s": 0.05, "probability": 0.5}, "intermittent": {"probability": 0.5}, "dropout": {},
}  # fmt: skip
UNIT_OF = {"wheel": "wheel.2", "gyro": "gyro.y", "star_tracker": "star_tracker"}
EVERY = [(UNIT_OF[family], kind) for family, kinds in CATALOGUE.items() for kind in kinds]


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
        history.append((samples, plant.truth()[15:19]))
    return history


@pytest.mark.parametrize(("unit", "kind"), EVERY)
def test_every_kind_of_the_catalogue_bites_on_its_unit_alone(unit, kind):
    """Against a run without the fault: the same before onset, different after, and no other unit's output differs.

    This is the promise that no accepted fault is silently ignored, and that adding one shifts nobody else's noise.
    """
    fault = FaultConfig(unit=unit, kind=kind, at_s=1.0, **EXAMPLES[kind])
    assert check_fault(fault) == []
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
    assert [(e.tick, e.active) for samples, _ in faulty for e in samples.events] == [(10, True)]


def test_gyro_as_a_unit_means_all_three_axes_once():
    """One fault, one event, three axes."""
    history = run(make_plant([FaultConfig(unit="gyro", kind="dead", at_s=1.0, until_s=2.0)]))
    assert [s.gyro_silent for s, _ in history] == [(False,) * 3] * 10 + [(True,) * 3] * 10 + [(False,) * 3] * 20
    events = [e for s, _ in history for e in s.events]
    assert [(e.tick, e.number, e.unit, e.active) for e in events] == [(10, 0, "gyro", True), (20, 0, "gyro", False)]


def test_a_unit_misspelt_is_named_with_the_near_miss():
    """Unit and kind: what is known, and what was probably meant."""
    (problem,) = check_fault(FaultConfig(unit="wheel.5", kind="dead", at_s=0.0))
    assert problem.path == ("unit",)
    assert "wheel.1, wheel.2" in problem.message
    assert "did you mean wheel." in problem.message
    (problem,) = check_fault(FaultConfig(unit="wheel.1", kind="stuck_torqe", at_s=0.0))
    assert problem.path == ("kind",)
    assert "did you mean stuck_torque?" in problem.message
    (problem,) = check_fault(FaultConfig(unit="gyro.x", kind="loss", at_s=0.0))
    assert '"loss" is not a fault of a gyro; there are: constant, periodic' in problem.message


@pytest.mark.parametrize(
    ("settings", "path", "word"),
    [
        ({"kind": "loss"}, (), "needs effectiveness"),
        ({"kind": "dead", "torque_nm": 0.1}, ("torque_nm",), "no use for torque_nm"),
        ({"kind": "loss", "effectiveness": 1.5}, ("effectiveness",), "outside 0..1"),
        ({"kind": "loss", "effectiveness": math.nan}, ("effectiveness",), "finite"),
        ({"kind": "bias", "torque_nm": math.inf}, ("torque_nm",), "finite"),
        ({"kind": "dead", "until_s": 5.0}, ("until_s",), "not after the onset"),
        ({"kind": "dead", "at_s": math.nan}, ("at_s",), "not a time"),
        ({"kind": "dead", "rise_s": -1.0}, ("rise_s",), "not a time"),
        ({"kind": "silent", "rise_s": 1.0}, ("rise_s",), "no rise"),
        ({"kind": "dead", "phase": "absolute"}, ("phase",), "only periodic"),
        ({"unit": "gyro.x", "kind": "periodic", "rate_rad_s": 0.1}, (), "needs frequency_rad_s"),
        ({"unit": "gyro.x", "kind": "periodic", "rate_rad_s": 0.1, "frequency_rad_s": -1.0}, ("frequency_rad_s",), "0"),
        ({"unit": "gyro.x", "kind": "noise", "factor": -2.0}, ("factor",), "0 or more"),
        ({"unit": "star_tracker", "kind": "dropout", "probability": 2.0}, ("probability",), "outside 0..1"),
    ],
)
def test_what_is_wrong_is_refused_where_it_is(settings, path, word):
    """Each wrong setting gives one problem, at its key, saying what is wrong."""
    (problem,) = check_fault(FaultConfig(**{"unit": "wheel.1", "at_s": 10.0, **settings}))
    assert problem.path == path
    assert word in problem.message


def test_all_problems_of_all_faults_come_at_once():
    """A ConfigError lists every one, each with the index of its fault."""
    bad = (
        FaultConfig(unit="wheel.9", kind="dead", at_s=0.0, until_s=0.0),
        FaultConfig(unit="gyro.x", kind="constant", at_s=0.0),
    )
    assert [p.path for p in check_faults(bad)] == [(0, "until_s"), (0, "unit"), (1,)]
    with pytest.raises(ConfigError) as caught:
        make_plant(bad)
    assert len(caught.value.problems) == 3
    assert caught.value.problems[1].startswith('faults[0].unit: unit "wheel.9" is not known')
    with pytest.raises(ConfigError):
        FaultTimeline(bad, step_s=0.01, steps_per_tick=1, seed=0)


def test_a_fault_that_could_never_bite_is_refused():
    """More noise on a gyro without noise, and a loss that loses nothing."""
    noise = FaultConfig(unit="gyro.z", kind="noise", factor=10.0, at_s=0.0)
    make_plant([noise])
    with pytest.raises(ConfigError, match="no angle random walk"):
        make_plant([noise], preset="ideal")
    with pytest.raises(ConfigError, match="no effect"):
        make_plant([FaultConfig(unit="wheel.1", kind="loss", effectiveness=1.0, at_s=0.0)])


def test_events_come_once_in_order_with_their_numbers():
    """Onsets and ends, ends first where both fall on one tick; nothing is announced twice."""
    faults = [
        FaultConfig(unit="wheel.1", kind="loss", effectiveness=0.6, at_s=1.0, until_s=2.0),
        FaultConfig(unit="wheel.1", kind="loss", effectiveness=0.4, at_s=2.0),
        FaultConfig(unit="gyro.x", kind="constant", rate_rad_s=0.01, at_s=0.5),
    ]
    events = [e for s, _ in run(make_plant(faults)) for e in s.events]
    assert [(e.tick, e.number, e.active) for e in events] == [
        (5, 2, True),
        (10, 0, True),
        (20, 0, False),
        (20, 1, True),
    ]
    assert events[1].describe() == "wheel.1 loss effectiveness 0.6"
    assert events[1].magnitude == 0.6


def test_sensor_faults_round_up_to_the_next_sample():
    """An onset at 0.23 s with samples every 0.1 s shows first at 0.3 s, and is announced with that sample."""
    history = run(make_plant([FaultConfig(unit="gyro.x", kind="dead", at_s=0.23, until_s=0.51)]), 10)
    assert [s.gyro_silent[0] for s, _ in history] == [False] * 3 + [True] * 3 + [False] * 4
    assert [(s.tick, e.tick) for s, _ in history for e in s.events] == [(3, 3), (6, 6)]


def test_a_commanded_fault_acts_from_the_next_tick_and_is_numbered_after_the_scenarios():
    """An onset in the past is now; one in the future waits; what is over, wrong or futile is refused."""
    plant = make_plant([FaultConfig(unit="wheel.1", kind="dead", at_s=50.0)], preset="ideal")
    run(plant, 10)
    assert plant.add_fault(FaultConfig(unit="wheel.2", kind="stuck_torque", torque_nm=0.015, at_s=0.0)) == 1
    assert plant.add_fault(FaultConfig(unit="gyro.y", kind="dead", at_s=1.2)) == 2
    history = run(plant, 5)
    assert [torque[1] for _, torque in history] == [pytest.approx(0.015, abs=1e-15)] * 5
    assert [s.gyro_silent[1] for s, _ in history] == [False, False, True, True, True]
    assert [(e.tick, e.number) for s, _ in history for e in s.events] == [(10, 1), (12, 2)]
    with pytest.raises(ConfigError, match="has passed"):
        plant.add_fault(FaultConfig(unit="wheel.2", kind="dead", at_s=0.0, until_s=1.0))
    with pytest.raises(ConfigError, match="needs torque_nm"):
        plant.add_fault(FaultConfig(unit="wheel.2", kind="bias", at_s=0.0))
    with pytest.raises(ConfigError, match="no angle random walk"):
        plant.add_fault(FaultConfig(unit="gyro.x", kind="noise", factor=2.0, at_s=0.0))


def test_a_run_repeats_bit_for_bit_and_another_seed_differs():
    """Two plants of one seed give the same samples and truth; the seed is what makes them so."""
    faults = [FaultConfig(unit=UNIT_OF["gyro"], kind="spikes", rate_rad_s=0.02, probability=0.3, at_s=0.5)]
    assert run(make_plant(faults)) == run(make_plant(faults))
    other = Plant(make_plant().config, tuple(faults), 0.1, 8)
    assert run(other) != run(make_plant(faults))


def test_the_page_lists_every_fault_with_what_it_takes():
    """docs/plant.md has a row for each kind of the catalogue, naming the magnitudes it needs and may have."""
    page = (Path(__file__).parent.parent.parent / "docs" / "plant.md").read_text()
    rows = [line.split("|") for line in page.splitlines() if line.count("|") == 5 and "`" in line.split("|")[2]]
    listed = [(cells[2].strip(" `"), set(re.findall(r"`(\w+)`", cells[3]))) for cells in rows]
    expected = [
        (name, {*kind.needs, *(key for key, _ in kind.may)})
        for kinds in CATALOGUE.values()
        for name, kind in kinds.items()
    ]
    assert listed == expected
