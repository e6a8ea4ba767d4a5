"""What every registered observer, controller, allocator and estimator must do, whatever it computes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.units import Vec3, Vec4
from fsw import allocators, controllers, estimation, observers
from fsw.allocators.pseudo_inverse import PseudoInverseConfig
from fsw.config import AllocatorConfig, ControllerConfig, EstimatorConfig, ObserverConfig
from fsw.controllers.braking_profile import BrakingProfileConfig
from fsw.controllers.smc import SmcConfig
from fsw.controllers.variable_structure import VariableStructureConfig
from fsw.estimation.direct import DirectConfig
from fsw.estimation.mekf import MekfConfig
from fsw.observers.ilo import IloConfig
from fsw.observers.none import NoObserverConfig
from fsw.records import Sensors
from fsw.vehicle import ModelConfig

PERIOD_S = 0.1
LIMIT_NM = 0.1
MODEL = ModelConfig(inertia_kgm2=((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0)), wheel_max_torque_nm=LIMIT_NM)
ZERO: Vec3 = (0.0, 0.0, 0.0)

OBSERVERS: list[ObserverConfig] = [
    IloConfig(kind="ilo", period_s=PERIOD_S),
    IloConfig(kind="ilo", period_s=PERIOD_S, k1=1.0, k2=20.0, k3=0.0),
    NoObserverConfig(kind="none"),
]
CONTROLLERS: list[ControllerConfig] = [
    SmcConfig(kind="smc", beta_law="published"),
    SmcConfig(kind="smc", beta_law="lyapunov"),
    SmcConfig(kind="smc", beta_law="fixed"),
    VariableStructureConfig(kind="variable_structure"),
    BrakingProfileConfig(kind="braking_profile"),
    BrakingProfileConfig(kind="braking_profile", adapt=False),
]
ALLOCATORS: list[AllocatorConfig] = [
    PseudoInverseConfig(kind="pseudo_inverse", saturation="clip"),
    PseudoInverseConfig(kind="pseudo_inverse", saturation="direction"),
]
ESTIMATORS: list[EstimatorConfig] = [DirectConfig(kind="direct"), MekfConfig(kind="mekf")]


def make(family: Any, config: Any) -> Any:
    """An algorithm from its family's registry, as the flight software makes it."""
    if family is estimation:
        return family.REGISTRY[config.kind](config, MODEL, PERIOD_S)
    return family.REGISTRY[config.kind](config, MODEL)


def name(config: Any) -> str:
    details = (getattr(config, field, None) for field in ("beta_law", "saturation", "adapt", "k1"))
    return "-".join([config.kind, *(str(detail) for detail in details if detail is not None)])


# Beyond what the frames can carry (2.1 rad/s, 0.84 N m), far beyond what the hardware can do.
component = st.floats(-1e6, 1e6)
vector = st.tuples(component, component, component)
wheel_vector = st.tuples(component, component, component, component)
momentum = st.tuples(*[st.floats(-100.0, 100.0)] * 3)
quaternion = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .filter(lambda q: sum(x * x for x in q) > 1e-6)
    .map(lambda q: tuple(x / math.sqrt(sum(y * y for y in q)) for x in q))
)


def assert_finite(value: Any) -> None:
    """Every number in a nest of tuples is finite."""
    if isinstance(value, tuple):
        for item in value:
            assert_finite(item)
    elif value is not None:
        assert math.isfinite(value)


def make_sensors(tick: int, q: Vec4, omega: Vec3, star_new: bool = True, age_s: float = 0.0) -> Sensors:
    return Sensors(
        tick=tick, t_s=tick * PERIOD_S, omega_meas_b_rad_s=omega, gyro_valid=(True, True, True), q_ib_meas=q,
        star_new=star_new, star_valid=True, star_age_s=age_s, wheel_speed_rad_s=(0.0, 0.0, 0.0, 0.0),
        wheel_valid=(True, True, True, True), h_rw_nms=(0.0, 0.0, 0.0, 0.0),
    )  # fmt: skip


def test_every_registered_kind_is_covered_here() -> None:
    """A kind added to a registry without a configuration in this file would escape the contract."""
    for family, configs in (
        (observers, OBSERVERS),
        (controllers, CONTROLLERS),
        (allocators, ALLOCATORS),
        (estimation, ESTIMATORS),
    ):
        assert set(family.REGISTRY) == {config.kind for config in configs}  # type: ignore[attr-defined]


# -- observers -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("config", OBSERVERS, ids=name)
@given(inputs=st.lists(st.tuples(vector, vector, momentum), min_size=1, max_size=20))
@settings(max_examples=40, deadline=None)
def test_observer_is_finite_and_reset_reproduces(config: Any, inputs: list[Any]) -> None:
    """Finite for any finite input in any order; the same sequence after reset gives the same numbers, bit for bit."""
    observer = make(observers, config)
    runs = []
    for _ in range(2):
        observer.reset()
        runs.append([observer.step(PERIOD_S, *item) for item in inputs])
    assert_finite(tuple(runs[0]))
    assert runs[0] == runs[1]


