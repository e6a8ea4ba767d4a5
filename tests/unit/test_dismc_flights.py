"""Discrete integral sliding mode with direct allocation, closed over a rigid body: an independent flight, step by step."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.linear import ZERO3
from fsw.allocators.direct import Direct
from fsw.allocators.settings import DirectAllocationConfig
from fsw.controllers.dismc import DiscreteIntegralSlidingMode
from fsw.controllers.settings import DismcConfig
from fsw.modes import Mode
from fsw.records import PointingError, WheelHealth
from fsw.settings import ModelConfig
from fsw.vehicle import Vehicle
from tools.run.bench import Bench

REFERENCE = Path(__file__).parents[1] / "data/control/dismc_closed_loop.npz"
INERTIA = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))
J = np.array(INERTIA)
INVERSE = np.linalg.inv(J)
VEHICLE = Vehicle(ModelConfig(inertia_kgm2=INERTIA, wheel_max_torque_nm=0.1))
D = np.array(VEHICLE.wheels.axes_b).T
T, STEP_S = 0.1, 0.005


def rate_of(x: Any, torque: Any) -> Any:
    """Time derivative of attitude (scalar first) and rate of a rigid body."""
    q0, qx, qy, qz, wx, wy, wz = x
    spin = np.array([wx, wy, wz])
    turn = 0.5 * np.array(
        [
            -qx * wx - qy * wy - qz * wz,
            q0 * wx + qy * wz - qz * wy,
            q0 * wy - qx * wz + qz * wx,
            q0 * wz + qx * wy - qy * wx,
        ]
    )
    return np.concatenate([turn, INVERSE @ (torque - np.cross(spin, J @ spin))])


def advance(x: Any, torque: Any) -> Any:
    """The body one control period later: RK4, quaternion normalised after each step."""
    for _ in range(round(T / STEP_S)):
        a = rate_of(x, torque)
        b = rate_of(x + 0.5 * STEP_S * a, torque)
        c = rate_of(x + 0.5 * STEP_S * b, torque)
        d = rate_of(x + STEP_S * c, torque)
        x = x + STEP_S / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        x[:4] /= np.linalg.norm(x[:4])
    return x


def fly(name: str, steps: int) -> tuple[Any, Any, Any]:
    """Attitude, wheel torque and pointing error [deg] of a case of the reference; the health factors are the truth."""
    reference = np.load(REFERENCE)
    law = DiscreteIntegralSlidingMode(DismcConfig(kind="dismc"), VEHICLE, T)
    allocator = Direct(DirectAllocationConfig(kind="direct", share_min=0.0), VEHICLE, T)
    share, stuck = (
        reference[f"{name}_share"].astype(float).round(6),
        reference[f"{name}_stuck_nm"].astype(float).round(6),
    )
    x = np.concatenate([reference[f"{name}_q"][0], reference["omega0_rad_s"]])
    rows = []
    for k in range(steps):
        q = x[:4] if x[0] >= 0.0 else -x[:4]
        health = WheelHealth(effectiveness=tuple(share[k].tolist()), bias_nm=tuple(stuck[k].tolist()))
        error = PointingError(tuple(q.tolist()), tuple(x[4:].tolist()))
        allocation = allocator.allocate(law.step(T, error, (0.0, 0.0, 0.0), health), health)
        u = np.array(allocation.tau_rw_nm)
        law.note_sent(tuple((D @ (u * allocation.shares + allocation.bias_nm)).tolist()))
        rows.append((x[:4].copy(), u, 2.0 * np.degrees(np.arctan2(np.linalg.norm(q[1:]), q[0]))))
        middle = (k + 0.5) * T
        push = 2e-3 * np.array([1.0, -1.0, 0.5]) + 1e-3 * np.sin(2.0 * np.pi * middle / 100.0 + np.arange(3.0))
        x = advance(x, D @ (share[k] * u + stuck[k]) + push)
    attitude, torque, error_deg = zip(*rows, strict=True)
    return np.array(attitude), np.array(torque), np.array(error_deg)


fly_once = cache(fly)


@pytest.mark.parametrize("name", ["none", "s000"])
def test_follows_the_reference_for_a_minute(name: str) -> None:
    """Without faults, and with the published ones: attitude and wheel torques of an independent flight, far within 1e-6."""
    reference = np.load(REFERENCE)
    attitude, torque, _ = fly_once(name, 600)
    assert np.abs(attitude - reference[f"{name}_q"][:600]).max() < 1e-9
    assert np.abs(torque - reference[f"{name}_u"][:600]).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("name", "degree", "tenth"), [("none", 50.7, 80.4), ("s000", 78.9, 97.5)])
def test_settles_when_the_reference_does(name: str, degree: float, tenth: float) -> None:
    """300 s: times to 1 and 0.1 degrees within 0.2 s of the reference's, the same error at the end."""
    expected = np.load(REFERENCE)[f"{name}_error_deg"]
    found = fly_once(name, 3000)[2]
    for bound, stated in ((1.0, degree), (0.1, tenth)):
        last = [T * np.nonzero(error_deg > bound)[0][-1] for error_deg in (found, expected)]
        assert last[0] == pytest.approx(last[1], abs=0.2)
        assert last[0] == pytest.approx(stated, abs=0.25)
    assert np.abs(found - expected[:3000]).max() < 1e-4


def test_a_lost_axis_is_no_new_beginning() -> None:
    """Two wheels dead at once: the mode becomes degraded, and what the law has learnt of the disturbance stays."""
    faults = "faults=[{unit: wheel.1, kind: dead, at_s: 10}, {unit: wheel.2, kind: dead, at_s: 10}]"
    with Bench.open("dismc", ["expect=[]", faults]) as bench:
        before = ZERO3
        while bench.flight.modes.mode is not Mode.DEGRADED:
            assert bench.tick < 400
            before = bench.flight.controller.internals.disturbance_b_nm
            bench.step()
        after = bench.flight.controller.internals.disturbance_b_nm
    assert np.linalg.norm(before) > 1e-3
    assert np.linalg.norm(np.subtract(after, before)) < 0.5 * np.linalg.norm(before)
