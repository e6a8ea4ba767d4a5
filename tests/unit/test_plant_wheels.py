"""Wheels: axes against the published formulas, limits, lag, drag, telemetry; oracles are closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from plant_server.config import BodyConfig, PlantConfig, WheelConfig
from plant_server.faults import make_fault
from plant_server.plant import Plant
from plant_server.wheels.axes import nominal_axis, true_axis

MOUNTS = ("x", "y", "z", "skew")
HEAVY = ((1e9, 0.0, 0.0), (0.0, 1e9, 0.0), (0.0, 0.0, 1e9))  # does not turn, so that rotor motion is scalar
TICK_S = 0.01


def make_plant(faults=(), tick_s=TICK_S, **settings):
    wheels = tuple(WheelConfig(mount=mount, **settings) for mount in MOUNTS)
    return Plant(PlantConfig(body=BodyConfig(inertia_kgm2=HEAVY), wheels=wheels), tuple(faults), tick_s, 3)


def speed(plant):
    return plant.sample().wheel_speed_rad_s


# -- axes ----------------------------------------------------------------------------------------------------------


def test_nominal_axes_are_the_columns_of_d0():
    """Zhang, Ye & Sun 2018, eq (5)."""
    s = 1.0 / math.sqrt(3.0)
    expected = np.array([[1, 0, 0, s], [0, 1, 0, s], [0, 0, 1, s]])
    np.testing.assert_allclose(np.array([nominal_axis(m) for m in MOUNTS]).T, expected, atol=1e-16)


def test_published_misalignment_matrix():
    """The paper's scenario angles give the matrix computed independently from eq (3), digits written out here."""
    angles = ((10.0, 12.0), (8.0, 15.0), (5.0, 8.0), (6.0, 10.0))
    axes = np.array([true_axis(m, tilt, clock) for m, (tilt, clock) in zip(MOUNTS, angles, strict=True)]).T
    sin, cos = lambda d: math.sin(math.radians(d)), lambda d: math.cos(math.radians(d))
    elevation = math.degrees(math.asin(1.0 / math.sqrt(3.0)))
    expected = [
        [cos(10), sin(8) * cos(15), sin(5) * cos(8), cos(elevation + 6) * cos(55)],
        [sin(10) * cos(12), cos(8), sin(5) * sin(8), cos(elevation + 6) * sin(55)],
        [sin(10) * sin(12), sin(8) * sin(15), cos(5), sin(elevation + 6)],
    ]
    np.testing.assert_allclose(axes, expected, atol=1e-15)
    np.testing.assert_allclose(axes[:, 0], [0.984807753012208, 0.16985354835670552, 0.03610348622615416], atol=1e-15)


@pytest.mark.parametrize("mount", MOUNTS)
def test_axes_are_unit_vectors_tilted_by_the_tilt(mount):
    """Always unit length; the angle to the nominal axis is the tilt (x, y, z: any clocking; skew: no clocking)."""
    for tilt in (0.0, 0.3, 7.0, 25.0):
        for clock in (0.0,) if mount == "skew" else (0.0, 40.0, 200.0):
            axis = np.array(true_axis(mount, tilt, clock))
            assert np.linalg.norm(axis) == pytest.approx(1.0, abs=1e-15)
            angle = math.degrees(math.atan2(np.linalg.norm(np.cross(axis, nominal_axis(mount))),
                                            axis @ np.array(nominal_axis(mount))))  # fmt: skip
            assert angle == pytest.approx(tilt, abs=1e-12)


# -- motor ---------------------------------------------------------------------------------------------------------


def test_torque_spins_the_rotor_the_other_way_and_is_limited():
    """h' = -tau; a command beyond the limit acts as the limit, per wheel, both signs."""
    plant = make_plant(max_torque_nm=0.1, inertia_kgm2=0.02)
    for _ in range(100):
        plant.step((0.05, -0.05, 0.5, -0.5))
    np.testing.assert_allclose(speed(plant), np.array([-0.05, 0.05, -0.1, 0.1]) / 0.02, rtol=1e-9)
    np.testing.assert_allclose(plant.truth().tau_rw_true_nm, (0.05, -0.05, 0.1, -0.1))


def test_motor_lag_is_the_exact_first_order_response():
    """The momentum after t under a constant command is tau (t - T (1 - exp(-t/T))), for any step size."""
    lag, tau, inertia = 0.05, 0.08, 0.01
    for tick_s in (0.01, 0.1):
        plant = make_plant(tick_s=tick_s, torque_lag_s=lag, inertia_kgm2=inertia)
        for k in range(1, 11):
            plant.step((tau,) * 4)
            t = k * tick_s
            expected = -tau * (t - lag * (1.0 - math.exp(-t / lag))) / inertia
            np.testing.assert_allclose(speed(plant), [expected] * 4, rtol=1e-9)


