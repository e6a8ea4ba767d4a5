"""The figures of a shootout against closed forms, on series made up for them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from tools.shootout.figures import (
    Series,
    find_energy_j,
    find_figures,
    find_settling_s,
    find_steady_deg,
    list_unknown,
)

TICK_S = 0.1


def make_series(count: int = 1000, **changes: object) -> Series:
    """A body at rest on its target with idle wheels, but for the changes; one control period a tick."""
    t_s = np.arange(count) * TICK_S
    series = Series(
        end_s=count * TICK_S,
        t_s=t_s,
        error_deg=np.zeros(count),
        speed_rad_s=np.zeros((count, 4)),
        tau_rw_true_nm=np.zeros((count, 4)),
        control_t_s=t_s,
        tau_cmd_b_nm=np.zeros((count, 3)),
        tau_rw_cmd_nm=np.zeros((count, 4)),
        mode=np.full(count, 2.0),
        max_torque_nm=np.full(4, 0.1),
    )
    return replace(series, **changes)  # type: ignore[arg-type]


def test_nothing_done_is_nothing_spent() -> None:
    """At rest on target: settled from the start, no cost, pointing all the time."""
    figures = find_figures(make_series())
    assert (figures.settled_5_deg_s, figures.settled_1_deg_s, figures.settled_01_deg_s) == (0.0, 0.0, 0.0)
    assert figures.pointing_share == pytest.approx(1.0)
    costs = ("steady_deg", "impulse_nms", "peak_rw_nm", "variation_nm_s", "energy_j", "effort_n2m2s", "saturated_share")
    assert [getattr(figures, cost) for cost in costs] == [0.0] * len(costs)


def test_impulse_is_torque_times_time() -> None:
    """(0.03, -0.04, 0) N m for the first quarter of 100 s: 0.05 N m x 25 s, also where control runs on every tenth tick."""
    torque = np.zeros((1000, 3))
    torque[:250] = (0.03, -0.04, 0.0)
    assert find_figures(make_series(tau_cmd_b_nm=torque)).impulse_nms == pytest.approx(1.25, rel=1e-12)
    tenth = slice(None, None, 10)
    series = make_series()
    sparse = replace(
        series,
        control_t_s=series.t_s[tenth],
        tau_cmd_b_nm=torque[tenth],
        tau_rw_cmd_nm=series.tau_rw_cmd_nm[tenth],
        mode=series.mode[tenth],
    )
    assert find_figures(sparse).impulse_nms == pytest.approx(1.25, rel=1e-12)


def test_the_last_command_holds_to_the_end() -> None:
    """A torque that is commanded on the last period alone counts for that period."""
    torque = np.zeros((1000, 3))
    torque[-1] = (0.0, 0.0, 2.0)
    assert find_figures(make_series(tau_cmd_b_nm=torque)).impulse_nms == pytest.approx(2.0 * TICK_S)


def test_effort_of_a_sine() -> None:
    """A sin(2 pi t / 10 s) on one wheel for whole periods: the integral of its square is A^2 T / 2, held samples too."""
    commands = np.zeros((1000, 4))
    commands[:, 1] = 0.08 * np.sin(2.0 * math.pi * np.arange(1000) / 100.0)
    figures = find_figures(make_series(tau_rw_cmd_nm=commands))
    assert figures.effort_n2m2s == pytest.approx(0.5 * 0.08**2 * 100.0, rel=1e-12)
    assert figures.peak_rw_nm == pytest.approx(0.08)


def test_variation_of_a_square_wave_and_of_a_ramp() -> None:
    """A square wave of 0.02 N m on every sample: 0.04 N m a change; a ramp varies by its rise, however it is cut."""
    commands = np.zeros((1000, 4))
    commands[:, 2] = 0.02 * (-1.0) ** np.arange(1000)
    assert find_figures(make_series(tau_rw_cmd_nm=commands)).variation_nm_s == pytest.approx(999 * 0.04 / 100.0)
    commands[:, 2] = np.linspace(-0.05, 0.05, 1000)
    assert find_figures(make_series(tau_rw_cmd_nm=commands)).variation_nm_s == pytest.approx(0.1 / 100.0)


def test_energy_of_a_wheel_that_is_driven_through_zero() -> None:
    """0.1 N m from -3 to 1 rad/s within one tick of 2 s: |omega| is two triangles, (9 + 1) / (2 x 4) x 2 s."""
    t_s, speed = np.array([0.0, 2.0]), np.zeros((2, 4))
    speed[:, 3] = (-3.0, 1.0)
    torque = np.array([[9.0] * 4, [0.0, 0.0, 0.0, -0.1]])  # the first sample is of before the start
    assert find_energy_j(t_s, torque, speed) == pytest.approx(0.1 * 1.25 * 2.0, rel=1e-12)


def test_energy_is_that_of_quadrature() -> None:
    """Straight lines between samples, a constant torque on each: scipy's quadrature of |tau omega|, tick by tick."""
    r = np.random.default_rng(7)
    t_s = np.cumsum(r.uniform(0.05, 0.2, 30))
    speed, torque = r.normal(size=(30, 4)), r.normal(size=(30, 4))
    speed[5:8, 0] = 0.0
    expected = 0.0
    for k in range(1, 30):
        for wheel in range(4):
            a, b, span = speed[k - 1, wheel], speed[k, wheel], t_s[k] - t_s[k - 1]
            zero = [a / (a - b)] if a * b < 0.0 else None
            mean, _ = quad(lambda x, a=a, b=b: abs(a + (b - a) * x), 0.0, 1.0, points=zero)
            expected += abs(torque[k, wheel]) * mean * span
    assert find_energy_j(t_s, torque, speed) == pytest.approx(expected, rel=1e-9)


