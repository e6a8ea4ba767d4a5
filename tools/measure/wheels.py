"""What wheels cost: one integration step of the whole bank and body, and a cycle of the health filters of four wheels."""

from __future__ import annotations

import time
from typing import Any, Final

from bus.settings import build
from fsw import wheel_health
from fsw.records import four_readings
from fsw.settings import ModelConfig, WheelMotorConfig
from fsw.vehicle import Vehicle
from fsw.wheel_health.settings import WheelKalmanConfig
from plant_server.config import PlantConfig
from plant_server.plant import Plant

STEPS: Final = 5000
ROUNDS: Final = 7
STEP_S: Final = 0.01
INERTIA = ((12.49, 0.0, 0.0), (0.0, 13.85, 0.0), (0.0, 0.0, 15.75))
MOUNTS = ("x", "y", "z", "skew")


def measure_wheels() -> dict[str, Any]:
    """CPU time of each, the best of ROUNDS [us]."""
    return {
        "bank of ideal wheels and body, us a step": _measure_bank("ideal"),
        "bank of four ITHACO wheels and body, us a step": _measure_bank("ithaco"),
        "health filters of four wheels, us a cycle": _measure_filters(),
    }


def _measure_bank(model: str) -> float:
    wheels = [{"mount": mount, "model": model, "speed_rad_s": 100.0} for mount in MOUNTS]
    plant = Plant(
        build(PlantConfig, {"body": {"inertia_kgm2": [list(row) for row in INERTIA]}, "wheels": wheels}, "plant"),
        (),
        STEP_S,
        1,
    )
    commands = [(0.01 * (-1) ** k, 0.005, -0.01, 0.002) for k in range(STEPS)]

    def work() -> None:
        for command in commands:
            plant.step(command)

    return _best(work)


def _measure_filters() -> float:
    model = ModelConfig(
        inertia_kgm2=INERTIA, wheel_inertia_kgm2=0.0077, wheel_motor=WheelMotorConfig(preset="ithaco_a")
    )
    monitor = wheel_health.REGISTRY.make(WheelKalmanConfig(kind="wheel_kalman"), Vehicle(model), 0.1)
    readings = four_readings()
    for reading in readings:
        reading.speed_rad_s = 100.0
        reading.current_a = -(0.002 + 3.9e-5 * 100.0) / 0.029
    commands = (-5.9e-3, -5.9e-3, -5.9e-3, -5.9e-3)

    def work() -> None:
        for _ in range(STEPS):
            monitor.step(0.1, readings, commands, None)

    return _best(work)


def _best(work: Any) -> float:
    best = float("inf")
    for _ in range(ROUNDS):
        started = time.process_time()
        work()
        best = min(best, time.process_time() - started)
    return best / STEPS * 1e6
