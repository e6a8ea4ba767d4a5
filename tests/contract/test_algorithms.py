"""What every registered algorithm of every family must do, whatever it computes.

The kinds come from the registries: one that is registered is covered here without a word in this file.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.record import Record
from bus.units import Vec3, Vec4
from fsw import allocators, controllers, estimation, gyro_fdi, observers, wheel_health
from fsw.records import HEALTHY, Estimate, PointingError, Sensors, WheelHealth, WheelReading
from fsw.settings import ModelConfig
from fsw.vehicle import Vehicle

PERIOD_S = 0.1
LIMIT_NM = 0.1
INERTIA = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))  # observers' gains are designed for this one
VEHICLE = Vehicle(ModelConfig(inertia_kgm2=INERTIA, wheel_max_torque_nm=LIMIT_NM))
ZERO: Vec3 = (0.0, 0.0, 0.0)
ZERO4: Vec4 = (0.0, 0.0, 0.0, 0.0)

FAMILIES = (estimation, gyro_fdi, observers, wheel_health, controllers, allocators)
# Beside the default settings of each kind; where two families have a kind of one name, by the name of its settings
VARIANTS: dict[str, list[dict[str, Any]]] = {
    "smc": [{"beta_law": "lyapunov"}, {"beta_law": "fixed"}],
    "braking_profile": [{"adapt": False}, {"spent": 2.0, "reserve": 1.0}],
    "dismc": [{"kappa": 1.0, "lam": 1.0, "stability": "warn"}, {"latency": 1, "c_1_s": 0.0}, {"anti_windup": False}],
    "finite_time": [
        {"form": "B"},
        {"form": "C", "gyroscopic": True, "latency": 5},
        {"alpha1": 1.0, "sampling": "implicit"},
        {"sampling": "implicit", "latency": 1},
    ],
    "power_integrator": [
        {"sampling": "explicit", "adapt_beta": True},
        {"inertia_weight": False, "m": 50.0, "latency": 2},
        {"inertia_weight": False, "sampling": "explicit", "gyroscopic": False, "gain_check": "off"},
    ],
    "fuzzy_pid": [
        {"base": "engineering", "tables": "even"},
        {"base": "engineering"},
        {"tables": "even"},
        {"inference": "prod"},
    ],
    "DirectAllocationConfig": [{"use_health": False}, {"share_min": 0.0, "dead_below": 1e-6}, {"share_min": 0.0}],
    "pseudo_inverse": [{"saturation": "direction"}],
    "ilo": [{"k1": 1.0, "k2": 20.0, "k3": 0.0}],
    "share_kalman": [{"dither": "off"}, {"command_latency_s": 0.01}, {"average": 1, "probe_nm": 0.0}],
    "torque_monitor": [{"reaction": "report"}],
    "wheel_kalman": [{"reaction": "report"}, {"reaction": "compensate"}, {"dither": True}],
    "wheel_kalman_paper": [{"model": "voltage"}],
    "practical": [{"recovery": "off"}, {"observer": "ts_bx"}],
    "wang2010": [{"recovery": "on", "observer": kind} for kind in ("linear", "ts_a", "ts_bx", "static")],
}


def list_variants(config: Any) -> list[dict[str, Any]]:
    return VARIANTS.get(type(config).__name__, VARIANTS.get(config.kind, []))


def list_configs(family: ModuleType) -> list[Any]:
    """Settings of every kind of a family: its defaults, and its variants."""
    found = []
    for kind, (make_settings, _) in family.REGISTRY.kinds.items():
        config = make_settings(kind=kind)
        found += [config, *(replace(config, **changes) for changes in list_variants(config))]
    return found


def name(config: Any) -> str:
    for changes in list_variants(config):
        if all(getattr(config, key) == value for key, value in changes.items()):
            return "-".join([config.kind, *map(str, changes.values())])
    return str(config.kind)


def make(family: ModuleType, config: Any) -> Any:
    """An algorithm from its family's registry, as the flight software makes it."""
    return family.REGISTRY.make(config, VEHICLE, PERIOD_S)


def every(family: ModuleType) -> Any:
    """Run a test for all kinds of a family."""
    return pytest.mark.parametrize("config", list_configs(family), ids=name)


