"""Modified Rodrigues parameters: the kernel against recorded values, closed forms and the quaternion; which set is used."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.attitude import dcm_from_quaternion, exp_map, multiply, normalise, quaternion_from_mrp, shadow_mrp
from bus.units import Vec3, Vec4
from fsw.guidance.guidance import HYSTERESIS_Q0, Guidance
from fsw.mrp import ShadowSwitch, find_kinematics, find_mrp, find_mrp_error, find_rotation, shorten

RECORD = np.load(Path(__file__).resolve().parents[1] / "data" / "control" / "ft_functions.npz")
ZERO: Vec3 = (0.0, 0.0, 0.0)
component = st.floats(-1.5, 1.5)
sigmas = st.tuples(component, component, component)
quaternions = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: math.hypot(*q) > 1e-3).map(lambda q: normalise(q))  # type: ignore[arg-type]
)


def test_kernel_gives_the_recorded_values() -> None:
    """Kinematics, rotation, error and shadow of 100 random sets, from an independent implementation, to 1e-12."""
    for k, (s, d, any_) in enumerate(
        zip(*(RECORD[key].tolist() for key in ("sigma", "sigma_d", "sigma_any")), strict=True)
    ):
        assert np.abs(np.array(find_kinematics(tuple(s))) - RECORD["G"][k]).max() < 1e-12
        assert np.abs(np.array(find_rotation(tuple(s))) - RECORD["R"][k]).max() < 1e-12
        assert find_mrp_error(tuple(s), tuple(d)) == pytest.approx(RECORD["sigma_err"][k], abs=1e-12)
        assert shorten(tuple(any_)) == pytest.approx(RECORD["sigma_shadowed"][k], abs=1e-12)


@given(sigma=sigmas)
def test_kinematics_have_the_identities_of_the_proof(sigma: Vec3) -> None:
    """G^T G = ((1 + s.s)/4)^2 I and s^T G = (1 + s.s)/4 s^T, for both sets."""
    s, g = np.array(sigma), np.array(find_kinematics(sigma))
    k = 0.25 * (1.0 + s @ s)
    assert g.T @ g == pytest.approx(k * k * np.eye(3), abs=1e-12)
    assert s @ g == pytest.approx(k * s, abs=1e-12)


@given(q=quaternions, w=sigmas)
def test_kinematics_are_those_of_the_quaternion(q: Vec4, w: Vec3) -> None:
    """sigma' = (q_v' - sigma q0')/(1 + q0), from q' = q (0, w)/2: the same as G w, also beyond the half turn."""
    if q[0] < -0.4:
        q = (-q[0], -q[1], -q[2], -q[3])
    sigma = find_mrp(q)
    rate = 0.5 * np.array(multiply(q, (0.0, *w)))
    expected = (rate[1:] - np.array(sigma) * rate[0]) / (1.0 + q[0])
    assert np.array(find_kinematics(sigma)) @ np.array(w) == pytest.approx(expected, abs=1e-12)


@given(q=quaternions)
def test_rotation_is_that_of_the_quaternion(q: Vec4) -> None:
    """Both sets and q turn a vector alike; the set of q is that of q, not of -q, down to q0 = -0.5."""
    sigma = find_mrp(q)
    assert np.array(find_rotation(sigma)) == pytest.approx(np.array(dcm_from_quaternion(q)).T, abs=1e-12)
    if q[0] >= -0.5:
        assert quaternion_from_mrp(sigma) == pytest.approx(q, abs=1e-12)
    if math.hypot(*sigma) > 0.1:
        assert np.array(find_rotation(shadow_mrp(sigma))) == pytest.approx(np.array(find_rotation(sigma)), abs=1e-12)


@given(a=quaternions, b=quaternions)
def test_error_is_that_of_the_quaternions(a: Vec4, b: Vec4) -> None:
    """R(sigma_e) = R(sigma) R(sigma_d)^T, which also says that the set is a set of the right attitude; never a long one."""
    error = find_mrp_error(find_mrp(a), find_mrp(b))
    expected = np.array(dcm_from_quaternion(a)).T @ np.array(dcm_from_quaternion(b))
    assert np.array(find_rotation(error)) == pytest.approx(expected, abs=1e-9)
    assert math.hypot(*error) <= 1.0 + 1e-12


def test_error_where_its_quotient_has_no_value() -> None:
    """A whole turn apart, sigma being the shadow of the target's set, is no error at all."""
    target = (0.3, -0.2, 0.5)
    assert find_mrp_error(shadow_mrp(target), target) == pytest.approx(ZERO, abs=1e-12)
    assert find_mrp_error(target, target) == pytest.approx(ZERO, abs=1e-15)