@pytest.mark.parametrize("config", OBSERVERS, ids=name)
def test_observer_stays_at_rest(config: Any) -> None:
    """No rate, no torque: no fault torque, for ever."""
    observer = make(observers, config)
    for _ in range(1000):
        assert observer.step(PERIOD_S, ZERO, ZERO, ZERO) == ZERO


@pytest.mark.parametrize("config", OBSERVERS, ids=name)
def test_observer_is_bounded_under_bounded_noise(config: Any) -> None:
    """Rate noise of 1e-3 rad/s never builds up: the estimate stays below a few times the noise's worst single effect."""
    observer = make(observers, config)
    largest = 0.0
    for k in range(5000):
        sign = 1.0 if (k * 7919) % 13 < 6 else -1.0
        v = observer.step(PERIOD_S, (1e-3 * sign, -1e-3 * sign, 1e-3), ZERO, ZERO)
        largest = max(largest, *(abs(x) for x in v))
    assert largest < 1.0  # 2e-3 rad/s seen through 140 N m s/rad, times three


@pytest.mark.parametrize("config", OBSERVERS, ids=name)
def test_observer_does_not_feel_a_known_rate_jump(config: Any) -> None:
    """shift_rate with the jump of the rate source leaves the fault torque as it would have been without the jump."""
    jump = (1e-3, -2e-3, 5e-4)
    plain, shifted = make(observers, config), make(observers, config)
    rate = (0.0, 0.0, 0.0)
    for k in range(60):
        rate = (1e-4 * k, -5e-5 * k, 2e-5 * k)
        expected = plain.step(PERIOD_S, rate, (1e-3, 0.0, 0.0), ZERO)
        if k == 30:
            shifted.shift_rate(jump)
        moved = rate if k < 30 else (rate[0] + jump[0], rate[1] + jump[1], rate[2] + jump[2])
        assert shifted.step(PERIOD_S, moved, (1e-3, 0.0, 0.0), ZERO) == pytest.approx(expected, abs=1e-3)


# -- controllers ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("config", CONTROLLERS, ids=name)
@given(inputs=st.lists(st.tuples(quaternion, vector, vector), min_size=1, max_size=20))
@settings(max_examples=40, deadline=None)
def test_controller_is_finite_and_reset_reproduces(config: Any, inputs: list[Any]) -> None:
    """Demand and internals are finite for any finite input in any order; reset gives the same numbers again."""
    controller = make(controllers, config)
    runs = []
    for _ in range(2):
        controller.reset()
        runs.append([(controller.step(PERIOD_S, *item), controller.internals) for item in inputs])
    assert_finite(tuple(runs[0]))
    assert runs[0] == runs[1]


@pytest.mark.parametrize("config", CONTROLLERS, ids=name)
def test_controller_asks_for_nothing_at_the_target(config: Any) -> None:
    """On target, at rest, no fault torque: no torque, for ever."""
    controller = make(controllers, config)
    for _ in range(1000):
        demand = controller.step(PERIOD_S, (1.0, 0.0, 0.0, 0.0), ZERO, ZERO)
        assert demand.tau_cmd_b_nm == pytest.approx(ZERO, abs=1e-12)
        assert demand.tau_rw_nm is None or max(map(abs, demand.tau_rw_nm)) < 1e-12


@pytest.mark.parametrize("config", CONTROLLERS, ids=name)
def test_controller_pushes_towards_the_target_from_rest(config: Any) -> None:
    """At rest off target, the torque turns the error down: its component along the eigenaxis is negative."""
    for axis in ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, 0.8), (-0.48, 0.64, 0.6)):
        controller = make(controllers, config)
        q_err = (math.cos(0.5), *(math.sin(0.5) * x for x in axis))
        torque = controller.step(PERIOD_S, q_err, ZERO, ZERO).tau_cmd_b_nm
        assert sum(a * b for a, b in zip(axis, torque, strict=True)) < -1e-3


@pytest.mark.parametrize("config", CONTROLLERS, ids=name)
def test_controller_that_commands_wheels_says_what_they_add_up_to(config: Any) -> None:
    """Demand carries wheel torques within limits and the body torque D0 @ tau_rw, or a body torque alone."""
    demand = make(controllers, config).step(PERIOD_S, (0.8, 0.6, 0.0, 0.0), (0.01, -0.02, 0.005), (0.01, 0.0, -0.02))
    if demand.tau_rw_nm is None:
        return
    a, b, c, d = demand.tau_rw_nm
    assert max(map(abs, demand.tau_rw_nm)) <= LIMIT_NM
    skew = d / math.sqrt(3.0)
    assert demand.tau_cmd_b_nm == pytest.approx((a + skew, b + skew, c + skew), abs=1e-15)


