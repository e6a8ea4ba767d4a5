"""Slew cases with their clairvoyant optimum, and how a law flies through one of them on the bench.

A case is a start, four misaligned wheels and a fault schedule for the satellite of Zhang, Ye & Sun 2018; `optimum_s`
is the shortest time to rest at the target when every fault is known in advance (see braking_optimum.py). One file holds
the paper's scenario, four cases of another origin, and 128 drawn by `draw_case`, numbers 0 to 127; another sixty more,
drawn with FRESH_SEED.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bus.run import ClockConfig
from bus.units import DEG, Mat3, Vec3, Vec4
from fsw.allocators.settings import PseudoInverseConfig
from fsw.config import AllocatorConfig, ControllerConfig, FswConfig, ObserverConfig, WheelHealthConfig
from fsw.estimation.settings import DirectConfig
from fsw.observers.ilo import scale_gains
from fsw.observers.settings import IloConfig
from fsw.settings import ModelConfig, ModesConfig
from fsw.wheel_health.settings import NoWheelHealthConfig
from plant_server import faults as plant_faults
from plant_server.config import BodyConfig, GyroConfig, PlantConfig, StarTrackerConfig, WheelConfig
from plant_server.wheels.axes import Mount, true_axis
from tools.config.scenario import Resolved, Scenario
from tools.run.bench import Bench

CASES_FILE = Path(__file__).with_name("braking_cases.json")
FRESH_FILE = Path(__file__).with_name("braking_cases_fresh.json")
FRESH_SEED = 20264
INERTIA_KGM2: Mat3 = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))
WHEEL_TORQUE_NM, ROTOR_KGM2 = 0.1, 0.01
BOUNDS_DEG = (5.0, 1.0, 0.1)
QUIET_S = 15.0  # settled: the error has stayed below the bound this long and to the end of the run
UNTIL_S = 300.0
NEVER = 1e6  # deg/s, s: the laws are judged, so no mode but pointing is ever entered
_MOUNTS: tuple[Mount, Mount, Mount, Mount] = ("x", "y", "z", "skew")
ILO = IloConfig(kind="ilo")
NO_HEALTH = NoWheelHealthConfig(kind="none")
PSEUDO_INVERSE = PseudoInverseConfig(kind="pseudo_inverse")
_PLANT_KINDS = {"loss": "loss", "stuck": "stuck_torque", "dead": "dead"}


@dataclass(frozen=True, slots=True)
class Fault:
    """One wheel fault: `loss` scales the command, `stuck` replaces it by torque_nm, `dead` by nothing."""

    wheel: int  # 1..4
    kind: str
    from_s: float
    until_s: float = math.inf
    effectiveness: float = 1.0
    torque_nm: float = 0.0


@dataclass(frozen=True, slots=True)
class Case:
    """A start, four wheels and their faults."""

    id: str
    q0: Vec4
    omega0_rad_s: Vec3
    tilt_deg: Vec4
    clock_deg: Vec4
    faults: tuple[Fault, ...]
    optimum_s: float = math.nan


@dataclass(frozen=True, slots=True)
class Conditions:
    """How far a run is from the ideal, how large the satellite is, and how long it is watched."""

    tick_hz: int = 10  # of sensors, control and commands
    step_s: float = 0.05  # of the plant
    delay_ticks: int = 0  # of the commands
    gyro_sigma_rad_s: float = 0.0  # white noise of a sample
    momentum: bool = False  # of the wheels, in plant and model
    scale: float = 1.0  # of inertia, torque and everything in their units
    until_s: float = UNTIL_S


@dataclass(frozen=True, slots=True, kw_only=True)
class Law:
    """The flight algorithms that close the loop. An ILO's gains are scaled to the control period."""

    controller: ControllerConfig
    observer: ObserverConfig = ILO
    wheel_health: WheelHealthConfig = NO_HEALTH
    allocator: AllocatorConfig = PSEUDO_INVERSE


