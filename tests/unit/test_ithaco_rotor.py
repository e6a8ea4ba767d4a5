"""The ITHACO Type-A class rotor against trajectories of an independent integrator (DOP853, rtol 1e-11), and spot values."""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from plant_server.config import WheelMotorConfig
from plant_server.faults.effects import WheelDisturbance
from plant_server.wheels.ithaco_rotor import IthacoRotor
from plant_server.wheels.motor import Motor

DATA = Path(__file__).parents[1] / "data" / "wheel"
CASES: dict[str, Any] = json.loads((DATA / "wheel_single.json").read_text())
STEP_S = 0.01
FAULT_S = 20.0


@cache
def load(case: str) -> dict[str, np.ndarray]:
    with np.load(DATA / "wheel_single.npz") as file:
        return {name.split("/")[1]: file[name] for name in file.files if name.startswith(f"{case}/")}


def make_rotor(case: dict[str, Any]) -> IthacoRotor:
    """With the parameters of a reference case; `_V` values by the reference's own names."""
    p = case["params"]
    motor = WheelMotorConfig(
        inertia_kgm2=p["J"], driver_gain_a_v=p["Gd"], torque_constant_nm_a=p["kt"], back_emf_v_s=p["ke"],
        bandwidth_rad_s=p["wd"], max_command_v=p["Vmax"], coulomb_nm=p["tc"], static_nm=p["ts"], viscous_nm_s=p["v0"],
        viscous_slope_nm_s_k=p["v1"], overspeed_rad_s=p["ws"], overspeed_gain_v_s=p["Ks"], emf_gain=p["Kf"],
        bus_v=p["Vbus"], input_ohm=p["Rin"], bridge_ohm=p["Rb"], quiescent_w=p["Pq"], ripple=p["B"], cogging_nm=p["Cc"],
        temperature_c=case["x0"]["T"], ambient_c=p["Tenv"], thermal=bool(p["thermal"]), thermal_resistance_k_w=p["Rth"],
        heat_capacity_j_k=p["Cth"],
    )  # fmt: skip
    rotor = IthacoRotor(Motor(motor))
    rotor.current_a = case["x0"]["I"]
    return rotor


def disturb(name: str, t_s: float) -> WheelDisturbance:
    """What the faults of the reference make of the wheel, from FAULT_S on."""
    state = WheelDisturbance()
    if t_s < FAULT_S - 1e-9:
        return state
    if name == "f_gain_Ct_step":
        state.torque_gain = 0.6
    elif name == "f_driver_Cd_step":
        state.driver_gain = 0.6
    elif name == "f_friction_extra":
        state.friction_nm = 0.003
    elif name == "f_stuck_torque":
        state.is_stuck, state.stuck_current_a = True, 0.015 / 0.029
    elif name == "f_idle_motor_off":
        state.motor_on = False
    elif name == "f_seizure":
        state.seize_nm = 0.8 * min(1.0, (t_s + 0.5 * STEP_S - FAULT_S) / 0.2)
    return state


@pytest.mark.parametrize("name", list(CASES))
def test_it_follows_the_reference(name: str) -> None:
    """Current within 5e-4 A and speed within 5e-3 rad/s at the plant's step; 1 rad/s through a seizure."""
    data, rotor = load(name), make_rotor(CASES[name])
    per_sample = round(CASES[name]["dt_sample"] / STEP_S)
    h, worst_i, worst_w = CASES[name]["x0"]["h"], 0.0, 0.0
    inertia = CASES[name]["params"]["J"]
    until = min(len(data["V"]), 1230 if name == "f_seizure" else len(data["V"]))
    for k in range(until):
        for j in range(per_sample):
            t = (k * per_sample + j) * STEP_S
            h += STEP_S * rotor.advance(data["V"][k], h, 0.0, 0.0, t, STEP_S, disturb(name, t))
        worst_i = max(worst_i, abs(rotor.current_a - data["I"][k + 1]))
        worst_w = max(worst_w, abs(h / inertia - data["w"][k + 1]))
    assert worst_i <= (1e-3 if "emf" in name else 5e-4)
    assert worst_w <= (1.0 if name == "f_seizure" else 1e-2 if "emf" in name else 5e-3)


