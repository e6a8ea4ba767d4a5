"""The drive: what it adds to the torques allocated, what of it is meant for the body, and what others make of that."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from bus.errors import ConfigError
from bus.units import Vec4
from fsw.drive import Drive, command_wheels
from fsw.records import HEALTHY, FourReadings, WheelHealth, WheelReading
from fsw.settings import DriveConfig, ModelConfig, WheelModelConfig, WheelMotorConfig
from fsw.vehicle import Vehicle

INERTIA = ((12.0, 0.0, 0.0), (0.0, 13.0, 0.0), (0.0, 0.0, 15.0))
MODEL = ModelConfig(inertia_kgm2=INERTIA, wheel_max_torque_nm=0.0275, wheel_motor=WheelMotorConfig())
BOTH = DriveConfig(friction="nominal", gain="estimated")
ASKED: Vec4 = (5e-3, -3e-3, 1e-3, 0.0)
SPEEDS: Vec4 = (100.0, -100.0, 0.2, 0.0)
STEP_NM = 1e-7  # of a frame


def read(speeds: Vec4, valid: bool = True) -> FourReadings:
    a, b, c, d = (WheelReading(w, valid=valid) for w in speeds)
    return (a, b, c, d)


def deliver(sent: Vec4, health: WheelHealth, speeds: Vec4) -> list[float]:
    """Torque on the body of wheels with these gains and frictions: C tau + drag, which pushes along the spin."""
    return [
        d * t * tau + (0.002 + f) * math.tanh(w / 0.5) + 3.9e-5 * w
        for tau, d, t, f, w in zip(
            sent, health.driver_gain, health.torque_gain, health.friction_nm, speeds, strict=True
        )
    ]


def test_nothing_is_added_unless_told() -> None:
    """By default the commands are those of before, and what is sent is what is meant."""
    drive = Drive(DriveConfig(), Vehicle(MODEL))
    sick = WheelHealth(torque_gain=(0.5, 0.5, 0.5, 0.5), friction_nm=(1e-3,) * 4, available=(True, False, True, True))
    for health in (HEALTHY, sick):
        commands = drive.command(ASKED, health, read(SPEEDS))
        assert commands == command_wheels(ASKED, health)
        assert commands.meant_nm == commands.tau_rw_nm
        assert drive.see(health) is health


def test_drag_is_made_up_for() -> None:
    """The torque that arrives on the body of wheels with nominal drag is the one asked for, at any speed and sense."""
    drive = Drive(DriveConfig(friction="nominal"), Vehicle(MODEL))
    commands = drive.command(ASKED, HEALTHY, read(SPEEDS))
    assert deliver(commands.tau_rw_nm, HEALTHY, SPEEDS) == pytest.approx(ASKED, abs=STEP_NM)
    assert commands.meant_nm == pytest.approx(ASKED, abs=STEP_NM)
    assert commands.tau_rw_nm[0] == pytest.approx(5e-3 - 0.0059, abs=STEP_NM)  # the rotor is to be sped up against drag
    silent = drive.command(ASKED, HEALTHY, read(SPEEDS, valid=False))
    assert silent.tau_rw_nm == pytest.approx(ASKED, abs=STEP_NM)  # a speed not known is not made up for


def test_estimated_gain_and_friction_are_made_up_for() -> None:
    """Gains and friction from wheel health: again what arrives is what was asked for, and it is meant so."""
    health = WheelHealth(
        driver_gain=(0.8, 1.0, 1.0, 1.0), torque_gain=(0.75, 0.6, 1.1, 1.0), friction_nm=(1e-3, 0.0, 5e-4, 0.0)
    )
    commands = Drive(BOTH, Vehicle(MODEL)).command(ASKED, health, read(SPEEDS))
    assert deliver(commands.tau_rw_nm, health, SPEEDS) == pytest.approx(ASKED, abs=STEP_NM)
    assert commands.meant_nm == pytest.approx(ASKED, abs=STEP_NM)


def test_what_is_meant_is_what_the_motor_can_do() -> None:
    """A command beyond 5 V is cut there, and what is meant is what then arrives; a gain below 0.1 counts as 0.1."""
    health = WheelHealth(torque_gain=(0.5, 0.01, 1.0, 1.0))
    asked: Vec4 = (0.0275, 2e-3, 0.0, 0.0)
    commands = Drive(BOTH, Vehicle(MODEL)).command(asked, health, read((-100.0, 0.0, 0.0, 0.0)))
    most = 5.0 * 0.19 * 0.029
    assert commands.tau_rw_nm[0] == pytest.approx(most, abs=STEP_NM)
    assert commands.meant_nm[0] == pytest.approx(0.5 * most - 0.0059, abs=STEP_NM)
    assert commands.tau_rw_nm[1] == pytest.approx(0.02, abs=STEP_NM)
    off = replace_available(health, (False, True, True, True))
    commands = Drive(BOTH, Vehicle(MODEL)).command(asked, off, read((-100.0, 0.0, 0.0, 0.0)))
    assert (commands.modes[0], commands.tau_rw_nm[0], commands.meant_nm[0]) == (0, 0.0, 0.0)


def replace_available(health: WheelHealth, available: tuple[bool, bool, bool, bool]) -> WheelHealth:
    return WheelHealth(health.effectiveness, available, torque_gain=health.torque_gain)


def test_a_gain_is_made_up_for_once() -> None:
    """Where the drive does it, law and allocator see full shares but for wheels that are off, and nothing explained."""
    health = WheelHealth((0.5, 1.0, 0.0, 1.0), (True, True, False, True), explained_b_nm=(1e-3, 0.0, 0.0))
    seen = Drive(DriveConfig(gain="estimated"), Vehicle(MODEL)).see(health)
    assert seen.effectiveness == (1.0, 1.0, 0.0, 1.0)
    assert seen.available == health.available
    assert seen.explained_b_nm == (0.0, 0.0, 0.0)
    assert Drive(DriveConfig(friction="nominal"), Vehicle(MODEL)).see(health) is health


def test_drag_of_a_motor_that_is_not_known_is_refused() -> None:
    """With the key and the way out; a wheel that is not fitted needs no motor."""
    with pytest.raises(
        ConfigError, match=r"drive\.friction: nominal .* model\.wheels\[0\]\.motor is not given; give it"
    ):
        Drive(DriveConfig(friction="nominal"), Vehicle(replace(MODEL, wheel_motor=None)))
    axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.6, 0.8, 0.0))
    a, b, c, d = (WheelModelConfig(axis_b=axis, motor=WheelMotorConfig()) for axis in axes)
    Drive(
        DriveConfig(friction="nominal"),
        Vehicle(replace(MODEL, wheels=(a, b, c, replace(d, motor=None, fitted=False)))),
    )


def test_gains_that_nobody_estimates_are_refused() -> None:
    """With both ways out: the shares of another monitor are the allocator's."""
    with pytest.raises(ConfigError, match=r"drive\.gain: estimated .* share_learner estimates none; take wheel_health"):
        Drive(DriveConfig(gain="estimated"), Vehicle(MODEL), "share_learner")
    Drive(DriveConfig(friction="nominal"), Vehicle(MODEL), "share_learner")