@pytest.mark.parametrize("config", CONTROLLERS, ids=name)
def test_controller_internals_keep_names_and_shapes(config: Any) -> None:
    """Telemetry lays out a topic from the internals at rest; they must have the same fields and lengths in flight."""
    controller = make(controllers, config)
    before = controller.internals
    for _ in range(3):
        controller.step(PERIOD_S, (0.8, 0.6, 0.0, 0.0), (0.01, -0.02, 0.005), (0.01, 0.0, -0.02))
    after = controller.internals

    def shape(internals: Any) -> list[tuple[str, int]]:
        pairs = zip(internals._fields, internals, strict=True)
        return [(key, len(value) if isinstance(value, tuple) else 0) for key, value in pairs]

    assert shape(before) == shape(after)


# -- allocators ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("config", ALLOCATORS, ids=name)
@given(torque=vector, wheels=wheel_vector)
@settings(max_examples=100, deadline=None)
def test_allocator_stays_within_limits(config: Any, torque: Vec3, wheels: Vec4) -> None:
    """No input makes it ask a wheel for more than it has, and the same input gives the same output."""
    allocator = make(allocators, config)
    for result in (allocator.allocate(torque), allocator.limit(wheels)):
        assert_finite(result)
        assert max(map(abs, result)) <= LIMIT_NM
    assert allocator.allocate(torque) == allocator.allocate(torque)


@pytest.mark.parametrize("config", ALLOCATORS, ids=name)
@given(torque=st.tuples(*[st.floats(-0.05, 0.05)] * 3))
def test_allocator_gives_the_torque_where_it_can(config: Any, torque: Vec3) -> None:
    """Within the limits the wheels' torques add up to what was asked: axes x, y, z and (1, 1, 1)/sqrt(3)."""
    a, b, c, d = make(allocators, config).allocate(torque)
    skew = d / math.sqrt(3.0)
    assert (a + skew, b + skew, c + skew) == pytest.approx(torque, abs=1e-15)


# -- estimators ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("config", ESTIMATORS, ids=name)
@given(inputs=st.lists(st.tuples(quaternion, momentum, st.booleans(), st.floats(0.0, 2.0)), min_size=1, max_size=20))
@settings(max_examples=40, deadline=None)
def test_estimator_is_finite_and_reset_reproduces(config: Any, inputs: list[Any]) -> None:
    """Finite, unit attitude for any unit attitude and any rate to 100 rad/s; reset gives the same numbers again."""
    estimator = make(estimation, config)
    runs = []
    for _ in range(2):
        estimator.reset()
        runs.append([estimator.step(make_sensors(k, *item)) for k, item in enumerate(inputs)])
    for estimate in runs[0]:
        assert_finite(tuple(estimate))
        assert math.sqrt(sum(x * x for x in estimate.q_ib)) == pytest.approx(1.0, abs=1e-6)
    assert runs[0] == runs[1]


@pytest.mark.parametrize("config", ESTIMATORS, ids=name)
def test_estimator_stays_at_rest(config: Any) -> None:
    """A body at rest under ideal sensors is estimated at rest, where it is."""
    estimator = make(estimation, config)
    q = (0.5, 0.5, -0.5, 0.5)
    for k in range(300):
        estimate = estimator.step(make_sensors(k, q, ZERO))
    assert estimate.valid
    assert estimate.omega_bi_b_rad_s == pytest.approx(ZERO, abs=1e-12)
    assert abs(sum(a * b for a, b in zip(estimate.q_ib, q, strict=True))) == pytest.approx(1.0, abs=1e-12)


# -- cost ----------------------------------------------------------------------------------------------------------


def measure_us(call: Callable[[], Any], repeats: int = 2000) -> float:
    """Best CPU time of a call over five rounds [us]."""
    best = math.inf
    for _ in range(5):
        start = time.process_time()
        for _ in range(repeats):
            call()
        best = min(best, (time.process_time() - start) / repeats)
    return best * 1e6


@pytest.mark.parametrize(
    ("family", "config"), [(observers, c) for c in OBSERVERS] + [(controllers, c) for c in CONTROLLERS]
)
def test_step_is_cheap(family: Any, config: Any) -> None:
    """CPU time of a step leaves room in a 1 kHz cycle on a slow machine: 40 us, some ten times what it takes."""
    algorithm = make(family, config)
    arguments: tuple[Any, ...] = ((0.01, 0.02, 0.01), (0.01, 0.0, 0.0), ZERO)
    if family is controllers:
        arguments = ((0.8, 0.6, 0.0, 0.0), (0.01, 0.02, 0.01), (0.01, 0.0, 0.0))
    assert measure_us(lambda: algorithm.step(PERIOD_S, *arguments)) < 40.0