def test_no_torque_beyond_the_speed_limit():
    """A rotor driven up stops gaining speed at its limit, reports it, keeps it, and can be driven back."""
    plant = make_plant(max_speed_rad_s=5.0, inertia_kgm2=0.01)
    statuses = set()
    for _ in range(200):
        plant.step((0.1, -0.1, 0.0, 0.05))
        samples = plant.sample()
        assert max(map(abs, samples.wheel_speed_rad_s)) <= 5.0
        statuses.add(samples.wheel_status)
    assert samples.wheel_status == (3, 3, 0, 3)
    assert (0, 0, 0, 0) in statuses
    assert samples.wheel_speed_rad_s[0] == pytest.approx(-5.0, abs=0.11)  # within one step's worth of the limit
    np.testing.assert_array_equal(plant.truth().tau_rw_true_nm, 0.0)
    plant.step((-0.1, 0.1, 0.0, 0.0))
    after = plant.sample()
    assert abs(after.wheel_speed_rad_s[0]) < abs(samples.wheel_speed_rad_s[0])
    assert after.wheel_status == (0, 0, 0, 0)


def test_viscous_drag_decays_the_speed_exponentially():
    """Without command: speed exp(-c t / I), to the step's first order."""
    viscous, inertia = 1e-3, 0.01
    plant = make_plant(viscous_nm_s=viscous, inertia_kgm2=inertia, speed_rad_s=100.0)
    for _ in range(1000):
        plant.step((0.0,) * 4)
    np.testing.assert_allclose(speed(plant), [100.0 * math.exp(-viscous * 10.0 / inertia)] * 4, rtol=1e-3)


def test_dry_friction_stops_the_rotor_and_holds_it():
    """Constant deceleration to rest at I s0 / tau_c = 2 s, then rest, also under a smaller command; never back."""
    plant = make_plant(coulomb_nm=0.01, inertia_kgm2=0.01, speed_rad_s=2.0)
    for k in range(1, 401):
        plant.step((0.0, 0.0, 0.005, 0.0))
        if k == 100:
            assert speed(plant)[0] == pytest.approx(1.0, rel=1e-6)
            assert speed(plant)[2] == pytest.approx(0.5, rel=1e-6)
    np.testing.assert_allclose(speed(plant), 0.0, atol=1e-9)
    for _ in range(100):
        plant.step((0.0, 0.0, 0.015, 0.0))
    assert speed(plant)[2] == pytest.approx(-0.5, rel=1e-6)  # the command beats friction by 0.005 N m


# -- telemetry and silence -----------------------------------------------------------------------------------------


def test_current_is_motor_torque_over_motor_constant():
    """Drag is in the torque on the body but not in the current."""
    plant = make_plant(motor_constant_nm_a=0.04, viscous_nm_s=1e-4, speed_rad_s=50.0, max_torque_nm=0.1)
    plant.step((0.02, -0.06, 0.3, 0.0))
    np.testing.assert_allclose(plant.sample().wheel_current_a, (0.5, -1.5, 2.5, 0.0), rtol=1e-12)
    assert plant.truth().tau_rw_true_nm[3] == pytest.approx(50.0 * 1e-4, rel=1e-9)


def test_a_wheel_without_command_gives_no_torque_and_says_so():
    """None is not the last command: the motor lets go, the others go on."""
    plant = make_plant()
    assert plant.sample().wheel_status == (2, 2, 2, 2)  # before the first command
    plant.step((0.05, 0.05, 0.05, 0.05))
    plant.step((0.05, None, 0.05, None))
    assert plant.sample().wheel_status == (0, 2, 0, 2)
    np.testing.assert_array_equal(plant.truth().tau_rw_true_nm, (0.05, 0.0, 0.05, 0.0))


def test_a_command_of_no_torque_is_told_from_none():
    """A wheel whose command is lost reports it although its torque was 0 before and is now; and takes it back."""
    plant = make_plant()
    for commands, status in (
        ((0.0,) * 4, (0, 0, 0, 0)),
        ((0.0, None, 0.0, 0.0), (0, 2, 0, 0)),
        ((0.0,) * 4, (0, 0, 0, 0)),
    ):
        plant.step(commands)
        assert plant.sample().wheel_status == status


def test_tachometer_noise_has_its_sigma_and_a_stream_per_wheel():
    """Mean 0 and sigma within 5 standard errors, uncorrelated between wheels."""
    plant = make_plant(speed_noise_rad_s=0.2)
    readings = np.array([plant.sample().wheel_speed_rad_s for _ in range(5000)])
    np.testing.assert_allclose(readings.mean(axis=0), 0.0, atol=5 * 0.2 / math.sqrt(5000))
    np.testing.assert_allclose(readings.std(axis=0), 0.2, rtol=5 / math.sqrt(2 * 5000))
    correlation = np.corrcoef(readings.T) - np.eye(4)
    assert np.abs(correlation).max() < 5 / math.sqrt(5000)