def fly(case: Case, law: Law, conditions: Conditions) -> dict[float, float | None]:
    """Return, for each bound of BOUNDS_DEG, the last time at which the error exceeds it [s]; None: not settled.

    Not settled is what exceeds the bound within QUIET_S of the end of the run, conditions.until_s.
    """
    bench = Bench(Resolved.of(make_scenario(case, law, conditions)))
    last = dict.fromkeys(BOUNDS_DEG, 0.0)
    tightest = min(BOUNDS_DEG)
    while bench.tick < bench.ticks:
        bench.step()
        error_deg, t_s = bench.truth.error_deg, bench.t_s
        for bound in BOUNDS_DEG:
            if error_deg > bound:
                last[bound] = t_s
        if t_s - last[tightest] > QUIET_S:
            break
    return {bound: time_s if bench.t_s - time_s >= QUIET_S else None for bound, time_s in last.items()}


def make_scenario(case: Case, law: Law, conditions: Conditions) -> Scenario:
    """Return the flight of a law through a case as a scenario: ideal star tracker, no estimator in between."""
    scale = conditions.scale
    tick_s = 1.0 / conditions.tick_hz
    inertia: Mat3 = tuple(tuple(scale * v for v in row) for row in INERTIA_KGM2)  # type: ignore[assignment]
    observer = law.observer
    if isinstance(observer, IloConfig):
        observer = scale_gains(observer, tick_s)
        observer = replace(
            observer, k2=scale * observer.k2, k3=scale * observer.k3, lambda_nm_s=scale * observer.lambda_nm_s
        )
    model = ModelConfig(
        inertia_kgm2=inertia, wheel_max_torque_nm=scale * WHEEL_TORQUE_NM, wheel_inertia_kgm2=scale * ROTOR_KGM2,
        wheel_momentum=conditions.momentum,
    )  # fmt: skip
    return Scenario(
        name=case.id,
        seed=sum(case.id.encode()),
        duration_s=conditions.until_s,
        clock=ClockConfig(mode="inprocess", tick_hz=conditions.tick_hz),
        plant=_make_plant(case, conditions, inertia),
        faults=tuple(_make_fault(fault, scale) for fault in case.faults),
        fsw=FswConfig(
            model=model,
            estimator=DirectConfig(kind="direct"),
            observer=observer,
            wheel_health=law.wheel_health,
            controller=law.controller,
            allocator=law.allocator,
            modes=ModesConfig(detumble_above_deg_s=NEVER, star_stale_after_s=NEVER),
        ),
    )


def _make_plant(case: Case, conditions: Conditions, inertia: Mat3) -> PlantConfig:
    scale = conditions.scale
    x, y, z = case.omega0_rad_s
    a, b, c, d = (
        WheelConfig(
            mount=mount, tilt_deg=tilt, clock_deg=clock,
            inertia_kgm2=scale * ROTOR_KGM2, max_torque_nm=scale * WHEEL_TORQUE_NM,
        )
        for mount, tilt, clock in zip(_MOUNTS, case.tilt_deg, case.clock_deg, strict=True)
    )  # fmt: skip
    white = conditions.gyro_sigma_rad_s * math.sqrt(1.0 / conditions.tick_hz)
    return PlantConfig(
        step_s=conditions.step_s,
        body=BodyConfig(
            inertia_kgm2=inertia, attitude_q=case.q0, rate_deg_s=(x / DEG, y / DEG, z / DEG),
            wheel_gyroscopic=conditions.momentum,
        ),
        wheels=(a, b, c, d),
        gyro=GyroConfig(preset="ideal", arw_rad_sqrt_s=white),
        star_tracker=StarTrackerConfig(rate_hz=float(conditions.tick_hz)),
        command_latency_ticks=conditions.delay_ticks,
    )  # fmt: skip


