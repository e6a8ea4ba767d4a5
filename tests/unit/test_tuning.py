"""Numbers that are changed in flight: each acts, on its tick, and only then."""

from __future__ import annotations

from typing import Any

import pytest

from bus.commands import Command
from bus.units import DEG
from fsw import tuning
from fsw.modes import Mode
from tools.run.bench import Bench


def fly(*overrides: str, ticks: int = 20) -> Bench:
    """A bench of the nominal scenario (10 Hz) after so many ticks."""
    return Bench.open("nominal", list(overrides)).step(ticks)


def order(bench: Bench, verb: str, **arguments: Any) -> None:
    """A command for the next tick, which must be one that can be obeyed."""
    command = Command(bench.tick, verb, arguments, "test")
    assert bench.flight.check(command, bench.tick) == ""
    bench.fsw_node.commands.add(command)


def tune(bench: Bench, name: str, value: float) -> None:
    """Change a number on the next tick."""
    order(bench, "param.set", name=name, value=value)
    bench.step()
    assert tuning.read(bench.flight, name) == pytest.approx(value)


def test_every_number_is_what_the_settings_say_at_boot() -> None:
    """The values of nominal's settings, read through the numbers' names."""
    bench = fly("fsw.modes.stale_after_ticks=7", "fsw.modes.damping_nm_s=11")
    values = {name: tuning.read(bench.flight, name) for name in tuning.BY_NAME}
    assert values == pytest.approx({
        "SLEW_MAX_DEG_S": 0.2, "SLEW_ACC_DEG_S2": 0.01, "FEED_FORWARD": 1.0, "DAMPING_NM_S": 11.0,
        "DETUMBLE_DEG_S": 5.0, "POINT_DEG_S": 2.0, "RECOVER_TICKS": 20.0, "STALE_TICKS": 7.0, "STAR_STALE_S": 5.0,
    })  # fmt: skip


def test_the_damping_gain_acts() -> None:
    """In safe mode the torque is -k w: with k = 3 N m s/rad, what the wheels are told is that, to a step of their frames."""
    bench = fly()
    tune(bench, "DAMPING_NM_S", 3.0)
    order(bench, "mode.safe")
    bench.step()
    rate = bench.flight.detection.estimate.omega_bi_b_rad_s
    assert max(map(abs, rate)) > 1e-3
    assert bench.flight.tau_cmd_b_nm == pytest.approx([-3.0 * w for w in rate], abs=1e-4)


def test_the_rates_between_damping_and_pointing_act() -> None:
    """A rate limit below the rate of the moment leads to detumble; a higher limit to end at leads back."""
    bench = fly()
    rate_deg_s = sum(w * w for w in bench.flight.detection.estimate.omega_bi_b_rad_s) ** 0.5 / DEG
    assert rate_deg_s > 0.1
    tune(bench, "POINT_DEG_S", 0.01)
    tune(bench, "DETUMBLE_DEG_S", 0.02)
    assert bench.flight.modes.mode is Mode.DETUMBLE
    bench.step(5)
    assert bench.flight.modes.mode is Mode.DETUMBLE
    tune(bench, "DETUMBLE_DEG_S", 90.0)
    tune(bench, "POINT_DEG_S", 80.0)
    assert bench.flight.modes.mode is Mode.POINT


@pytest.mark.parametrize("ticks", [3, 40])
def test_the_recovery_count_acts(ticks: int) -> None:
    """Out of a safe mode that a silent star tracker brought: so many good ticks, then standby, then pointing."""
    bench = fly("fsw.modes.star_stale_after_s=1.0", "faults=[{unit: star_tracker, kind: dropout, at_s: 3, until_s: 6}]")
    tune(bench, "RECOVER_TICKS", ticks)
    while bench.flight.modes.mode is not Mode.SAFE:
        bench.step()
    good = 0
    while bench.flight.modes.mode is Mode.SAFE:
        bench.step()
        sensors_good = bench.flight.detection.estimate.valid and bench.flight.inputs.sensors.star_valid
        good = good + 1 if sensors_good else 0
    assert good == ticks


