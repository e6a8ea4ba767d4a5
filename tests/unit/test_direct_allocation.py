"""Direct allocation against recorded cases, linear programming, closed forms and counts of facets."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from bus.errors import ConfigError
from bus.units import Vec3, Vec4
from fsw.allocators.attainable_set import AttainableSet
from fsw.allocators.direct import MOST_SHOWN, SAME_SHARE, Direct
from fsw.allocators.pseudo_inverse import PseudoInverse
from fsw.allocators.settings import DirectAllocationConfig, PseudoInverseConfig
from fsw.modes import Mode
from fsw.records import HEALTHY, NO_WHEEL, WheelHealth
from fsw.settings import ModelConfig, WheelModelConfig
from fsw.vehicle import Vehicle
from tools.run.bench import Bench

RECORD = np.load(Path(__file__).resolve().parents[1] / "data" / "control" / "alloc_cases.npz")
INERTIA = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))
LIMIT_NM = 0.1
VEHICLE = Vehicle(ModelConfig(inertia_kgm2=INERTIA, wheel_max_torque_nm=LIMIT_NM))
SKEW = 1.0 / math.sqrt(3.0)
X, Y, Z, S = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (SKEW, SKEW, SKEW)
FOUR = (X, Y, Z, S)
HALF = math.sqrt(0.75)


def point(*vector: float) -> Vec3:
    x, y, z = vector
    length = math.sqrt(x * x + y * y + z * z)
    return (x / length, y / length, z / length)


MISALIGNED = tuple(point(*column) for column in RECORD["mis_D"].T.tolist())
TRIPLE = (X, (-0.5, HALF, 0.0), (-0.5, -HALF, 0.0), Z)
PYRAMID = tuple(point(a, b, 1.0) for a, b in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)))
BOTH: tuple[Sequence[float], Sequence[float]] = ((-0.1,) * 4, (0.1,) * 4)

# name: axes, shares, lowest and highest commands, facets
SETS: dict[str, tuple[Sequence[Vec3], Sequence[float], Sequence[float], Sequence[float], int]] = {
    "healthy": (FOUR, (1.0,) * 4, *BOTH, 12),
    "weak": (FOUR, (0.4, 0.5, 1.0, 1.0), *BOTH, 12),
    "next to nothing": (FOUR, (1e-3, 1.0, 1.0, 1.0), *BOTH, 12),
    "dead x": (FOUR, (0.0, 1.0, 1.0, 1.0), *BOTH, 6),
    "dead skew": (FOUR, (1.0, 1.0, 1.0, 0.0), *BOTH, 6),
    "misaligned": (MISALIGNED, (1.0,) * 4, *BOTH, 12),
    "asymmetric": (FOUR, (1.0,) * 4, (-0.1, -0.05, -0.1, -0.02), (0.06, 0.1, 0.1, 0.1), 12),
    "one-sided": (FOUR, (1.0,) * 4, (0.0, -0.1, -0.1, -0.1), (0.1, 0.1, 0.0, 0.1), 12),
    "coplanar three": (TRIPLE, (1.0,) * 4, *BOTH, 8),
    "nearly coplanar": ((X, point(-0.5, HALF, 1e-7), TRIPLE[2], Z), (1.0,) * 4, *BOTH, 12),
    "pyramid": (PYRAMID, (1.0,) * 4, *BOTH, 12),
    "parallel pair": ((X, X, Y, Z), (1.0, 0.7, 1.0, 1.0), *BOTH, 6),
    "opposed pair": ((X, (-1.0, 0.0, 0.0), Y, Z), (1.0, 0.7, 1.0, 1.0), (-0.1, -0.02, -0.1, -0.1), (0.1,) * 4, 6),
    "three": ((X, Y, S), (1.0,) * 3, (-0.1,) * 3, (0.1,) * 3, 6),
    "five": ((*FOUR, PYRAMID[1]), (1.0,) * 5, (-0.1,) * 5, (0.1,) * 5, 16),
    "six": ((*PYRAMID, X, Y), (1.0, 0.3, 1.0, 1.0, 0.8, 1.0), (-0.1,) * 6, (0.1,) * 6, 14),
}
SYMMETRIC = [
    name for name, (_, _, low, high, _) in SETS.items() if all(-a == b for a, b in zip(low, high, strict=True))
]


def make_set(name: str) -> AttainableSet:
    return AttainableSet(*SETS[name][:4])


def make_matrix(name: str) -> np.ndarray:
    return np.array(SETS[name][0]).T * np.array(SETS[name][1])


def draw_torques(count: int, seed: int = 3) -> list[Vec3]:
    """Directions all around, lengths from well within what wheels give to far beyond."""
    rng = np.random.default_rng(seed)
    vectors = rng.standard_normal((count, 3))
    vectors *= (10.0 ** rng.uniform(-2.0, 1.0, count) * LIMIT_NM / np.linalg.norm(vectors, axis=1))[:, None]
    return [(x, y, z) for x, y, z in vectors.tolist()]


def solve_reach(matrix: np.ndarray, tau: Vec3, low: Sequence[float], high: Sequence[float]) -> float:
    """The largest factor of a torque by HiGHS, in units of 0.1 N m: its tolerances are absolute."""
    count = matrix.shape[1]
    bounds = [*zip(np.array(low) / LIMIT_NM, np.array(high) / LIMIT_NM, strict=True), (0.0, None)]
    unit = np.array(tau) / np.linalg.norm(tau)
    found = linprog(
        [0.0] * count + [-1.0], A_eq=np.column_stack([matrix, -unit]), b_eq=[0.0] * 3, bounds=bounds, method="highs"
    )
    assert found.status == 0
    return float(found.x[-1]) * LIMIT_NM / float(np.linalg.norm(tau))


def solve_load(matrix: np.ndarray, tau: Vec3, limit: Sequence[float]) -> float:
    """The least max |u_k| / limit_k that gives a torque, by HiGHS."""
    count = matrix.shape[1]
    unit = np.array(tau) / np.linalg.norm(tau)
    eye, ones = np.eye(count), np.ones((count, 1))
    found = linprog(
        [0.0] * count + [1.0],
        A_ub=np.block([[eye, -ones], [-eye, -ones]]),
        b_ub=[0.0] * (2 * count),
        A_eq=np.column_stack([matrix * np.array(limit), np.zeros(3)]),
        b_eq=unit * LIMIT_NM,
        bounds=[(None, None)] * count + [(0.0, None)],
        method="highs",
    )
    assert found.status == 0
    return float(found.x[-1]) * float(np.linalg.norm(tau)) / LIMIT_NM


# -- the attainable set --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", ["D0", "deadX", "mis", "coplanar3"])
def test_recorded_allocations(case: str) -> None:
    """150 torques of an independent implementation and its linear programs: reach, commands, torque, limits, facets."""
    matrix, shares = RECORD[f"{case}_D"], RECORD[f"{case}_W"]
    low, high = RECORD[f"{case}_lo"], RECORD[f"{case}_hi"]
    found = AttainableSet([tuple(axis) for axis in matrix.T.tolist()], shares.tolist(), low.tolist(), high.tolist())
    assert found.count_facets() == int(RECORD[f"{case}_nfacets"])
    for tau, reach_lp, u_then in zip(RECORD[f"{case}_tau"], RECORD[f"{case}_rho_lp"], RECORD[f"{case}_u"], strict=True):
        reach, commands = found.solve(tuple(tau.tolist()))
        assert reach == pytest.approx(reach_lp, rel=1e-13)
        assert matrix @ (shares * commands) == pytest.approx(min(1.0, reach) * tau, abs=1e-12)
        assert (np.array(commands) >= low - 1e-12).all()
        assert (np.array(commands) <= high + 1e-12).all()
        if case != "coplanar3":  # where a torque can be shared in more than one way
            assert commands == pytest.approx(u_then, abs=1e-12)


@pytest.mark.parametrize("name", SETS)
def test_number_of_facets(name: str) -> None:
    """n(n-1) for axes of which no three are coplanar, less where facets merge; each is one of the hull of all corners."""
    axes, shares, low, high, count = SETS[name]
    found = make_set(name)
    assert (found.rank, found.count_facets()) == (3, count)
    ours = {tuple(round(x, 9) + 0.0 for x in (*normal, -support)) for normal, support in found.list_facets()}
    assert len(ours) == count
    if name == "nearly coplanar":  # the hull merges what is that near
        return
    corners = np.array(list(itertools.product(*zip(low, high, strict=True)))) @ (np.array(axes).T * shares).T
    hull = {tuple(round(x, 9) + 0.0 for x in row) for row in ConvexHull(corners).equations.tolist()}
    assert len(hull) >= count  # the same plane may differ in its last digits between two triangles
    assert all(min(math.dist(row, other) for other in ours) < 1e-8 for row in hull)
    assert all(min(math.dist(row, other) for other in hull) < 1e-8 for row in ours)


@pytest.mark.parametrize("name", SETS)
def test_reach_and_torque(name: str) -> None:
    """The reach is that of the linear program to 1e-9; torque exact within, full length in its direction beyond."""
    _, _, low, high, _ = SETS[name]
    found, matrix = make_set(name), make_matrix(name)
    for tau in draw_torques(15):
        reach, commands = found.solve(tau)
        assert reach == found.find_reach(tau)
        assert commands == found.allocate(tau)
        assert reach == pytest.approx(solve_reach(matrix, tau, low, high), rel=1e-9, abs=1e-12)
        assert matrix @ commands == pytest.approx(min(1.0, reach) * np.array(tau), abs=1e-12)
        assert all(a <= u <= b for a, u, b in zip(low, commands, high, strict=True))


@pytest.mark.parametrize("name", SYMMETRIC)
def test_load_is_the_least_that_can_be(name: str) -> None:
    """With limits alike both ways the most loaded wheel has the least load that gives the torque, and that is 1/reach."""
    found, matrix, high = make_set(name), make_matrix(name), SETS[name][3]
    for tau in draw_torques(12, seed=4):
        reach, commands = found.solve(tau)
        least = solve_load(matrix, tau, high)
        assert 1.0 / reach == pytest.approx(least, rel=1e-9)
        load = max(abs(u) / limit for u, limit in zip(commands, high, strict=True))
        assert load == pytest.approx(min(1.0, least), rel=1e-9)


@pytest.mark.parametrize("name", SETS)
def test_sorted_search_finds_the_same(name: str) -> None:
    """Facets by angle, the first that contains the ray: the same commands to 1e-12."""
    found = make_set(name)
    for tau in draw_torques(100, seed=5):
        commands, tried = found.allocate_sorted(tau)
        assert 1 <= tried <= found.count_facets()
        assert commands == pytest.approx(found.allocate(tau), abs=1e-12)
    assert found.allocate_sorted((0.0, 0.0, 0.0)) == ((0.0,) * len(SETS[name][0]), 0)


def test_how_many_facets_the_sorted_search_tries() -> None:
    """Four sound wheels: the first facet by angle is the right one nine times out of ten, and three are the most."""
    found = make_set("healthy")
    tries = np.array([found.allocate_sorted(tau)[1] for tau in draw_torques(3000, seed=6)])
    assert (tries == 1).mean() == pytest.approx(0.886, abs=0.02)
    assert tries.mean() == pytest.approx(1.12, abs=0.03)
    assert tries.max() <= 3
    faulty = AttainableSet(FOUR, (0.2, 1.0, 1.0, 0.6), *BOTH)
    tries = np.array([faulty.allocate_sorted(tau)[1] for tau in draw_torques(3000, seed=6)])
    assert tries.mean() == pytest.approx(1.9, abs=0.1)
    assert tries.max() <= 6


def test_capability_against_the_pseudo_inverse() -> None:
    """Along an axis 0.1 (1 + 1/sqrt 3) against 0.12 N m, along (1,1,1) 0.1 (1 + sqrt 3) against 0.2 N m."""
    found = make_set("healthy")
    pinv = np.linalg.pinv(np.array(FOUR).T)
    for way, best, usual in ((X, LIMIT_NM * (1.0 + SKEW), 0.12), (S, LIMIT_NM * (1.0 + math.sqrt(3.0)), 0.2)):
        assert found.find_reach(way) == pytest.approx(best, rel=1e-12)
        assert LIMIT_NM / np.abs(pinv @ way).max() == pytest.approx(usual, rel=1e-12)
    least = min(support for _, support in found.list_facets())  # the distance of the nearest facet
    assert least == pytest.approx(0.1 * math.sqrt(2.0), abs=1e-4)
    assert LIMIT_NM / np.linalg.norm(pinv, axis=1).max() == pytest.approx(0.2 * SKEW, rel=1e-9)


def test_shared_facets_are_met_steadily() -> None:
    """Over a facet with three free wheels commands have no jump: for a small step of torque a small one of commands."""
    found = make_set("coplanar three")
    before = None
    for step in range(2001):
        angle = 2.0 * math.pi * step / 2000
        commands = found.allocate((0.02 * math.cos(angle), 0.02 * math.sin(angle), 0.09))
        if before is not None:
            assert max(abs(a - b) for a, b in zip(commands, before, strict=True)) < 4e-4
        before = commands


def test_stuck_wheels_are_made_up_for() -> None:
    """One that gives 0.03 N m whatever it is told: the others give the rest, exactly, and it is told where it is."""
    found = AttainableSet(FOUR, (1.0, 0.5, 1.0, 1.0), (-0.1, 0.06, -0.1, -0.1), (0.1, 0.06, 0.1, 0.1))
    assert found.offset_b_nm == pytest.approx((0.0, 0.03, 0.0))
    commands = found.allocate((0.02, -0.01, 0.05))
    assert commands[1] == 0.06
    assert np.array(FOUR).T @ (np.array(commands) * (1.0, 0.5, 1.0, 1.0)) == pytest.approx(
        (0.02, -0.01, 0.05), abs=1e-15
    )


@pytest.mark.parametrize(
    ("axes", "rank", "ends", "reach"),
    [
        ((X, Y, point(1.0, 1.0, 0.0)), 2, 6, LIMIT_NM * (1.0 + math.sqrt(0.5))),
        ((X, Y, X), 2, 4, 2.0 * LIMIT_NM),
        ((X, Y), 2, 4, LIMIT_NM),
        ((X, X, (-1.0, 0.0, 0.0)), 1, 2, 3.0 * LIMIT_NM),
        ((X,), 1, 2, LIMIT_NM),
    ],
)
def test_wheels_that_do_not_span_all_axes(axes: Sequence[Vec3], rank: int, ends: int, reach: float) -> None:
    """The part of a torque in their span is given, by hand-counted limits; the rest is told by the rank."""
    count = len(axes)
    found = AttainableSet(axes, [1.0] * count, [-0.1] * count, [0.1] * count)
    assert (found.rank, found.count_facets()) == (rank, ends)
    assert found.find_reach((1.0, 0.0, 0.7)) == pytest.approx(reach, rel=1e-12)
    commands = found.allocate((0.05, 0.0, 0.7))
    assert len(commands) == count
    assert np.array(axes).T @ commands == pytest.approx((0.05, 0.0, 0.0), abs=1e-15)
    assert found.allocate_sorted((0.05, 0.0, 0.7))[0] == pytest.approx(commands, abs=1e-14)
    assert found.allocate((0.0, 0.0, 0.7)) == pytest.approx((0.0,) * count, abs=1e-15)


def test_no_wheel_gives_nothing() -> None:
    """Rank 0 with all dead, or none there: zeros, and an infinite reach as there is nothing to fall short of."""
    for axes, shares in ((FOUR, (0.0,) * 4), (((0.0, 0.0, 0.0),) * 4, (1.0,) * 4)):
        found = AttainableSet(axes, shares, *BOTH)
        assert (found.rank, found.list_facets()) == (0, [])
        assert found.solve((0.1, 0.2, 0.3)) == (math.inf, (0.0,) * 4)
    assert make_set("healthy").solve((0.0, 0.0, 0.0)) == (math.inf, (0.0,) * 4)


@pytest.mark.parametrize(
    ("axes", "share", "low", "high", "word"),
    [
        ((1.0, 1.0, 0.0), 1.0, -0.1, 0.1, "unit vector"),
        (X, -0.1, -0.1, 0.1, "must be 0"),
        (X, math.nan, -0.1, 0.1, "must be 0"),
        (X, 1.0, 0.02, 0.1, "0 must lie between"),
        (X, 1.0, 0.1, -0.1, "0 must lie between"),
        (X, 1.0, -math.inf, 0.1, "0 must lie between"),
    ],
)
def test_sets_that_cannot_be_are_refused(axes: Vec3, share: float, low: float, high: float, word: str) -> None:
    """Axes of another length, shares below nothing, limits that do not let a wheel rest."""
    with pytest.raises(ConfigError, match=word):
        AttainableSet((axes, Y, Z), (share, 1.0, 1.0), (low, -0.1, -0.1), (high, 0.1, 0.1))


# -- the allocator -------------------------------------------------------------------------------------------------


def make(**settings: object) -> Direct:
    return Direct(DirectAllocationConfig(kind="direct", **settings), VEHICLE, 0.1)  # type: ignore[arg-type]


def combine(u: Sequence[float], shares: Sequence[float], bias: Sequence[float] = (0.0,) * 4) -> np.ndarray:
    return np.array(FOUR).T @ (np.array(u) * shares + bias)


def test_more_torque_than_the_pseudo_inverse() -> None:
    """About x 0.1577 N m against 0.12 with the direction kept; and within the limits, both give what is asked."""
    direct, usual = (
        make(),
        PseudoInverse(PseudoInverseConfig(kind="pseudo_inverse", saturation="direction"), VEHICLE, 0.1),
    )
    tau = (1.0, 0.0, 0.0)
    assert direct.allocate(tau, HEALTHY).achieved_b_nm == pytest.approx((0.15773502691896258, 0.0, 0.0), abs=1e-15)
    assert usual.allocate(tau, HEALTHY).achieved_b_nm == pytest.approx((0.12, 0.0, 0.0), abs=1e-15)
    tau = (0.03, -0.02, 0.05)
    assert direct.allocate(tau, HEALTHY).achieved_b_nm == pytest.approx(tau, abs=1e-15)
    assert usual.allocate(tau, HEALTHY).achieved_b_nm == pytest.approx(tau, abs=1e-15)


def test_health_is_reckoned_with() -> None:
    """Shares and biases: what the wheels then give is what was asked for, and both are told with the result."""
    shares, bias = (0.5, 1.0, 0.3, 0.9), (0.0, 0.01, 0.0, -0.02)
    health = WheelHealth(shares, bias_nm=bias)
    direct = make()
    found = direct.allocate((0.02, -0.01, 0.01), health)
    assert combine(found.tau_rw_nm, shares, bias) == pytest.approx((0.02, -0.01, 0.01), abs=1e-15)
    assert (found.shares, found.bias_nm) == (shares, bias)
    assert found.margin == pytest.approx(1.0 - 1.0 / direct.internals.reach, abs=1e-12)
    blind = make(use_health=False).allocate((0.02, -0.01, 0.01), health)
    assert combine(blind.tau_rw_nm, (1.0,) * 4) == pytest.approx((0.02, -0.01, 0.01), abs=1e-15)
    assert (blind.shares, blind.bias_nm) == ((1.0,) * 4, (0.0,) * 4)


@pytest.mark.parametrize("use_health", [True, False])
@pytest.mark.parametrize("how", ["dead", "available"])
def test_a_wheel_that_is_out_is_told_nothing(how: str, use_health: bool) -> None:
    """The other three give all of the torque, whether it is judged dead or switched off."""
    health = (
        WheelHealth(dead=(True, False, False, False))
        if how == "dead"
        else WheelHealth(available=(False, True, True, True))
    )
    direct = make(use_health=use_health)
    found = direct.allocate((0.03, 0.01, -0.02), health)
    assert found.tau_rw_nm[0] == 0.0
    assert found.shares == (0.0, 1.0, 1.0, 1.0)
    assert combine(found.tau_rw_nm, found.shares) == pytest.approx((0.03, 0.01, -0.02), abs=1e-15)
    assert (direct.internals.rank, direct.internals.facets) == (3.0, 6.0)


def test_a_share_next_to_nothing_counts_as_dead() -> None:
    """With the skew wheel out and x at 1 %: its axis is given up and y and z get their torque; reckoned with, x would cost
    all but a hundredth of the whole torque."""
    health = WheelHealth((0.01, 1.0, 1.0, 1.0), (True, True, True, False))
    tau = (0.05, 0.05, 0.05)
    found = (direct := make(share_min=0.0)).allocate(tau, health)
    assert found.tau_rw_nm == pytest.approx((0.0, 0.05, 0.05, 0.0), abs=1e-15)
    assert direct.internals.rank == 2.0
    reckoned = make(share_min=0.0, dead_below=1e-3).allocate(tau, health)
    assert combine(reckoned.tau_rw_nm, reckoned.shares) == pytest.approx((0.001, 0.001, 0.001), abs=1e-15)
    floored = make(share_min=0.2).allocate(tau, health)
    assert floored.shares == (0.2, 1.0, 1.0, 0.0)
    assert combine(floored.tau_rw_nm, floored.shares) == pytest.approx((0.02, 0.02, 0.02), abs=1e-15)


def test_the_set_is_made_anew_only_for_a_change_that_counts() -> None:
    """Shares that move by 1e-4 or less are passed over, and the shares told are those of the set; a loss never is."""
    direct = make()
    first = (0.8, 1.0, 1.0, 1.0)
    assert direct.allocate((0.01, 0.0, 0.0), WheelHealth(first)).shares == first
    near = (0.8 + 0.9 * SAME_SHARE, 1.0, 1.0 - 0.9 * SAME_SHARE, 1.0)
    found = direct.allocate((0.01, 0.0, 0.0), WheelHealth(near))
    assert found.shares == first
    assert combine(found.tau_rw_nm, first) == pytest.approx((0.01, 0.0, 0.0), abs=1e-15)
    assert direct.internals.rebuilds == 1.0
    far = (0.8 + 1.1 * SAME_SHARE, 1.0, 1.0, 1.0)
    assert direct.allocate((0.01, 0.0, 0.0), WheelHealth(far)).shares == far
    assert direct.internals.rebuilds == 2.0
    slight = make(share_min=0.0, dead_below=1e-5)
    slight.allocate((0.01, 0.0, 0.0), WheelHealth((2e-5, 1.0, 1.0, 1.0)))
    assert slight.allocate((0.01, 0.0, 0.0), WheelHealth((0.0, 1.0, 1.0, 1.0))).shares == (0.0, 1.0, 1.0, 1.0)


def test_what_telemetry_shows() -> None:
    """Reach, rank, facets and remakes; a reach without end is cut, so that it is a number; reset starts over."""
    direct = make()
    assert direct.internals == (MOST_SHOWN, 3.0, 12.0, 0.0)
    direct.allocate((0.0, 0.0, 0.0), HEALTHY)
    assert direct.internals.reach == MOST_SHOWN
    direct.allocate((1.0, 0.0, 0.0), WheelHealth(dead=(False, False, False, True)))
    assert direct.internals == (pytest.approx(0.1), 3.0, 6.0, 1.0)
    direct.reset()
    assert direct.internals == (MOST_SHOWN, 3.0, 12.0, 0.0)


def test_other_axes_and_limits() -> None:
    """A pyramid whose wheels differ: each has its own limit, and the load is that of the linear program."""
    limits: Vec4 = (0.05, 0.1, 0.02, 0.08)
    a, b, c, d = (
        WheelModelConfig(axis_b=axis, max_torque_nm=limit) for axis, limit in zip(PYRAMID, limits, strict=True)
    )
    direct = Direct(
        DirectAllocationConfig(kind="direct"), Vehicle(ModelConfig(inertia_kgm2=INERTIA, wheels=(a, b, c, d))), 0.1
    )
    for tau in draw_torques(20, seed=8):
        found = direct.allocate(tau, WheelHealth(dead=NO_WHEEL))
        least = solve_load(np.array(PYRAMID).T, tau, limits)
        assert 1.0 - found.margin == pytest.approx(min(1.0, least), rel=1e-9)


@pytest.mark.slow
def test_a_wheel_judged_away_is_seen_to_come_back() -> None:
    """Braking-profile: z sticks from 20 to 40 s, the skew wheel dies at 30 s. With share_min the flight settles; with none z
    stays dead once its share was learned to be next to nothing, two axes are all that is left, and the satellite is lost."""
    errors = {}
    for share_min in (0.15, 0.0):
        change = f"fsw.allocator={{kind: direct, share_min: {share_min}}}"
        with Bench.open("braking-profile", ["expect=[]", "duration_s=150", change], log="memory") as bench:
            bench.run_to_end()
            errors[share_min] = bench.log.signals("/truth/attitude")["error_deg"]
    assert errors[0.15][700:].max() < 0.1
    assert errors[0.0][-1] > 30.0


def test_rank_lost_by_shares_alone_is_told_to_the_modes() -> None:
    """Two dead wheels whose shares fall below dead_below, no wheel told dead: the mode is degraded, and says why."""
    faults = "faults=[{unit: wheel.1, kind: dead, at_s: 5}, {unit: wheel.2, kind: dead, at_s: 5}]"
    allocator = "fsw.allocator={kind: direct, share_min: 0, dead_below: 0.1}"
    learner = "fsw.wheel_health={kind: share_learner}"
    with Bench.open("braking-profile", ["expect=[]", faults, allocator, learner]) as bench:
        while bench.flight.modes.mode is not Mode.DEGRADED:
            assert bench.t_s < 60.0
            bench.step()
        assert bench.flight.allocator.internals.rank == 2.0
        assert bench.flight.modes.reason == "the shares of the wheels leave torque about 2 of three axes"
        assert not any(bench.flight.health.dead)
