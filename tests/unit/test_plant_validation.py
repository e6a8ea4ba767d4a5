"""Settings that fit no plant are refused, all at once, with the numbers; external torques against their formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bus.errors import ConfigError
from plant_server.config import (
    BodyConfig,
    ConstantTorque,
    ExclusionConfig,
    GravityGradient,
    PlantConfig,
    SinusoidalTorque,
    StarTrackerConfig,
    WheelConfig,
)
from plant_server.environment import Environment, find_orbital_rate
from plant_server.plant import Plant
from plant_server.validation import explain_inertia, validate

SLOW = StarTrackerConfig(rate_hz=1.0)
J = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))
WHEELS = tuple(WheelConfig(mount=mount) for mount in ("x", "y", "z", "skew"))


def make_config(inertia=J, wheels=WHEELS, attitude=(1.0, 0.0, 0.0, 0.0), **settings):
    return PlantConfig(body=BodyConfig(inertia_kgm2=inertia, attitude_q=attitude), wheels=wheels, **settings)


def test_a_sound_plant_has_no_problems():
    """The published satellite on a 10 Hz loop."""
    assert validate(make_config(), 0.1) == []


@pytest.mark.parametrize(
    ("config", "tick_s", "path", "word"),
    [
        (make_config(((45, 3, 2), (1, 38, 0), (2, 0, 50))), 0.1, ("body", "inertia_kgm2"), "row 1 column 2 is 3"),
        (make_config(((1, 2, 0), (2, 1, 0), (0, 0, 1))), 0.1, ("body", "inertia_kgm2"), "moments are -1, 1, 3"),
        (make_config(((1, 0, 0), (0, 2, 0), (0, 0, 4))), 0.1, ("body", "inertia_kgm2"), "sum of the others, 3"),
        (make_config(attitude=(0.0,) * 4), 0.1, ("body", "attitude_q"), "length 0"),
        (make_config(step_s=0.03), 0.1, ("step_s",), "near: 0.025 s"),
        (make_config(step_s=0.1), 0.01, ("step_s",), "near: 0.01 s"),
        (make_config(wheels=(WheelConfig(mount="x", speed_rad_s=-2e3), *WHEELS[1:])), 0.1,
         ("wheels", 0, "speed_rad_s"), "beyond max_speed_rad_s, 1000"),
        (make_config(wheels=(*WHEELS[:3], WheelConfig(mount="skew", viscous_nm_s=2.0))), 0.1,
         ("wheels", 3, "viscous_nm_s"), "at most 1"),
        (make_config(star_tracker=StarTrackerConfig(rate_hz=3.0)), 0.1, ("star_tracker", "rate_hz"), "near: 2.5 Hz"),
        (make_config(star_tracker=StarTrackerConfig(rate_hz=20.0)), 0.1, ("star_tracker", "rate_hz"), "near: 10 Hz"),
        (make_config(star_tracker=StarTrackerConfig(latency_s=0.25)), 0.1, ("star_tracker", "latency_s"), "whole"),
        (make_config(star_tracker=StarTrackerConfig(latency_s=1.5)), 0.1, ("star_tracker", "latency_s"), "1.4 s"),
        (make_config(star_tracker=StarTrackerConfig(exclusion=ExclusionConfig(boresight_b=(0.0, 0.0, 0.0)))), 0.1,
         ("star_tracker", "exclusion", "boresight_b"), "no direction"),
    ],
)  # fmt: skip
def test_each_problem_is_found_at_its_key_with_numbers(config, tick_s, path, word):
    """One problem each; the message has the numbers and, where there is one, a value that would do."""
    (problem,) = validate(config, tick_s)
    assert problem.path == path
    assert word in problem.message


def test_a_plant_refuses_with_everything_at_once():
    """Settings and faults together, each line with its key."""
    bad = make_config(((1, 0, 0), (0, 2, 0), (0, 0, 4)), star_tracker=StarTrackerConfig(rate_hz=3.0))
    with pytest.raises(ConfigError) as caught:
        Plant(bad, (), 0.1, 0)
    lines = caught.value.problems
    assert [line.split(":")[0] for line in lines] == ["plant.body.inertia_kgm2", "plant.star_tracker.rate_hz"]
    with pytest.raises(ConfigError, match=r"plant\.wheels\[3\]\.viscous_nm_s"):
        Plant(make_config(wheels=(*WHEELS[:3], WheelConfig(mount="skew", viscous_nm_s=2.0))), (), 0.1, 0)


@given(
    st.tuples(*[st.floats(0.1, 100.0)] * 3),
    st.tuples(*[st.floats(-3.0, 3.0)] * 3),
)
def test_inertia_is_judged_by_its_principal_moments(moments, turn):
    """A tensor turned into any axes is possible exactly when its moments obey the triangle inequality."""
    low, middle, high = sorted(moments)
    r = Rotation.from_rotvec(turn).as_matrix()
    tensor = r @ np.diag(moments) @ r.T
    tensor = 0.5 * (tensor + tensor.T)
    word = explain_inertia(tuple(tuple(row) for row in tensor.tolist()))
    if high < (low + middle) * (1 - 1e-9):
        assert word is None
    elif high > (low + middle) * (1 + 1e-6):
        assert word is not None
        assert "triangle" in word


# -- external torques ----------------------------------------------------------------------------------------------


def test_constant_and_sinusoidal_torques_add_up():
    """d(t) is the sum of the configured terms, with period and phase per axis."""
    torques = (
        ConstantTorque(kind="constant", torque_nm=(1e-3, 0.0, -2e-3)),
        SinusoidalTorque(
            kind="sinusoidal", amplitude_nm=(1e-3, 2e-3, 3e-3), period_s=50.0, phase_deg=(0.0, 90.0, -30.0)
        ),
    )
    environment = Environment(torques, J)
    for t in (0.0, 7.0, 31.0):
        angle = 2.0 * math.pi * t / 50.0
        expected = (
            1e-3 + 1e-3 * math.sin(angle),
            2e-3 * math.cos(angle),
            -2e-3 + 3e-3 * math.sin(angle - math.pi / 6),
        )
        np.testing.assert_allclose(environment.sum_torques(t, (1.0, 0.0, 0.0, 0.0)), expected, atol=1e-17)


def test_gravity_gradient_is_three_n_squared_o_cross_j_o():
    """Against the formula in numpy at a general attitude; n of a 500 km orbit gives a period of 94.6 min."""
    orbit = GravityGradient(kind="gravity_gradient", altitude_km=500.0)
    n = find_orbital_rate(orbit)
    assert 2.0 * math.pi / n / 60.0 == pytest.approx(94.6, abs=0.05)
    q = (0.5, -0.5, 0.5, 0.5)
    t = 700.0
    o = Rotation.from_quat([-0.5, 0.5, 0.5, 0.5]).apply([math.cos(n * t), math.sin(n * t), 0.0], inverse=True)
    expected = 3.0 * n * n * np.cross(o, np.array(J) @ o)
    np.testing.assert_allclose(Environment((orbit,), J).sum_torques(t, q), expected, rtol=1e-12)


def test_a_gravity_gradient_librates_at_its_natural_frequency():
    """Pitch of an axisymmetric body about the orbit normal: theta'' = -3 n^2 (B - A)/C theta for small theta.

    Its own axis A along the vertical, turning with the orbit; the whole plant integrates it for a third of a period.
    """
    a, b, c = 10.0, 40.0, 42.0
    inertia = ((a, 0.0, 0.0), (0.0, b, 0.0), (0.0, 0.0, c))
    orbit = GravityGradient(kind="gravity_gradient", altitude_km=500.0)
    n = find_orbital_rate(orbit)
    start = math.radians(1.0)
    tiny = tuple(WheelConfig(mount=m, inertia_kgm2=1e-9) for m in ("x", "y", "z", "skew"))
    body = BodyConfig(
        inertia_kgm2=inertia,
        attitude_q=(math.cos(start / 2), 0.0, 0.0, math.sin(start / 2)),
        rate_deg_s=(0.0, 0.0, math.degrees(n)),
    )
    plant = Plant(PlantConfig(body=body, wheels=tiny, torques=(orbit,), step_s=0.1, star_tracker=SLOW), (), 1.0, 0)
    frequency = n * math.sqrt(3.0 * (b - a) / c)
    for k in range(1, 1301):
        plant.step((0.0,) * 4)
        if k % 100 == 0:
            q = plant.truth().q_ib
            pitch = 2.0 * math.atan2(q[3], q[0]) - n * k
            assert pitch == pytest.approx(start * math.cos(frequency * k), abs=2e-3 * start)


def test_an_external_torque_changes_momentum_by_its_impulse():
    """Inertial momentum after t is the integral of R d: a body turning slowly under a torque fixed in the body."""
    torque = ConstantTorque(kind="constant", torque_nm=(0.0, 0.0, 1e-2))
    plant = Plant(make_config(((40, 0, 0), (0, 40, 0), (0, 0, 50)), torques=(torque,)), (), 0.1, 0)
    for _ in range(600):
        plant.step((0.0,) * 4)
    np.testing.assert_allclose(plant.truth().h_total_i_nms, (0.0, 0.0, 0.6), atol=1e-12)
    np.testing.assert_allclose(plant.truth().tau_ext_b_nm, (0.0, 0.0, 1e-2), atol=1e-17)