@pytest.mark.parametrize("q0", [-1.0, -0.75, -0.5, 0.0, 1.0])
def test_parameters_stay_bounded_whatever_the_sign(q0: float) -> None:
    """A caller that does not choose a sign gets finite parameters, at q0 = -1 too: at most tan(60 deg) long."""
    sigma = find_mrp((q0, math.sqrt(1.0 - q0 * q0), 0.0, 0.0))
    assert math.hypot(*sigma) <= math.sqrt(3.0) + 1e-12


# -- which of the two sets ---------------------------------------------------------------------------------------------


def turn(angle_deg: float) -> Vec3:
    """The short set of a turn about an axis."""
    return shorten(find_mrp(exp_map((0.0, 0.6 * math.radians(angle_deg), 0.8 * math.radians(angle_deg)))))


def count_changes(sigmas: list[Vec3]) -> int:
    return sum(sum(a * b for a, b in zip(s, t, strict=True)) < 0.0 for s, t in itertools.pairwise(sigmas))


def test_switch_keeps_its_side_under_noise_and_gives_in_beyond() -> None:
    """Noise of a degree about the half turn: without hysteresis the set changes all the time, with it never; a body that
    goes on turning changes it once."""
    rng = np.random.default_rng(1)
    noisy = [turn(180.0 + float(x)) for x in rng.normal(0.0, 1.0, 400)]
    plain, kept = ShadowSwitch(1.0), ShadowSwitch()
    assert count_changes([plain.choose(s) for s in noisy]) > 100
    chosen = [kept.choose(s) for s in noisy]
    assert count_changes(chosen) == 0
    assert max(math.hypot(*s) for s in chosen) > 1.0
    going = ShadowSwitch()
    chosen = [going.choose(turn(float(angle))) for angle in np.arange(90.0, 270.0, 0.1)]
    assert count_changes(chosen) == 1
    squares = [sum(x * x for x in s) for s in chosen]
    assert max(squares) == pytest.approx(1.1, abs=2e-3)


@given(sigma=sigmas.filter(lambda s: math.hypot(*s) > 0.05), most=st.floats(1.0, 2.0))
def test_switch_gives_one_of_the_two_sets_within_its_threshold(sigma: Vec3, most: float) -> None:
    """Whatever comes, what is chosen is the same attitude; and after a reset the short set."""
    switch = ShadowSwitch(most)
    switch.choose((-sigma[0], -sigma[1], -sigma[2]))
    chosen = switch.choose(sigma)
    assert np.array(find_rotation(chosen)) == pytest.approx(np.array(find_rotation(sigma)), abs=1e-9)
    assert sum(x * x for x in chosen) <= most * (1.0 + 1e-12)
    switch.reset()
    assert math.hypot(*switch.choose(sigma)) <= 1.0 + 1e-12


def test_law_takes_the_set_that_guidance_chose() -> None:
    """A body turning through the half turn: the parameters go on to |sigma|^2 = 1.1/0.9, and change sets once, with q_tb."""
    guidance = Guidance((1.0, 0.0, 0.0, 0.0))
    found = []
    for angle_deg in np.arange(90.0, 270.0, 0.1):
        half = math.radians(float(angle_deg)) / 2.0
        error = guidance.find_error((math.cos(half), 0.0, math.sin(half), 0.0), ZERO)
        found.append(find_mrp(error.q_tb))
    assert count_changes(found) == 1
    most = (1.0 + HYSTERESIS_Q0) / (1.0 - HYSTERESIS_Q0)
    assert max(sum(x * x for x in s) for s in found) == pytest.approx(most, abs=5e-3)
