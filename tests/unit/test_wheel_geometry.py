"""Four wheels with any axes, against numpy's least squares and scipy's linear programming."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import linprog

from bus.errors import ConfigError
from bus.units import Vec3, Vec4
from fsw.settings import ModelConfig, WheelModelConfig
from fsw.vehicle import Vehicle
from fsw.wheel_geometry import WheelGeometry

INERTIA = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))
RNG = np.random.default_rng(41)
LIMITS: Vec4 = (0.1, 0.2, 0.05, 0.15)


def draw(size: int) -> tuple[float, ...]:
    return tuple(RNG.standard_normal(size).tolist())


def make_axes() -> np.ndarray:
    """Four random directions that span space well, shape (3, 4)."""
    while True:
        axes = RNG.standard_normal((3, 4))
        axes /= np.linalg.norm(axes, axis=0)
        losses = [np.linalg.svd(np.delete(axes, lost, axis=1))[1][-1] for lost in range(4)]
        if min(losses) > 0.2:
            return axes


def make_wheels(axes: np.ndarray, limits: Vec4 = LIMITS) -> WheelGeometry:
    return WheelGeometry(tuple(map(tuple, axes.T.tolist())), limits)  # type: ignore[arg-type]


@pytest.mark.parametrize("number", range(10))
def test_products_are_numpys(number: int) -> None:
    """combine, project and spread are D0 x, D0^T x and pinv(D0) x for any axes."""
    axes = make_axes()
    wheels, four, three = make_wheels(axes), draw(4), draw(3)
    assert wheels.combine(four) == pytest.approx(axes @ four, abs=1e-13)  # type: ignore[arg-type]
    assert wheels.project(three) == pytest.approx(axes.T @ three, abs=1e-13)  # type: ignore[arg-type]
    assert wheels.spread(three) == pytest.approx(np.linalg.pinv(axes) @ three, abs=1e-12)  # type: ignore[arg-type]


@pytest.mark.parametrize("lost", [None, 0, 1, 2, 3])
def test_weighted_spread_is_the_least_squares_one(lost: int | None) -> None:
    """D0 diag(c) u = torque with least |u|: numpy's lstsq, with weak wheels and with one that gives nothing."""
    for _ in range(20):
        axes, torque = make_axes(), draw(3)
        share = RNG.uniform(0.15, 1.0, 4)
        if lost is not None:
            share[lost] = 0.0
        expected = np.linalg.lstsq(axes @ np.diag(share), np.array(torque), rcond=None)[0]
        found = make_wheels(axes).spread_weighted(torque, tuple(share.tolist()))  # type: ignore[arg-type]
        assert found == pytest.approx(expected, rel=1e-7, abs=1e-9)