# Beyond what the frames can carry (2.1 rad/s, 0.84 N m), far beyond what the hardware can do.
component = st.floats(-1e6, 1e6)
vector = st.tuples(component, component, component)
bounded = st.tuples(*[st.floats(-100.0, 100.0)] * 3)
flags = st.tuples(*[st.booleans()] * 4)
shares = st.tuples(*[st.floats(0.0, 1.0)] * 4)
healths = st.builds(WheelHealth, shares, flags, flags, bounded)
torques = st.tuples(*[st.floats(-LIMIT_NM, LIMIT_NM)] * 4)
speeds = st.tuples(*[st.floats(-2000.0, 2000.0)] * 4)
quaternions = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .filter(lambda q: sum(x * x for x in q) > 1e-6)
    .map(lambda q: tuple(x / math.sqrt(sum(y * y for y in q)) for x in q))
)
errors = st.builds(PointingError, quaternions, vector)
sensor_values = st.tuples(
    bounded,
    st.tuples(*[st.booleans()] * 3),
    quaternions,
    st.booleans(),
    st.booleans(),
    st.floats(0.0, 2.0),
    speeds,
    flags,
)


def make_wheels(speeds_rad_s: Vec4 = ZERO4, valid: tuple[bool, ...] = (True,) * 4) -> Any:
    return tuple(WheelReading(w, 0.0, 0, ok, 0.01 * w) for w, ok in zip(speeds_rad_s, valid, strict=True))


def make_sensors(tick: int, values: Any) -> Sensors:
    rate, gyro_valid, q, star_new, star_valid, age_s, wheel_speeds, wheel_valid = values
    wheels = make_wheels(wheel_speeds, wheel_valid)
    return Sensors(tick, tick * PERIOD_S, rate, gyro_valid, q, star_new, star_valid, age_s, wheels)


def rest_at(tick: int, q: Vec4) -> Sensors:
    return Sensors(tick, tick * PERIOD_S, q_ib_meas=q, star_new=True, star_valid=True)


def flatten(value: Any) -> list[float]:
    """Every number in a nest of tuples and records."""
    if isinstance(value, (tuple, list)):
        return [number for item in value for number in flatten(item)]
    if isinstance(value, Record):
        return [number for item in value.values().values() for number in flatten(item)]
    return [] if value is None else [float(value)]


def assert_reset_reproduces(algorithm: Any, step: Callable[[Any, int], Any], count: int) -> list[Any]:
    """Results and internals are finite, and the same bit for bit after `reset`; the internals keep fields and lengths."""
    shape = find_shape(algorithm.internals)
    runs = []
    for _ in range(2):
        algorithm.reset()
        rows = []
        for index in range(count):
            result = step(algorithm, index)
            rows.append((flatten(result), flatten(algorithm.internals)))
            assert find_shape(algorithm.internals) == shape
        runs.append(rows)
    assert all(map(math.isfinite, flatten(runs[0])))
    assert repr(runs[0]) == repr(runs[1])
    return runs[0]


def find_shape(internals: Any) -> list[tuple[str, int]]:
    """Telemetry lays out a topic by this before the first cycle."""
    pairs = zip(internals._fields, internals, strict=True)
    return [(key, len(value) if isinstance(value, tuple) else 0) for key, value in pairs]


def test_every_kind_can_be_made_with_its_defaults_alone() -> None:
    """`{kind: x}` is enough in a scenario, no variant listed here is of a kind that is gone, and no two names are equal."""
    configs = [config for family in FAMILIES for config in list_configs(family)]
    assert {word for config in configs for word in (config.kind, type(config).__name__)} >= set(VARIANTS)
    for family in FAMILIES:
        names = [name(config) for config in list_configs(family)]
        assert len(set(names)) == len(names) >= 2


# -- estimators ----------------------------------------------------------------------------------------------------


@every(estimation)
@given(inputs=st.lists(sensor_values, min_size=1, max_size=20))
@settings(max_examples=40)
def test_estimator_is_finite_and_reset_reproduces(config: Any, inputs: list[Any]) -> None:
    """Finite, unit attitude for any unit attitude and any rate to 100 rad/s; reset gives the same numbers again."""

    def step(estimator: Any, k: int) -> Estimate:
        estimate: Estimate = estimator.step(make_sensors(k, inputs[k]))
        assert math.hypot(*estimate.q_ib) == pytest.approx(1.0, abs=1e-6)
        return estimate

    assert_reset_reproduces(make(estimation, config), step, len(inputs))


