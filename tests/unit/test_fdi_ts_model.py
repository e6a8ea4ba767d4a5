"""The nine-point model: weights, matrices, and the exact error equation of an observer with its own premise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bus.linear import invert_symmetric
from fsw.gyro_fdi import ts_model
from fsw.gyro_fdi.ts_model import OPERATING_RATE_RAD_S, VERTEX_SIGNS, make_a, make_f, weigh_exact9

DATA = np.load(Path(__file__).parents[1] / "data" / "gyro" / "ts_model.npz")
J = tuple(tuple(float(v) for v in row) for row in DATA["J"])
J_INV = invert_symmetric(J)  # type: ignore[arg-type]


def test_points_and_matrices_match_the_reference() -> None:
    """Operating points, A_i and F_i are the independent closed forms, in the reference's order."""
    for signs, point, a, f in zip(VERTEX_SIGNS, DATA["OP"], DATA["A_i"], DATA["F_i"], strict=True):
        w = tuple(OPERATING_RATE_RAD_S * s for s in signs)
        assert np.array(w) == pytest.approx(point, abs=1e-15)
        assert np.abs(np.array(make_a(J, J_INV, w)) - a).max() < 1e-12  # type: ignore[arg-type]
        assert np.abs(np.array(make_f(J, J_INV, w)) - f).max() < 1e-12  # type: ignore[arg-type]


def test_weights_match_the_reference() -> None:
    """The weights agree with the reference to 1e-12, inside the cube and outside."""
    for z, h in zip(DATA["z"], DATA["h_exact9"], strict=True):
        assert np.array(weigh_exact9(tuple(z))) == pytest.approx(h, abs=1e-12)


def test_interpolation_is_exact_in_the_cube_and_clipped_outside() -> None:
    """sum h_i A_i is A(z) itself in the cube, because A is linear in the rate."""
    for z, exact, inside in zip(DATA["z"], DATA["A_exact"], DATA["inside"], strict=True):
        h = np.array(weigh_exact9(tuple(z)))
        a_ts = np.einsum("i,ijk->jk", h, DATA["A_i"])
        clipped = np.array(make_a(J, J_INV, ts_model.clip_premise(tuple(z))))  # type: ignore[arg-type]
        assert np.abs(a_ts - clipped).max() < 1e-12
        if inside:
            assert np.abs(a_ts - exact).max() < 1e-12
        assert ts_model.is_inside(tuple(z)) == bool(inside)
