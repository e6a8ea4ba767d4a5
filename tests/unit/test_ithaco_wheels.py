"""Wheels with motors in the plant: momentum through every fault, commands, power, limits, telemetry, bad settings."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.errors import ConfigError
from bus.settings import build
from bus.wheels import CURRENT, EMF_LIMITED, OFF, OVERSPEED, SPEED, TORQUE, UNDERVOLTAGE
from plant_server.config import PlantConfig
from plant_server.faults import KINDS, make_fault
from plant_server.plant import Plant
from tools.run.bench import Bench

DATA = Path(__file__).parents[1] / "data" / "wheel"
STEP_S = 0.01
INERTIA = [[12.49, 0, 0], [0, 13.85, 0], [0, 0, 15.75]]
NEEDS = {"loss": {"effectiveness": 0.5}, "bias": {"torque_nm": 0.002}, "stuck_torque": {"torque_nm": 0.015}}


def make(faults: tuple[Any, ...] = (), **wheel: Any) -> Plant:
    """Four wheels of the preset ithaco_a at +-200 rad/s on a body that turns, no external torque."""
    speeds = (200.0, -200.0, 200.0, -200.0)
    wheels = [
        {"mount": mount, "model": "ithaco", "speed_rad_s": speed, **wheel}
        for mount, speed in zip(("x", "y", "z", "skew"), speeds, strict=True)
    ]
    body = {"inertia_kgm2": INERTIA, "rate_deg_s": [0.5, -0.3, 0.2]}
    return Plant(build(PlantConfig, {"body": body, "wheels": wheels}, "plant"), faults, STEP_S, 1)


def momentum(plant: Plant) -> np.ndarray:
    return np.array(plant.truth().h_total_i_nms)


@pytest.mark.parametrize("kind", sorted(KINDS["wheel"]))
def test_total_momentum_holds_through_every_fault(kind: str) -> None:
    """Friction, seizure, motor, supply: whatever happens inside does not change the sum, to 1e-9 of it."""
    fault = make_fault(unit="wheel.1", kind=kind, at_s=1.0, until_s=12.0, **NEEDS.get(kind, {}))
    plant = make((fault,))
    before = momentum(plant)
    for k in range(1500):
        torque = 0.02 * math.sin(k * 0.01)
        plant.sample()
        plant.step((torque, -torque, 0.5 * torque, torque))
    assert np.linalg.norm(momentum(plant) - before) <= 1e-9 * np.linalg.norm(before)


@pytest.mark.slow
def test_total_momentum_holds_for_400_s() -> None:
    """Wheels at +-200 rad/s, commands through zero and into the limits."""
    plant = make()
    before = momentum(plant)
    for k in range(40_000):
        torque = 0.03 * math.sin(k * 0.002)
        plant.step((torque, -torque, 0.5 * torque, -torque))
    assert np.linalg.norm(momentum(plant) - before) <= 1e-9 * np.linalg.norm(before)


def test_a_seizure_gives_the_body_the_rotors_momentum() -> None:
    """0.186 rad/s within 2 % 3 s after a wheel at 304 rad/s on 12.49 kg m^2 has seized: h / I, whatever the friction."""
    seize = make_fault(unit="wheel.1", kind="seize", at_s=1.0)
    body = {"inertia_kgm2": INERTIA}
    wheels = [{"mount": "x", "model": "ithaco", "speed_rad_s": 304.0}, *({"mount": m} for m in ("y", "z", "skew"))]
    plant = Plant(build(PlantConfig, {"body": body, "wheels": wheels}, "plant"), (seize,), STEP_S, 1)
    for _ in range(450):
        plant.step((0.0, 0.0, 0.0, 0.0))
    assert plant.truth().omega_bi_b_rad_s[0] == pytest.approx(304.0 * 0.0077 / 12.49, rel=0.02)
    assert abs(plant.truth().speed_rad_s[0]) < 1.0


@pytest.mark.parametrize(
    ("case", "law"),
    [("A_pid_fault1_dist1", "rate_pid"), ("A_fuzzy_fault1_dist1", "fuzzy_pid"), ("B_pid_fault1_dist1", "pid")],
)
def test_the_whole_bench_follows_the_reference(case: str, law: str) -> None:
    """S003 over real frames, plant and flight software: within 1e-5 rad of an independent integration of the equations."""
    bench = Bench.open("ithaco-gain-fault", ["clock.mode=inprocess", f"fsw.controller={{kind: {law}}}"])
    with np.load(DATA / "closed_loop_excerpt.npz") as file:
        thetas = file[f"{case}/theta_1s"]
    for second, theta in enumerate(thetas[:400]):
        bench.step(10 * second + 1 - bench.tick)
        q = bench.sampled_truth.q_ib
        mine = [math.copysign(2.0, q[0]) * value for value in q[1:]]
        assert mine == pytest.approx(theta.tolist(), abs=1e-5)


def test_current_and_speed_commands() -> None:
    """A current is held with the sign of the torque on the body; a speed is reached without overshoot beyond 5 %."""
    plant = make()
    for _ in range(300):
        plant.step((0.5, 0.0, 260.0, 0.0), (CURRENT, TORQUE, SPEED, OFF))
    assert plant.sample().wheel_current_a[0] == pytest.approx(0.5, abs=1e-3)
    highest = 0.0
    for _ in range(4000):
        plant.step((0.0, 0.0, 260.0, 0.0), (CURRENT, TORQUE, SPEED, OFF))
        highest = max(highest, plant.truth().speed_rad_s[2])
    assert plant.truth().speed_rad_s[2] == pytest.approx(260.0, abs=0.5)
    assert highest <= 263.0


def test_power_and_latches() -> None:
    """Off, a wheel coasts whatever it is told; what it latched stays until cleared, and comes back with its cause."""
    plant = make((make_fault(unit="wheel.2", kind="bus_sag", voltage_v=7, at_s=0.0),))
    plant.step((0.0, 0.02, 0.0, 0.0))
    plant.step((0.0, 0.02, 0.0, 0.0))
    plant.sample()
    latched = plant.wheels.latch[1]
    assert latched == UNDERVOLTAGE | EMF_LIMITED
    plant.clear_latch(1, UNDERVOLTAGE)
    assert plant.wheels.latch[1] == EMF_LIMITED
    plant.step((0.0, 0.02, 0.0, 0.0))
    plant.sample()
    assert plant.wheels.latch[1] == latched
    plant.set_wheel_power(2, on=False)
    for _ in range(200):
        plant.step((0.02, 0.02, 0.02, 0.02))
    current = plant.sample().wheel_current_a
    assert abs(current[2]) < 1e-6 < 0.3 < abs(current[0])
    plant.set_wheel_power(2, on=True)
    for _ in range(200):
        plant.step((0.02, 0.02, 0.02, 0.02))
    assert abs(plant.sample().wheel_current_a[2]) > 0.3


def test_overspeed_is_reported() -> None:
    """Status 3 and a latch above the limit of the preset."""
    plant = make(motor={"preset": "low_drag", "overspeed_rad_s": 201.0})
    for _ in range(400):
        plant.step((-0.02, 0.0, 0.0, 0.0))
    assert plant.sample().wheel_status[0] == 3
    assert plant.wheels.latch[0] & OVERSPEED


@pytest.mark.parametrize(
    ("wheel", "said"),
    [
        ({"motor": {"coulomb_nm": -0.001}}, "motor.coulomb_nm"),
        ({"motor": {"bus_v": 1.2}}, "leave the driver"),
        ({"motor": {"bandwidth_rad_s": 400}}, "the driver has a rate of 400 1/s"),
        ({"motor": {"static_nm": 0.3}}, "dry friction at rest has a rate"),
        ({"motor": {"coulomb_nm": 0.03}}, "could never start"),
        ({"motor": {"static_nm": 0.001}}, "friction at rest is the larger one"),
        ({"motor": {"torque_constant_nm_a": 0}}, "motor.torque_constant_nm_a"),
        ({"motor": {"overspeed_rad_s": 100}}, "is beyond overspeed_rad_s"),
        ({"motor": {"overspeed_gain_v_s": 1e4}}, "the speed limiter has a rate"),
        ({"max_torque_nm": 0.2}, "is of an ideal wheel"),
        ({"model": "ideal", "motor": {}}, "give `model: ithaco`"),
        ({"motor": {"preset": "rw1000"}}, '"rw1000"'),
    ],
)
def test_bad_settings_are_refused_with_the_reason(wheel: dict[str, Any], said: str) -> None:
    """Negative friction, limits that forbid any motion, steps beyond stability, presets turned into nonsense."""
    with pytest.raises(ConfigError) as refused:
        make(**wheel)
    assert said in str(refused.value)


def test_imbalance_shakes_the_body() -> None:
    """At 20 rad/s the dynamic imbalance U_d w^2 turns with the rotor: amplitude and direction, in the plane of the wheel."""
    body = {"inertia_kgm2": INERTIA}
    motor = {"preset": "low_drag", "jitter": True, "dynamic_imbalance_kg_m2": 1e-4}
    wheels = [
        {"mount": "x", "model": "ithaco", "speed_rad_s": 20.0, "motor": motor}, *({"mount": m} for m in ("y", "z", "skew")),
    ]  # fmt: skip
    plant = Plant(build(PlantConfig, {"body": body, "wheels": wheels}, "plant"), (), STEP_S, 1)
    torques, squares = [], []
    for _ in range(157):
        squares.append(plant.truth().speed_rad_s[0] ** 2)
        plant.step((0.0, 0.0, 0.0, 0.0))
        torques.append(plant.wheels.torque_b_nm)
    y, z = np.array(torques)[:, 1], np.array(torques)[:, 2]
    assert np.hypot(y, z) == pytest.approx(1e-4 * np.array(squares), rel=0.005)  # a mean over 0.2 rad is 0.2 % less
    turned = np.unwrap(np.arctan2(z, y))
    assert abs(turned[-1] - turned[0]) == pytest.approx(20.0 * 1.56, rel=0.02)