@pytest.mark.parametrize("ticks", [1, 12])
def test_the_time_for_which_a_silent_unit_is_held_acts(ticks: int) -> None:
    """A gyro that falls silent at 4 s: rate stale, and safe mode, that many ticks after its last frame and one."""
    bench = fly("faults=[{unit: gyro, kind: dead, at_s: 4}]")
    tune(bench, "STALE_TICKS", ticks)
    while bench.flight.modes.mode is not Mode.SAFE:
        last = bench.flight.inputs.sensors.gyro_valid
        bench.step()
    assert last == (True, True, True)
    first_missed = 41  # the first tick whose frames, of the time before, do not come
    assert bench.tick - 1 == pytest.approx(first_missed + ticks, abs=1)


@pytest.mark.parametrize("seconds", [0.5, 3.0])
def test_the_time_for_which_an_attitude_is_held_acts(seconds: float) -> None:
    """A star tracker that goes out at 4 s: attitude stale after that time."""
    bench = fly("faults=[{unit: star_tracker, kind: dropout, at_s: 4}]")
    tune(bench, "STAR_STALE_S", seconds)
    while bench.flight.modes.mode is not Mode.SAFE:
        bench.step()
    assert bench.t_s == pytest.approx(4.0 + seconds, abs=0.3)
    assert bench.flight.modes.reason == "attitude stale"


def test_feed_forward_acts() -> None:
    """While a slew speeds up about x at 0.5 deg/s2 the torque that is added is J alpha; without it, none."""
    torques = []
    for value in (1.0, 0.0):
        bench = fly(ticks=600)
        tune(bench, "FEED_FORWARD", value)
        order(bench, "target.rate", rate_deg_s=[1.0, 0.0, 0.0], max_acceleration_deg_s2=0.05)
        bench.step(2)
        torques.append(bench.flight.tau_cmd_b_nm[0])
    inertia = bench.flight.vehicle.inertia_kgm2[0][0]
    assert torques[0] - torques[1] == pytest.approx(inertia * 0.05 * DEG, rel=0.05)


@pytest.mark.parametrize(("name", "value"), [("SLEW_MAX_DEG_S", 0.4), ("SLEW_ACC_DEG_S2", 0.02)])
def test_the_limits_of_slews_are_kept_for_the_ground(name: str, value: float) -> None:
    """They are read where attitudes of the ground become slews (tests/ground/test_vehicle.py); here: set and kept."""
    bench = fly()
    tune(bench, name, value)
    bench.step(5)
    assert tuning.read(bench.flight, name) == value


def test_a_gain_of_the_law_makes_the_law_that_such_settings_make() -> None:
    """From its tick on the torques are those of a bench that had the gain from the start, and was never anything else."""
    changed = fly(ticks=1)
    name, key = next(iter(tuning.list_gains(changed.flight).items()))
    value = 0.5 * tuning.read(changed.flight, name)
    changed = Bench.open("nominal")
    order(changed, "param.set", name=name, value=value)
    changed.step(60)
    born = fly(f"fsw.controller.{key}={value}", ticks=60)
    unchanged = fly(ticks=60)
    assert changed.flight.tau_cmd_b_nm == born.flight.tau_cmd_b_nm
    assert changed.flight.tau_cmd_b_nm != unchanged.flight.tau_cmd_b_nm


def test_laws_that_take_long_to_make_are_left_as_they_are() -> None:
    """dismc proves its stability when it is made: none of its gains can be changed within a cycle."""
    bench = Bench.open("dismc")
    assert tuning.list_gains(bench.flight) == {}
    assert "is not known" in tuning.check(bench.flight, {"name": "LAW_KAPPA", "value": 0.5})


def test_every_name_fits_and_is_there_once() -> None:
    """Of every shipped law: at most 16 characters, all different."""
    for scenario in ("nominal", "zhang2018-flight", "braking-profile", "finite-time", "variable-structure", "tracking"):
        names = tuning.list_names(Bench.open(scenario).flight)
        assert len(set(names)) == len(names)
        assert max(map(len, names)) <= 16