@every(estimation)
def test_estimator_stays_at_rest(config: Any) -> None:
    """A body at rest under ideal sensors is estimated at rest, where it is."""
    estimator = make(estimation, config)
    q = (0.5, 0.5, -0.5, 0.5)
    for k in range(300):
        estimate = estimator.step(rest_at(k, q))
    assert estimate.valid
    assert estimate.omega_bi_b_rad_s == pytest.approx(ZERO, abs=1e-12)
    assert abs(sum(a * b for a, b in zip(estimate.q_ib, q, strict=True))) == pytest.approx(1.0, abs=1e-12)


# -- detectors -----------------------------------------------------------------------------------------------------


@every(gyro_fdi)
@given(inputs=st.lists(st.tuples(sensor_values, torques, st.booleans()), min_size=1, max_size=20))
@settings(max_examples=30)
def test_detector_is_finite_and_reset_reproduces(config: Any, inputs: list[Any]) -> None:
    """Finite for any sensors up to 2 rad/s, known or not; states are 0 .. 3; reset gives the same numbers again."""

    def step(detector: Any, k: int) -> Any:
        values, torque, valid = inputs[k]
        sensors = make_sensors(k, (tuple(0.02 * x for x in values[0]), *values[1:]))
        estimate = Estimate(sensors.q_ib_meas, sensors.omega_meas_b_rad_s, ZERO, valid)
        found = detector.step(sensors, estimate, torque)
        assert set(found.gyro_state) <= {0, 1, 2, 3}
        return found

    assert_reset_reproduces(make(gyro_fdi, config), step, len(inputs))


@every(gyro_fdi)
def test_detector_is_silent_at_rest(config: Any) -> None:
    """Ideal sensors of a body at rest: no axis is suspect, the rate is good, nothing is asked for, for a minute."""
    detector, q = make(gyro_fdi, config), (0.5, 0.5, -0.5, 0.5)
    for k in range(600):
        found = detector.step(rest_at(k, q), Estimate(q, ZERO, ZERO, True), ZERO4)
        assert found.gyro_state == (0, 0, 0)
        assert found.rate_good
        assert not found.request_safe
        assert found.estimate.omega_bi_b_rad_s == pytest.approx(ZERO, abs=1e-9)
        assert found.rate_step_b_rad_s == ZERO


# -- observers -----------------------------------------------------------------------------------------------------


@every(observers)
@given(inputs=st.lists(st.tuples(vector, vector, bounded), min_size=1, max_size=20))
@settings(max_examples=40)
def test_observer_is_finite_and_reset_reproduces(config: Any, inputs: list[Any]) -> None:
    """Finite for any finite input in any order; the same sequence after reset gives the same numbers, bit for bit."""
    assert_reset_reproduces(make(observers, config), lambda o, k: o.step(PERIOD_S, *inputs[k]), len(inputs))


@every(observers)
def test_observer_stays_at_rest(config: Any) -> None:
    """No rate, no torque: no fault torque, for ever."""
    observer = make(observers, config)
    for _ in range(1000):
        assert observer.step(PERIOD_S, ZERO, ZERO, ZERO) == ZERO


@every(observers)
def test_observer_is_bounded_under_bounded_noise(config: Any) -> None:
    """Rate noise of 1e-3 rad/s never builds up: the estimate stays below a few times the noise's worst single effect."""
    observer = make(observers, config)
    largest = 0.0
    for k in range(5000):
        sign = 1.0 if (k * 7919) % 13 < 6 else -1.0
        v = observer.step(PERIOD_S, (1e-3 * sign, -1e-3 * sign, 1e-3), ZERO, ZERO)
        largest = max(largest, *(abs(x) for x in v))
    assert largest < 1.0  # 2e-3 rad/s seen through 140 N m s/rad, times three


