"""Direct allocation on wheel sets of all kinds, three to six wheels, against linear programs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from hypothesis import assume, given
from hypothesis import settings as tuning
from hypothesis import strategies as st
from scipy.optimize import linprog

from bus.units import Vec3
from fsw.allocators.attainable_set import AttainableSet

whole = st.integers(-5, 5)
# Whole numbers make many parallel and coplanar axes, and keep all others well apart
axes = st.tuples(whole, whole, whole).filter(any).map(lambda v: tuple(x / math.hypot(*v) for x in v))
shares = st.sampled_from((1.0, 0.6, 0.25, 1e-3, 0.0)) | st.floats(0.05, 1.0)
limits = st.sampled_from(((-1.0, 1.0), (-0.3, 0.3), (-1.0, 0.2), (0.0, 1.0), (-0.5, 0.0)))
alike = st.sampled_from(((-1.0, 1.0), (-0.3, 0.3)))
parts = st.integers(-10, 10).map(lambda k: 0.1 * k)  # no parts so small that a linear program passes them over


def wheels(of_limits: Any) -> Any:
    return st.lists(st.tuples(axes, shares, of_limits, parts), min_size=3, max_size=6)


def make(rows: list[Any]) -> tuple[AttainableSet, np.ndarray, np.ndarray, np.ndarray]:
    ways, share = [row[0] for row in rows], [row[1] for row in rows]
    low, high = [row[2][0] for row in rows], [row[2][1] for row in rows]
    return AttainableSet(ways, share, low, high), np.array(ways).T * share, np.array(low), np.array(high)


def draw_torque(rows: list[Any], matrix: np.ndarray, size: float) -> Vec3:
    """One that lies in the span of the wheels, of a given length."""
    tau = matrix @ [row[3] for row in rows]
    assume(np.linalg.norm(tau) > 1e-4)
    x, y, z = (tau * (size / np.linalg.norm(tau))).tolist()
    return (x, y, z)


def assert_is_allocation(found: AttainableSet, matrix: np.ndarray, low: Any, high: Any, tau: Vec3) -> float:
    """Within limits, the torque or all of it that can be had, and nothing of a wheel that gives nothing."""
    reach, commands = found.solve(tau)
    assert (np.array(commands) >= low).all()
    assert (np.array(commands) <= high).all()
    np.testing.assert_allclose(matrix @ commands, min(1.0, reach) * np.array(tau), rtol=0.0, atol=1e-12)
    assert not np.array(commands)[np.abs(matrix).sum(axis=0) == 0.0].any()
    np.testing.assert_allclose(matrix @ found.allocate_sorted(tau)[0], matrix @ commands, rtol=0.0, atol=1e-11)
    return reach


@given(rows=wheels(limits), size=st.sampled_from((1e-3, 0.1, 1.0, 10.0)))
@tuning(max_examples=80)
def test_reach_is_that_of_the_linear_program(rows: list[Any], size: float) -> None:
    """The largest factor of a torque within limits that may differ by sign, to 1e-9; torque and limits exact."""
    found, matrix, low, high = make(rows)
    tau = draw_torque(rows, matrix, size)
    reach = assert_is_allocation(found, matrix, low, high, tau)
    unit = np.array(tau) / size
    columns = np.column_stack([matrix, -unit])
    bounds = [*zip(low, high, strict=True), (0.0, None)]
    best = linprog([0.0] * len(rows) + [-1.0], A_eq=columns, b_eq=[0.0] * 3, bounds=bounds, method="highs")
    assert best.status == 0
    assert math.isclose(reach * size, best.x[-1], rel_tol=1e-9, abs_tol=1e-9)


@given(rows=wheels(alike), size=st.sampled_from((1e-3, 0.1, 1.0, 10.0)))
@tuning(max_examples=80)
def test_load_is_that_of_the_linear_program(rows: list[Any], size: float) -> None:
    """Limits alike both ways: 1/reach is the least max |u_k| / limit_k of all commands that give the torque, to 1e-9."""
    found, matrix, low, high = make(rows)
    tau = draw_torque(rows, matrix, size)
    reach = assert_is_allocation(found, matrix, low, high, tau)
    count = len(rows)
    eye, ones = np.eye(count), np.ones((count, 1))
    best = linprog(
        [0.0] * count + [1.0],
        A_ub=np.block([[eye, -ones], [-eye, -ones]]),
        b_ub=[0.0] * (2 * count),
        A_eq=np.column_stack([matrix * high, np.zeros(3)]),
        b_eq=np.array(tau) / size,
        bounds=[(None, None)] * count + [(0.0, None)],
        method="highs",
    )
    assert best.status == 0
    assert math.isclose(1.0 / reach, best.x[-1] * size, rel_tol=1e-9)


@given(rows=wheels(limits), size=st.floats(0.0, 1.0), step=st.tuples(parts, parts, parts))
@tuning(max_examples=50)
def test_a_small_step_of_torque_is_no_jump_of_torque(rows: list[Any], size: float, step: Vec3) -> None:
    """Within reach commands follow the torque: the torque that they give moves by what was asked."""
    found, matrix, _, _ = make(rows)
    tau = draw_torque(rows, matrix, 1.0)
    assume(math.isfinite(found.find_reach(tau)) and found.rank == 3)
    scaled = np.array(tau) * min(1.0, found.find_reach(tau)) * 0.9 * size
    moved = scaled + 1e-6 * np.array(step)
    ask: Any = (tuple(scaled.tolist()), tuple(moved.tolist()))
    assume(min(found.find_reach(x) for x in ask) >= 1.0)
    gained = matrix @ found.allocate(ask[1]) - matrix @ found.allocate(ask[0])
    np.testing.assert_allclose(gained, 1e-6 * np.array(step), rtol=0.0, atol=1e-12)