def _make_fault(fault: Fault, scale: float) -> plant_faults.Fault:
    """Return a fault of a case as the plant knows it."""
    return plant_faults.make_fault(
        unit=f"wheel.{fault.wheel}",
        kind=_PLANT_KINDS[fault.kind],
        at_s=fault.from_s,
        until_s=fault.until_s if math.isfinite(fault.until_s) else None,
        effectiveness=fault.effectiveness if fault.kind == "loss" else None,
        torque_nm=scale * fault.torque_nm if fault.kind == "stuck" else None,
    )


def read_cases(path: Path = CASES_FILE) -> list[Case]:
    """Return the cases of a file."""
    return [parse_case(entry) for entry in json.loads(path.read_text())]


def make_healthy(case: Case) -> Case:
    """Return a case's start with wheels that are aligned and never fail, without optimum."""
    none = (0.0, 0.0, 0.0, 0.0)
    return replace(case, id="healthy", tilt_deg=none, clock_deg=none, faults=(), optimum_s=math.nan)


def parse_case(entry: dict[str, Any]) -> Case:
    """Return one case from its JSON object."""
    faults = tuple(Fault(**fault) for fault in entry["faults"])
    fields = {name: tuple(entry[name]) for name in ("q0", "omega0_rad_s", "tilt_deg", "clock_deg")}
    return Case(id=entry["id"], faults=faults, optimum_s=entry["optimum_s"], **fields)


def draw_case(number: int, seed: int = 20181) -> Case:
    """Return a random case without optimum: 50..130 deg about any axis, up to 0.5 deg/s, tilts to 10 deg, 1..3 faults.

    A fault starts at 5..30 s; 40 % are losses to 0.3..0.8 (a third of them end), 40 % stuck at up to 0.02 N m for
    10..25 s, 20 % dead, at most one of these in a case.
    """
    r = np.random.default_rng([seed, number])
    half = math.radians(r.uniform(50.0, 130.0)) / 2.0
    axis = r.normal(size=3)
    axis /= np.linalg.norm(axis)
    q0 = (math.cos(half), *(math.sin(half) * axis).tolist())
    omega0 = tuple(np.radians(r.uniform(-0.5, 0.5, 3)).tolist())
    tilt = tuple(r.uniform(0.0, 10.0, 4).tolist())
    clock = (*r.uniform(-180.0, 180.0, 3).tolist(), float(r.uniform(-10.0, 10.0)))
    count = int(r.integers(1, 4))
    faults: list[Fault] = []
    for wheel in (r.permutation(4)[:count] + 1).tolist():
        kind = str(r.choice(["loss", "stuck", "dead"], p=[0.4, 0.4, 0.2]))
        if kind == "dead" and any(fault.kind == "dead" for fault in faults):
            kind = "loss"
        faults.append(_draw_fault(r, wheel, kind))
    return Case(f"random-{number:02d}", q0, omega0, tilt, clock, tuple(faults))


def _draw_fault(r: np.random.Generator, wheel: int, kind: str) -> Fault:
    start = round(float(r.uniform(5.0, 30.0)), 1)
    if kind == "dead":
        return Fault(wheel, kind, start)
    if kind == "loss":
        share = round(float(r.uniform(0.3, 0.8)), 2)
        ends = r.random() < 0.3
        return Fault(wheel, kind, start, round(start + float(r.uniform(10.0, 40.0)), 1) if ends else math.inf, share)
    torque = round(float(r.uniform(-0.02, 0.02)), 4)
    return Fault(wheel, kind, start, round(start + float(r.uniform(10.0, 25.0)), 1), torque_nm=torque)


def find_axes(case: Case) -> tuple[Vec4, Vec4, Vec4]:
    """Return D, shape (3, 4), columns the true spin axes in body axes."""
    a, b, c, d = (
        true_axis(mount, tilt, clock) for mount, tilt, clock in zip(_MOUNTS, case.tilt_deg, case.clock_deg, strict=True)
    )
    return ((a[0], b[0], c[0], d[0]), (a[1], b[1], c[1], d[1]), (a[2], b[2], c[2], d[2]))