# -- faults --------------------------------------------------------------------------------------------------------


def wheel_fault(kind, at_s, until_s=None, **magnitudes):
    return make_fault(unit="wheel.1", kind=kind, at_s=at_s, until_s=until_s, **magnitudes)


@pytest.mark.parametrize(
    ("faults", "expected"),
    [  # torque of a wheel commanded 0.08 N m; Zhang, Ye & Sun 2018, eq (8), applied in the order of onset
        ([("loss", {"effectiveness": 0.5})], 0.04),
        ([("bias", {"torque_nm": 0.03})], 0.11),
        ([("stuck_torque", {"torque_nm": -0.02})], -0.02),
        ([("dead", {})], 0.0),
        ([("loss", {"effectiveness": 0.5}), ("bias", {"torque_nm": 0.03})], 0.07),
        ([("bias", {"torque_nm": 0.03}), ("loss", {"effectiveness": 0.5})], 0.055),
        ([("loss", {"effectiveness": 0.5}), ("loss", {"effectiveness": 0.4})], 0.016),
        ([("bias", {"torque_nm": 0.03}), ("dead", {})], 0.0),
        ([("dead", {}), ("bias", {"torque_nm": 0.03})], 0.03),  # e = 0 with a bias: the table's stuck torque
        ([("stuck_torque", {"torque_nm": -0.02}), ("loss", {"effectiveness": 0.5})], -0.01),
    ],
)
def test_faults_compose_in_the_order_of_onset(faults, expected):
    """Whatever the order in the scenario; the truth's lumped fault torque is the difference to the command."""
    timeline = [wheel_fault(kind, 0.01 * (i + 1), **m) for i, (kind, m) in enumerate(faults)]
    plant = make_plant(reversed(timeline))
    for _ in range(5):
        plant.step((0.08, 0.0, 0.0, 0.0))
    truth = plant.truth()
    assert truth.tau_rw_true_nm[0] == pytest.approx(expected, abs=1e-15)
    assert truth.tau_fault_b_nm[0] == pytest.approx(expected - 0.08, abs=1e-15)  # tau_fault about x


def test_a_fault_rises_linearly_and_ends():
    """Bias with a rise of 1 s from 1 s, until 3 s: mean torque over each tick is that of the ramp at its middle."""
    plant = make_plant([wheel_fault("bias", 1.0, 3.0, torque_nm=0.04, rise_s=1.0)], tick_s=0.1)
    for k in range(40):
        plant.step((0.0,) * 4)
        t = (k + 0.5) * 0.1
        expected = 0.0 if not 1.0 < t < 3.0 else 0.04 * min(1.0, t - 1.0)
        assert plant.truth().tau_rw_true_nm[0] == pytest.approx(expected, abs=1e-12)


def test_an_onset_between_ticks_bites_within_the_tick():
    """At 0.23 s in a tick of 0.1 s with steps of 0.01 s the fault acts on 7 of 10 steps; announced with that tick."""
    plant = make_plant([wheel_fault("bias", 0.23, torque_nm=0.05)], tick_s=0.1)
    events = []
    for _ in range(4):
        events += plant.sample().events
        plant.step((0.0,) * 4)
        if plant.tick == 3:
            assert plant.truth().tau_rw_true_nm[0] == pytest.approx(0.035, abs=1e-15)
    assert [(e.tick, e.t_s, e.fault.unit, e.phase) for e in events if e.phase == "onset"] == [
        (2, pytest.approx(0.23), "wheel.1", "onset")
    ]


def test_silent_stops_the_telemetry_only():
    """From the first sample at or after the onset until the end; the wheel obeys all the time."""
    plant = make_plant([wheel_fault("silent", 0.02, 0.04)])
    seen = []
    for _ in range(6):
        seen.append(plant.sample().wheel_silent)
        plant.step((0.05, 0.0, 0.0, 0.0))
        assert plant.truth().tau_rw_true_nm[0] == 0.05
    quiet = (True, False, False, False)
    heard = (False,) * 4
    assert seen == [heard, heard, quiet, quiet, heard, heard]


def test_a_stuck_wheel_does_not_pass_its_speed_limit():
    """The limit holds for faulty torque too."""
    plant = make_plant([wheel_fault("stuck_torque", 0.0, torque_nm=-0.1)], max_speed_rad_s=3.0)
    for _ in range(100):
        plant.step((0.0,) * 4)
    assert 2.8 < speed(plant)[0] <= 3.0
    assert plant.sample().wheel_status[0] == 3
