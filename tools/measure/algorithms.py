"""What a step of every registered algorithm costs, each by itself, on the build at hand.

The kinds come from the registries of the flight software, each with its default settings. They are given what a flight gave
its own: the first minute of `zhang2018-flight` at 10 Hz (noisy sensors, Kalman filter, three faults), and for wheel health
that of `ithaco-hold`, whose wheels have motors and slow telemetry.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Final

from bus.units import Vec3, Vec4
from fsw import allocators, controllers, estimation, gyro_fdi, observers, wheel_health
from fsw.flight import Flight
from fsw.records import Estimate, PointingError, Sensors, WheelCommands, WheelHealth, WheelReading
from fsw.vehicle import Vehicle
from tools.config.loader import load_scenario
from tools.config.scenario_files import find_scenario
from tools.run.bench import Bench

PERIOD_S: Final = 0.1
STEPS: Final = 600  # one block: the flight once
BLOCKS: Final = 21
COMMON = ("clock.mode=inprocess", "clock.tick_hz=10", "expect=[]")
TURN, HOLD = "zhang2018-flight", "ithaco-hold"
FLIGHTS = {TURN: ("fsw.executive.control_divider=1", "plant.star_tracker.rate_hz=5"), HOLD: ()}


@dataclass(frozen=True, slots=True)
class Moment:
    """What the parts of a flight were given on one tick."""

    sensors: Sensors
    estimate: Estimate
    meant_nm: Vec4  # wheel torques over the tick that ended, and those that the frames carried
    sent_nm: Vec4
    tau_cmd_b_nm: Vec3  # body torque over the tick that ended
    momentum_b_nms: Vec3
    tau_fault_b_nm: Vec3
    error: PointingError
    health: WheelHealth
    tau_b_nm: Vec3  # commanded now


@dataclass(frozen=True, slots=True)
class Recording:
    """A flight as its parts saw it."""

    vehicle: Vehicle
    moments: Sequence[Moment]


Step = Callable[[Any, Moment], Any]


def measure_algorithms(steps: int = STEPS, blocks: int = BLOCKS) -> dict[str, float]:
    """Return the CPU time of a step [us] of each kind of each family: the median of `blocks` blocks of `steps` steps.

    What a flight tells it beside the step is in it, and so is the call from Python, about 0.1 us.
    """
    recordings = {name: record(name, settings, steps) for name, settings in FLIGHTS.items()}
    figures = {}
    for name, family in FAMILIES.items():
        recording = recordings[family.flight]
        for kind, (make_settings, _) in family.package.REGISTRY.kinds.items():
            algorithm = family.package.REGISTRY.make(make_settings(kind=kind), recording.vehicle, PERIOD_S)
            figures[f"{name} {kind}, us"] = _time(algorithm, family.step, recording, blocks)
    return figures


def record(scenario: str, settings: Sequence[str], steps: int) -> Recording:
    """Return the first ticks of a scenario, as its flight software saw them."""
    bench = Bench(load_scenario(find_scenario(scenario), [*COMMON, *settings]))
    moments = []
    for _ in range(steps):
        commands, tau_cmd_b_nm = bench.flight.wheel_commands, bench.flight.tau_cmd_b_nm
        bench.step()
        moments.append(_note(bench.flight, commands, tau_cmd_b_nm))
    return Recording(bench.flight.vehicle, moments)


def _note(flight: Flight, commands: WheelCommands, tau_cmd_b_nm: Vec3) -> Moment:
    sensors, vehicle = copy_sensors(flight.inputs.sensors), flight.vehicle
    return Moment(
        sensors=sensors,
        estimate=flight.detection.estimate,
        meant_nm=commands.meant_nm,
        sent_nm=commands.tau_rw_nm,
        tau_cmd_b_nm=tau_cmd_b_nm,
        momentum_b_nms=vehicle.wheels.combine(sensors.wheel_momenta()),
        tau_fault_b_nm=flight.tau_fault_hat_b_nm,
        error=flight.error,
        health=flight.health,
        tau_b_nm=flight.tau_cmd_b_nm,
    )


def copy_sensors(sensors: Sensors) -> Sensors:
    """Return a copy that stays as it is when the flight goes on: it writes into the one record of its own."""
    copy = Sensors(**(sensors.values() | {"wheels": None, "powers": None}))
    copy.wheels = tuple(WheelReading(**wheel.values()) for wheel in sensors.wheels)  # type: ignore[assignment]
    for power, like in zip(copy.powers, sensors.powers, strict=True):
        for key, value in like.values().items():
            setattr(power, key, value)
    return copy


def _time(algorithm: Any, step: Step, recording: Recording, blocks: int) -> float:
    """Return the median over the blocks of the CPU time of a step [us]; every block begins anew."""
    spent = []
    for _ in range(blocks):
        algorithm.reset()
        started = time.thread_time_ns()
        for moment in recording.moments:
            step(algorithm, moment)
        spent.append(time.thread_time_ns() - started)
    return sorted(spent)[blocks // 2] / len(recording.moments) / 1e3


def _estimate(estimator: Any, moment: Moment) -> Any:
    return estimator.step(moment.sensors)


def _detect(detector: Any, moment: Moment) -> Any:
    return detector.step(moment.sensors, moment.estimate, moment.meant_nm)


def _observe(observer: Any, moment: Moment) -> Any:
    return observer.step(PERIOD_S, moment.estimate.omega_bi_b_rad_s, moment.tau_cmd_b_nm, moment.momentum_b_nms)


def _judge(monitor: Any, moment: Moment) -> Any:
    monitor.note_sent(moment.sent_nm)
    return monitor.step(PERIOD_S, moment.sensors.wheels, moment.meant_nm, moment.tau_fault_b_nm)


def _control(controller: Any, moment: Moment) -> Any:
    torque = controller.step(PERIOD_S, moment.error, moment.tau_fault_b_nm, moment.health)
    controller.note_sent(moment.tau_b_nm)
    return torque


def _allocate(allocator: Any, moment: Moment) -> Any:
    return allocator.allocate(moment.tau_b_nm, moment.health)


@dataclass(frozen=True, slots=True)
class Family:
    """A family of algorithms, how one of it is driven, and with what."""

    package: ModuleType
    step: Step
    flight: str


FAMILIES = {
    "estimation": Family(estimation, _estimate, TURN),
    "gyro_fdi": Family(gyro_fdi, _detect, TURN),
    "observers": Family(observers, _observe, TURN),
    "wheel_health": Family(wheel_health, _judge, HOLD),
    "controllers": Family(controllers, _control, TURN),
    "allocators": Family(allocators, _allocate, TURN),
}