def test_saturated_is_one_wheel_at_its_own_limit() -> None:
    """Wheels of 0.1 and 0.02 N m: 0.02 is a tenth of the time all of the second, and never of the others."""
    commands = np.full((1000, 4), 0.015)
    commands[100:200, 1] = -0.02
    series = make_series(tau_rw_cmd_nm=commands, max_torque_nm=np.array([0.1, 0.02, 0.1, 0.1]))
    assert find_figures(series).saturated_share == pytest.approx(0.1)


def test_pointing_is_point_and_degraded() -> None:
    """Standby, detumble and safe are not; a tenth of the time in each of five modes is 0.2 of half."""
    mode = np.repeat([0.0, 1.0, 2.0, 3.0, 4.0], 200)
    assert find_figures(make_series(mode=mode)).pointing_share == pytest.approx(0.4)


@pytest.mark.parametrize("bound_deg", [5.0, 1.0, 0.1])
def test_settling_of_a_decay(bound_deg: float) -> None:
    """60 deg exp(-t / 8 s) is above the bound until 8 s ln(60 / bound): the last sample before it."""
    t_s = np.arange(1000) * TICK_S
    expected = math.floor(8.0 * math.log(60.0 / bound_deg) / TICK_S) * TICK_S
    assert find_settling_s(t_s, 60.0 * np.exp(-t_s / 8.0), bound_deg, 100.0) == pytest.approx(expected)


@pytest.mark.parametrize(("end_s", "quiet_s"), [(300.0, 15.0), (100.0, 10.0)])
def test_what_exceeds_the_bound_near_the_end_has_not_settled(end_s: float, quiet_s: float) -> None:
    """A single sample above the bound within the quiet time is enough, and so is one that is not known."""
    t_s = np.arange(round(end_s / TICK_S)) * TICK_S
    for bad in (2.0, math.nan):
        error = np.zeros_like(t_s)
        error[round((end_s - quiet_s + 1.0) / TICK_S)] = bad
        assert find_settling_s(t_s, error, 1.0, end_s) is None
        error = np.zeros_like(t_s)
        error[round((end_s - quiet_s - 1.0) / TICK_S)] = bad
        assert find_settling_s(t_s, error, 1.0, end_s) == pytest.approx(end_s - quiet_s - 1.0)


def test_steady_error_is_of_the_end_alone() -> None:
    """60 deg for 270 s, then 0.3 deg with a spike: the median of the last 30 s is 0.3 deg."""
    t_s = np.arange(3000) * TICK_S
    error = np.where(t_s < 270.0, 60.0, 0.3)
    error[2950] = 9.0
    assert find_steady_deg(t_s, error, 300.0) == 0.3


def test_a_figure_that_is_no_number_is_named() -> None:
    """An infinite torque makes four figures unknown; a time that is not there is no unknown figure."""
    commands = np.zeros((1000, 4))
    commands[3, 0] = math.inf
    figures = find_figures(make_series(tau_rw_cmd_nm=commands, error_deg=np.full(1000, 50.0)))
    assert figures.settled_5_deg_s is None
    assert list_unknown(figures) == ["peak_rw_nm", "variation_nm_s", "effort_n2m2s"]