@every(observers)
def test_observer_does_not_feel_a_known_rate_jump(config: Any) -> None:
    """shift_rate with the jump of the rate source leaves the fault torque as it would have been without the jump."""
    jump = (1e-3, -2e-3, 5e-4)
    plain, shifted = make(observers, config), make(observers, config)
    for k in range(60):
        rate = (1e-4 * k, -5e-5 * k, 2e-5 * k)
        expected = plain.step(PERIOD_S, rate, (1e-3, 0.0, 0.0), ZERO)
        if k == 30:
            shifted.shift_rate(jump)
        moved = rate if k < 30 else (rate[0] + jump[0], rate[1] + jump[1], rate[2] + jump[2])
        assert shifted.step(PERIOD_S, moved, (1e-3, 0.0, 0.0), ZERO) == pytest.approx(expected, abs=1e-3)


@every(observers)
@pytest.mark.parametrize("dt_s", [0.0, PERIOD_S, 0.25, 3.0, 1e6])
def test_observer_takes_any_time_step(config: Any, dt_s: float) -> None:
    """Lost ticks are no error: whatever time has passed, the answer is finite."""
    observer = make(observers, config)
    for k in range(20):
        v = observer.step(dt_s if k % 3 == 2 else PERIOD_S, (0.01, 0.02 * k, -0.01), (0.1, 0.0, 0.0), ZERO)
        assert all(map(math.isfinite, v))


# -- wheel health --------------------------------------------------------------------------------------------------


@every(wheel_health)
@given(inputs=st.lists(st.tuples(speeds, flags, torques, st.none() | vector), min_size=1, max_size=20))
@settings(max_examples=40)
def test_wheel_health_is_in_range_and_reset_reproduces(config: Any, inputs: list[Any]) -> None:
    """Shares within 0 .. 1 and finite for any speeds, commands and fault torque; reset gives the same numbers again."""

    def step(monitor: Any, k: int) -> WheelHealth:
        wheel_speeds, valid, torque, fault = inputs[k]
        health: WheelHealth = monitor.step(PERIOD_S, make_wheels(wheel_speeds, valid), torque, fault)
        assert all(0.0 <= share <= 1.0 for share in health.effectiveness)
        return health

    assert_reset_reproduces(make(wheel_health, config), step, len(inputs))


@every(wheel_health)
def test_wheels_that_do_as_told_are_healthy(config: Any) -> None:
    """Momentum falls by the torque commanded and no fault torque is seen: full shares, all available, no alarm."""
    monitor, speed = make(wheel_health, config), [0.0, 100.0, -100.0, 5.0]
    torque = (0.05, -0.03, 0.1, 0.0)
    for _ in range(300):
        health = monitor.step(PERIOD_S, make_wheels(tuple(speed)), torque, ZERO)  # type: ignore[arg-type]
        speed = [w - PERIOD_S * t / 0.01 for w, t in zip(speed, torque, strict=True)]
        for key in ("effectiveness", "available", "alarm", "explained_b_nm", "kind", "dither"):
            assert getattr(health, key) == getattr(HEALTHY, key), key


@every(wheel_health)
def test_lost_frames_are_no_fault_of_a_wheel(config: Any) -> None:
    """Half of all wheel frames lost, the last values held and marked so, commands that change: nobody is accused."""
    monitor, rng = make(wheel_health, config), random.Random(11)
    speed, held = [20.0, 100.0, -100.0, 50.0], [20.0, 100.0, -100.0, 50.0]
    torque: Vec4 = ZERO4
    for k in range(600):
        new = [k == 0 or rng.random() < 0.5 for _ in range(4)]
        held = [w if ok else old for w, old, ok in zip(speed, held, new, strict=True)]
        wheels = make_wheels(tuple(held))  # type: ignore[arg-type]
        for reading, ok in zip(wheels, new, strict=True):
            reading.new = ok
        health = monitor.step(PERIOD_S, wheels, torque, ZERO)
        for key in ("available", "alarm", "kind", "dead"):
            assert getattr(health, key) == getattr(HEALTHY, key), (key, k)
        torque = tuple(0.1 * math.sin(0.03 * k + i) for i in range(4))  # type: ignore[assignment]
        speed = [w - PERIOD_S * t / 0.01 for w, t in zip(speed, torque, strict=True)]


# -- controllers ---------------------------------------------------------------------------------------------------