def run_up(bus_v: float, preset: Any = "ithaco_a") -> float:
    rotor = IthacoRotor(Motor(WheelMotorConfig(preset=preset, bus_v=bus_v)))
    state, h = WheelDisturbance(), 0.0
    for k in range(150_000):
        h += STEP_S * rotor.advance(5.0, h, 0.0, 0.0, k * STEP_S, STEP_S, state)
    return h / 0.0077


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bus_v", "preset", "speed_rad_s"),
    [(28.0, "ithaco_a", 654.80), (24.0, "ithaco_a", 654.80), (20.0, "ithaco_a", 540.12), (16.0, "ithaco_a", 423.41),
     (28.0, "low_drag", 680.04)],
)  # fmt: skip
def test_top_speed(bus_v: float, preset: str, speed_rad_s: float) -> None:
    """1500 s at full command: drag stops it at 28 and 24 V, back-EMF below, the speed limiter where drag is low."""
    assert run_up(bus_v, preset) == pytest.approx(speed_rad_s, abs=0.05)


def test_coast_down() -> None:
    """From 300 rad/s without a command: half the speed after 109.95 s, at rest after 379.9 s."""
    rotor, state, h = IthacoRotor(Motor(WheelMotorConfig())), WheelDisturbance(), 300.0 * 0.0077
    passed = {}
    for k in range(39_000):
        h += STEP_S * rotor.advance(0.0, h, 0.0, 0.0, k * STEP_S, STEP_S, state)
        for speed in (150.0, 0.05):
            if h / 0.0077 < speed:
                passed.setdefault(speed, (k + 1) * STEP_S)
    assert passed == {150.0: pytest.approx(109.95, abs=0.5), 0.05: pytest.approx(379.9, abs=0.5)}


def test_ripple_is_the_mean_over_the_step() -> None:
    """Quadrature of the sine over a step, slow and fast: where it turns through many poles it is all but gone."""
    motor = Motor(WheelMotorConfig(ripple=0.22))
    for speed in (0.0, 0.3, 2.0, 30.0, 300.0):
        rotor = IthacoRotor(motor)
        rotor.theta_rad = 0.123
        angles = 0.123 + speed * (np.arange(20_000) + 0.5) / 20_000 * STEP_S
        ripple, cogging = rotor._find_ripple(speed * STEP_S)
        assert ripple == pytest.approx(0.22 * np.sin(108.0 * angles).mean(), abs=1e-6)
        assert cogging == 0.0


def test_flags_have_a_hysteresis() -> None:
    """Overspeed: set above 680 rad/s, cleared below 0.98 of it; limited by the back-EMF: cleared with 0.5 V to spare."""
    rotor, state = IthacoRotor(Motor(WheelMotorConfig())), WheelDisturbance()
    seen = []
    for speed in (679.0, 681.0, 670.0, 666.0, 679.0):
        rotor.note_limits(speed, state)
        seen.append(rotor.overspeed)
    assert seen == [False, True, True, False, False]
    rotor = IthacoRotor(Motor(WheelMotorConfig(bus_v=18.0)))
    edge = next(w for w in np.arange(0.0, 700.0, 0.01) if rotor.find_headroom(0.0, w, state) > 0.0)
    seen = []
    for volts in (-0.01, 0.01, -0.4, -0.6, -0.01):
        rotor.note_limits(float(edge) + volts / 0.029, state)
        seen.append(rotor.emf_limited)
    assert seen == [False, True, True, False, False]


def test_friction_of_rest_and_temperature() -> None:
    """Stribeck falls with the square of the speed, viscous friction with temperature and never below its floor."""
    rotor = IthacoRotor(Motor(WheelMotorConfig(static_nm=0.006, viscous_nm_s=4.9e-5)))
    state = WheelDisturbance()
    for speed in (0.2, 0.42, 1.5, 80.0):
        dry = 0.002 + 0.004 * math.exp(-((speed / 0.42) ** 2))
        assert rotor.find_friction(speed, state) == pytest.approx(
            math.tanh(speed / 0.1) * dry + 3.9e-5 * speed, rel=1e-12
        )
    rotor.temperature_c = 250.0
    assert rotor.find_friction(100.0, state) == pytest.approx(0.002 + 5e-4, rel=1e-9)
