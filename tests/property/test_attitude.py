"""Attitude conventions against scipy's Rotation, an independent implementation of the same rotations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bus import attitude

component = st.floats(-1.0, 1.0).filter(lambda x: x == 0.0 or abs(x) > 1e-150)
quaternions = st.tuples(component, component, component, component).filter(lambda q: math.hypot(*q) > 1e-2)
unit_quaternions = quaternions.map(attitude.normalise)
vectors = st.tuples(*[st.floats(-1e3, 1e3)] * 3)
rotation_vectors = st.tuples(*[st.floats(-1.8, 1.8)] * 3)  # shorter than pi
tiny_vectors = st.tuples(*[st.floats(-2e-3, 2e-3)] * 3)  # across the seam between series and closed form


def to_scipy(q):
    return Rotation.from_quat([q[1], q[2], q[3], q[0]])


def assert_same_rotation(ours, theirs, bound=1e-13):
    difference = (to_scipy(ours).inv() * theirs).magnitude()
    assert difference < bound


@given(quaternions)
def test_normalise_gives_unit_norm_along_the_same_line(q):
    """Unit norm to rounding, direction unchanged."""
    unit = attitude.normalise(q)
    assert math.hypot(*unit) == pytest.approx(1.0, abs=1e-15)
    np.testing.assert_allclose(np.array(unit) * math.hypot(*q), q, atol=1e-15)


@pytest.mark.parametrize("q", [(0.0, 0.0, 0.0, 0.0), (math.nan, 0.0, 0.0, 1.0), (math.inf, 0.0, 0.0, 1.0)])
def test_normalise_refuses_what_is_no_rotation(q):
    """Zero, NaN and infinite quaternions never become an attitude."""
    with pytest.raises(ValueError, match="norm"):
        attitude.normalise(q)


@given(unit_quaternions, unit_quaternions)
def test_product_is_composition(p, q):
    """p * q is the rotation q followed by p, as scipy composes them; so q_ac = q_ab * q_bc."""
    assert_same_rotation(attitude.multiply(p, q), to_scipy(p) * to_scipy(q))


@given(unit_quaternions, vectors)
def test_rotate_is_v_i_from_v_b(q, v):
    """rotate gives v_i = R v_b, rotate_back its inverse; both equal scipy's and the matrix's."""
    bound = 1e-12 * (1.0 + math.hypot(*v))
    np.testing.assert_allclose(attitude.rotate(q, v), to_scipy(q).apply(v), atol=bound)
    np.testing.assert_allclose(attitude.rotate_back(q, v), to_scipy(q).apply(v, inverse=True), atol=bound)
    np.testing.assert_allclose(np.array(attitude.dcm_from_quaternion(q)) @ v, attitude.rotate(q, v), atol=bound)


@given(unit_quaternions)
def test_dcm_round_trip(q):
    """The matrix equals scipy's; back from it comes the same attitude with q0 >= 0."""
    dcm = attitude.dcm_from_quaternion(q)
    np.testing.assert_allclose(dcm, to_scipy(q).as_matrix(), atol=1e-14)
    back = attitude.quaternion_from_dcm(dcm)
    assert back[0] >= 0.0
    assert_same_rotation(back, to_scipy(q), 1e-12)


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.6, 0.8, 0.0)])
def test_dcm_of_half_turns(axis):
    """Half turns, where q0 is zero and a naive formula divides by it, keep all digits."""
    q = (0.0, *axis)
    back = attitude.quaternion_from_dcm(attitude.dcm_from_quaternion(q))
    assert abs(abs(sum(a * b for a, b in zip(back, q, strict=True))) - 1.0) < 1e-15


@given(unit_quaternions)
def test_mrp_equals_scipy_and_shadow_is_the_same_attitude(q):
    """MRPs equal scipy's (|sigma| <= 1); the shadow set is the same rotation, and its own shadow's shadow."""
    sigma = attitude.mrp_from_quaternion(q)
    assert math.hypot(*sigma) <= 1.0 + 1e-15
    if abs(q[0]) > 1e-9:  # at half turns both sets are equally long
        np.testing.assert_allclose(sigma, to_scipy(q).as_mrp(), atol=1e-12)
    assert_same_rotation(attitude.quaternion_from_mrp(sigma), to_scipy(q), 1e-12)
    if math.hypot(*sigma) > 1e-6:
        shadow = attitude.shadow_mrp(sigma)
        assert_same_rotation(attitude.quaternion_from_mrp(shadow), to_scipy(q), 1e-9)
        np.testing.assert_allclose(attitude.shadow_mrp(shadow), sigma, rtol=1e-12)


def test_no_attitude_has_no_shadow():
    """The shadow of zero lies at infinity and is refused."""
    with pytest.raises(ValueError, match="infinity"):
        attitude.shadow_mrp((0.0, 0.0, 0.0))


@given(st.one_of(rotation_vectors, tiny_vectors))
def test_exp_and_log_equal_scipy(phi):
    """exp equals scipy's from_rotvec, log is its inverse, both also for tiny angles."""
    q = attitude.exp_map(phi)
    assert math.hypot(*q) == pytest.approx(1.0, abs=4e-16)
    x, y, z, w = Rotation.from_rotvec(phi).as_quat(canonical=True)
    np.testing.assert_allclose(attitude.canonical(q), (w, x, y, z), atol=2e-15)
    if math.hypot(*phi) < math.pi - 1e-6:
        np.testing.assert_allclose(attitude.log_map(q), phi, atol=1e-12, rtol=1e-13)


@given(unit_quaternions, unit_quaternions)
def test_error_quaternion_and_angle(q, target):
    """The error is the short rotation from target to body; the angle between attitudes is its length."""
    error = attitude.error_quaternion(q, target)
    assert error[0] >= 0.0
    assert_same_rotation(error, to_scipy(target).inv() * to_scipy(q))
    expected = (to_scipy(target).inv() * to_scipy(q)).magnitude()
    assert attitude.angle_between(target, q) == pytest.approx(expected, abs=1e-12)


@given(unit_quaternions, st.floats(1e-12, 1e-6))
def test_angle_keeps_its_digits_near_zero(q, angle):
    """A rotation of 1e-12 rad is measured as that; acos would give 0 or 2e-8."""
    turned = attitude.multiply(q, attitude.exp_map((0.0, angle, 0.0)))
    assert attitude.angle_between(q, turned) == pytest.approx(angle, abs=1e-15, rel=1e-3)


@given(unit_quaternions, rotation_vectors)
def test_kinematics_of_the_paper_is_the_hamilton_product(q, omega):
    """q0' = -1/2 q.w, q' = 1/2 (q x w + q0 w) is 1/2 q * (0, w), and a small turn exp(w dt) to first order."""
    scalar = -0.5 * np.dot(q[1:], omega)
    vector = 0.5 * (np.cross(q[1:], omega) + q[0] * np.array(omega))
    np.testing.assert_allclose(0.5 * np.array(attitude.multiply(q, (0.0, *omega))), (scalar, *vector), atol=1e-15)
    dt = 1e-6
    turned = attitude.multiply(q, attitude.exp_map(tuple(w * dt for w in omega)))
    np.testing.assert_allclose((np.array(turned) - q) / dt, (scalar, *vector), atol=1e-5)