@every(controllers)
@given(inputs=st.lists(st.tuples(errors, vector, healths), min_size=1, max_size=20))
@settings(max_examples=40)
def test_controller_is_finite_and_reset_reproduces(config: Any, inputs: list[Any]) -> None:
    """Torque and internals are finite for any finite input in any order; reset gives the same numbers again."""
    assert_reset_reproduces(make(controllers, config), lambda c, k: c.step(PERIOD_S, *inputs[k]), len(inputs))


@every(controllers)
def test_controller_asks_for_nothing_at_the_target(config: Any) -> None:
    """On target, at rest, no fault torque: no torque, for ever."""
    controller = make(controllers, config)
    error = PointingError((1.0, 0.0, 0.0, 0.0), ZERO)
    for _ in range(1000):
        assert controller.step(PERIOD_S, error, ZERO, HEALTHY) == pytest.approx(ZERO, abs=1e-12)


@every(controllers)
def test_controller_pushes_towards_the_target_from_rest(config: Any) -> None:
    """At rest off target, the torque turns the error down: its component along the eigenaxis is negative."""
    for axis in ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, 0.8), (-0.48, 0.64, 0.6)):
        error = PointingError((math.cos(0.5), *(math.sin(0.5) * x for x in axis)), ZERO)  # type: ignore[arg-type]
        torque = make(controllers, config).step(PERIOD_S, error, ZERO, HEALTHY)
        assert sum(a * b for a, b in zip(axis, torque, strict=True)) < -1e-3


# -- allocators ----------------------------------------------------------------------------------------------------


@every(allocators)
@given(torque=vector, health=healths)
@settings(max_examples=100)
def test_allocator_stays_within_limits(config: Any, torque: Vec3, health: WheelHealth) -> None:
    """No input makes it ask a wheel for more than it has, or one that is not available for anything; what the wheels add
    up to is what it says, and the margin is what is left."""
    allocator = make(allocators, config)
    found = allocator.allocate(torque, health)
    a, b, c, d = found.tau_rw_nm
    assert max(map(abs, found.tau_rw_nm)) <= LIMIT_NM
    assert all(x == 0.0 for x, ok in zip(found.tau_rw_nm, health.available, strict=True) if not ok)
    skew = d / math.sqrt(3.0)
    assert found.achieved_b_nm == pytest.approx((a + skew, b + skew, c + skew), abs=1e-12)
    assert found.margin == pytest.approx(1.0 - max(map(abs, found.tau_rw_nm)) / LIMIT_NM, abs=1e-12)
    assert_reset_reproduces(allocator, lambda it, _: it.allocate(torque, health), 2)


@every(allocators)
@given(torque=st.tuples(*[st.floats(-0.05, 0.05)] * 3))
def test_allocator_never_opposes_what_was_asked(config: Any, torque: Vec3) -> None:
    """Within the limits the wheels' torques have a part along the torque asked for that is at least as large as it."""
    achieved = make(allocators, config).allocate(torque, HEALTHY).achieved_b_nm
    along = sum(a * b for a, b in zip(achieved, torque, strict=True))
    assert along >= sum(x * x for x in torque) * (1.0 - 1e-9)


@given(
    torque=st.tuples(*[st.floats(-0.02, 0.02)] * 3), weak=st.tuples(*[st.floats(0.5, 1.0)] * 4), lost=st.integers(0, 4)
)
def test_pseudo_inverse_gives_the_torque_where_it_can(torque: Vec3, weak: Vec4, lost: int) -> None:
    """Shares of the wheels' torques add up to what was asked, with weak wheels and with one of the four lost."""
    (settings_class, _) = allocators.REGISTRY.kinds["pseudo_inverse"]
    available = tuple(wheel != lost for wheel in range(4))
    share = tuple(e if ok else 0.0 for e, ok in zip(weak, available, strict=True))
    found = make(allocators, settings_class(kind="pseudo_inverse")).allocate(torque, WheelHealth(share, available))  # type: ignore[arg-type]
    a, b, c, d = (e * x for e, x in zip(share, found.tau_rw_nm, strict=True))
    skew = d / math.sqrt(3.0)
    assert (a + skew, b + skew, c + skew) == pytest.approx(torque, abs=1e-12)