def test_weighted_spread_without_two_wheels_gives_what_can_be_had() -> None:
    """Two wheels reach a plane: the torque's part in it comes to 1e-4, and no command is beyond reason; none: nothing."""
    axes, torque = make_axes(), draw(3)
    wheels, share = make_wheels(axes), np.array([1.0, 0.0, 0.7, 0.0])
    found = wheels.spread_weighted(torque, tuple(share.tolist()))  # type: ignore[arg-type]
    reach = axes @ np.diag(share)
    best = reach @ np.linalg.lstsq(reach, np.array(torque), rcond=1e-9)[0]
    assert reach @ found == pytest.approx(best, abs=1e-4)
    assert wheels.spread_weighted(torque, (0.0, 0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0, 0.0)  # type: ignore[arg-type]


def solve_authority(axes: np.ndarray, t: Vec3, limit: Vec4) -> float:
    """max m with D0 u = m t and |u_i| <= limit_i, by linear programming (HiGHS)."""
    result = linprog(
        [-1.0, 0.0, 0.0, 0.0, 0.0],
        A_eq=np.hstack([-np.array(t)[:, None], axes]),
        b_eq=np.zeros(3),
        bounds=[(0.0, None), *((-x, x) for x in limit)],
        method="highs",
    )
    return float(result.x[0])


@pytest.mark.parametrize("number", range(15))
def test_authority_is_the_linear_programs(number: int) -> None:
    """The closed form against the optimum, for any axes and limits, one of them 0 in a third; and after the worst loss."""
    axes, t = make_axes(), draw(3)
    limits = RNG.uniform(0.0, 0.2, 4)
    if number % 3 == 0:
        limits[number % 4] = 0.0
    limit: Vec4 = tuple(limits.tolist())
    now, worst = make_wheels(axes).find_authority(t, limit)  # type: ignore[arg-type]
    assert now == pytest.approx(solve_authority(axes, t, limit), rel=1e-6, abs=1e-9)  # type: ignore[arg-type]
    losses = [tuple(0.0 if j == i else x for j, x in enumerate(limit)) for i in range(4)]
    assert worst == pytest.approx(min(solve_authority(axes, t, loss) for loss in losses), rel=1e-6, abs=1e-9)  # type: ignore[arg-type]


def test_authority_with_a_torque_that_is_given_is_the_linear_programs() -> None:
    """A torque that is there whatever the wheels are told helps one way, hinders the other."""
    for _ in range(20):
        axes, t, given = make_axes(), np.array(draw(3)), 0.05 * np.array(draw(3))
        wheels = make_wheels(axes)
        for direction in (t, -t):
            now, _ = wheels.find_authority(tuple(direction.tolist()), LIMITS, tuple(given.tolist()))
            result = linprog(
                [-1.0, 0.0, 0.0, 0.0, 0.0],
                A_eq=np.column_stack([direction, -axes]), b_eq=given,
                bounds=[(0.0, None), *((-x, x) for x in LIMITS)], method="highs",
            )  # fmt: skip
            if result.success:  # else what is given cannot be held, even with no torque along t
                assert now == pytest.approx(float(result.x[0]), rel=1e-6, abs=1e-9)
    assert make_wheels(np.column_stack([np.eye(3), [1.0, 0.0, 0.0]])).find_authority(
        (1.0, 0.0, 0.0), LIMITS, (-9.0, 0.0, 0.0)
    ) == (0.0, 0.0)


def test_authority_of_the_published_wheels_and_of_two_parallel_ones() -> None:
    """Axes x, y, z and (1, 1, 1), and a pair of parallel wheels, which has no plane of its own: linear programming again."""
    skew = 1.0 / math.sqrt(3.0)
    for last in ((skew, skew, skew), (1.0, 0.0, 0.0)):
        axes = np.column_stack([np.eye(3), last])
        for _ in range(10):
            t = draw(3)
            now, _ = make_wheels(axes).find_authority(t, LIMITS)  # type: ignore[arg-type]
            assert now == pytest.approx(solve_authority(axes, t, LIMITS), rel=1e-6)  # type: ignore[arg-type]
    assert make_wheels(axes).find_authority((0.0, 0.0, 0.0), LIMITS) == (math.inf, math.inf)


def test_limits_and_loads_are_each_wheels_own() -> None:
    """A torque is cut at its own wheel's limit, and the load is the largest share of a limit."""
    wheels = make_wheels(make_axes())
    assert wheels.limit((0.3, -0.3, 0.01, -0.01)) == (0.1, -0.2, 0.01, -0.01)
    assert wheels.find_load((0.05, -0.05, 0.1, 0.0)) == pytest.approx(2.0)


def test_largest_torque_about_a_row_is_that_of_a_corner() -> None:
    """The closed form equals the best of all sixteen corners of the limits."""
    axes, row = make_axes(), draw(3)
    corners = [np.array(LIMITS) * [1 if n >> i & 1 else -1 for i in range(4)] for n in range(16)]
    best = max(float(np.dot(row, axes @ corner)) for corner in corners)
    assert make_wheels(axes).find_largest(row) == pytest.approx(best, rel=1e-12)  # type: ignore[arg-type]


def make_model(*axes: Vec3) -> ModelConfig:
    wheels = tuple(WheelModelConfig(axis_b=axis) for axis in axes)
    return ModelConfig(inertia_kgm2=INERTIA, wheels=wheels)  # type: ignore[arg-type]


def test_axes_in_one_plane_are_refused() -> None:
    """No torque about the plane's normal is possible: said with the axes, not found out in flight."""
    with pytest.raises(ConfigError, match=r"model\.wheels.*in one plane"):
        Vehicle(make_model((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.6, 0.8, 0.0), (0.8, -0.6, 0.0)))


def test_an_axis_without_a_direction_is_refused_and_others_are_normalised() -> None:
    """The wheel is named; (0, 0, 2) is the z axis."""
    x, y, z, skew = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 2.0), (3.0, 3.0, 3.0)
    axes = Vehicle(make_model(x, y, z, skew)).wheels.axes_b
    assert axes[2] == (0.0, 0.0, 1.0)
    assert axes[3] == pytest.approx((1.0 / math.sqrt(3.0),) * 3)
    with pytest.raises(ConfigError, match=r"model\.wheels\[2\]\.axis_b.*no direction"):
        Vehicle(make_model(x, y, (0.0, 0.0, 0.0), skew))