def test_presets_and_values_beside_them() -> None:
    """A value given wins over the preset's."""
    motor = Vehicle(MODEL).wheel_motors[0]
    assert motor is not None
    assert motor.max_torque_nm == pytest.approx(0.02755)
    assert motor.find_drag(100.0) == pytest.approx(0.0059)
    other = Vehicle(replace(MODEL, wheel_motor=WheelMotorConfig(preset="rw100", coulomb_nm=0.001))).wheel_motors[3]
    assert other is not None
    assert other.max_torque_nm == pytest.approx(0.12)
    assert other.coulomb_nm == 0.001


def test_a_wheel_that_is_not_fitted_takes_no_part() -> None:
    """Its axis is nowhere: nothing is allocated to it, and its readings add no momentum."""
    axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.6, 0.8, 0.0))
    a, b, c, d = (WheelModelConfig(axis_b=axis) for axis in axes)
    wheels = Vehicle(replace(MODEL, wheels=(a, b, c, replace(d, fitted=False)))).wheels
    assert wheels.spread((1e-2, 2e-2, -3e-2)) == pytest.approx((1e-2, 2e-2, -3e-2, 0.0))
    assert wheels.combine((0.0, 0.0, 0.0, 5.0)) == (0.0, 0.0, 0.0)
    assert wheels.count_axes((True, True, True, True)) == 3
    assert wheels.count_axes((True, True, False, True)) == 2
    with pytest.raises(ConfigError, match="lie in one plane"):
        Vehicle(replace(MODEL, wheels=(a, b, replace(c, fitted=False), d)))


def test_null_space_and_what_is_added_of_it() -> None:
    """No torque on the body; cut by one factor to what every wheel's limit leaves."""
    wheels = Vehicle(MODEL).wheels
    null = wheels.find_null((True, True, True, True))
    assert max(map(abs, null)) == 1.0
    assert wheels.combine(null) == pytest.approx((0.0, 0.0, 0.0), abs=1e-15)
    assert wheels.find_null((True, True, True, False)) == (0.0, 0.0, 0.0, 0.0)
    busy: Vec4 = (0.02, 0.0, 0.0, 0.0275)
    a, b, c, d = null
    more: Vec4 = (0.01 * a, 0.01 * b, 0.01 * c, 0.01 * d)
    assert wheels.add_within(busy, more) == busy
    free: Vec4 = (0.02, 0.0, 0.0, 0.0225)
    added = np.subtract(wheels.add_within(free, more), free)
    assert added == pytest.approx(0.5 * np.array(more))
    assert wheels.add_within((0.0, 0.0, 0.0, 0.0), more) == pytest.approx(more)


@pytest.mark.parametrize(
    ("available", "axes"),
    [((1, 1, 1, 1), 3), ((0, 1, 1, 1), 3), ((0, 0, 1, 1), 2), ((0, 0, 0, 1), 1), ((0, 0, 0, 0), 0)],
)
def test_axes_left(available: tuple[int, ...], axes: int) -> None:
    """Rank of the axes that are in use, as numpy finds it."""
    use = tuple(map(bool, available))
    wheels = Vehicle(MODEL).wheels
    assert wheels.count_axes(use) == axes  # type: ignore[arg-type]
    assert np.linalg.matrix_rank(np.array(wheels.axes_b)[list(use)]) == axes if any(use) else axes == 0
