"""Weights and error equation for any rate that hypothesis can think of."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bus.linear import invert_symmetric
from fsw.gyro_fdi.ts_model import OPERATING_RATE_RAD_S, VERTEX_SIGNS, clip_premise, make_f, weigh_exact9
from tools.design.ts_design import INERTIAS

any_rate = st.tuples(*(st.floats(-1e6, 1e6) for _ in range(3)))
rates = st.tuples(*(st.floats(-0.5, 0.5) for _ in range(3)))


@given(any_rate)
def test_weights_are_a_convex_combination(z: tuple[float, float, float]) -> None:
    """Never negative, sum one to 1e-12, whatever the rate; the mean of the points is the clipped rate."""
    h = weigh_exact9(z)
    assert min(h) >= 0.0
    assert abs(sum(h) - 1.0) < 1e-12
    mean = np.array(h) @ (OPERATING_RATE_RAD_S * np.array(VERTEX_SIGNS))
    assert np.abs(mean - np.array(clip_premise(z))).max() < 1e-12


@given(rates, rates, st.tuples(*(st.floats(-10, 10) for _ in range(3))), st.sampled_from(sorted(INERTIAS)))
def test_error_equation_is_exact(
    x: tuple[float, float, float], xh: tuple[float, float, float], h: tuple[float, float, float], name: str
) -> None:
    """The difference of two rigid-body accelerations is F(mean rate, h) times the difference of the rates."""
    j = np.array(INERTIAS[name])

    def accelerate(w: np.ndarray) -> np.ndarray:
        return np.linalg.solve(j, -np.cross(w, j @ w + np.array(h)))

    e = np.array(x) - np.array(xh)
    middle = tuple((0.5 * (np.array(x) + np.array(xh))).tolist())
    f = np.array(make_f(INERTIAS[name], invert_symmetric(INERTIAS[name]), middle, h))  # type: ignore[arg-type]
    assert np.abs(accelerate(np.array(x)) - accelerate(np.array(xh)) - f @ e).max() < 1e-12
