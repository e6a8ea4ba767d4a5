"""Slew cases with their clairvoyant optimum, and a plant in plain floats that flies flight algorithms through them.

A case is a start, four misaligned wheels and a fault schedule for the satellite of Zhang, Ye & Sun 2018; `optimum_s`
is the shortest time to rest at the target when every fault is known in advance (see braking_optimum.py). The file holds
the paper's scenario, four cases of another origin, and 128 drawn by `draw_case`, numbers 0 to 127.
"""

from __future__ import annotations

import json
import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bus.units import DEG, Mat3, Vec3, Vec4
from fsw.records import Allocator, Controller, Observer
from fsw.wheel_geometry import combine_wheels

CASES_FILE = Path(__file__).with_name("braking_cases.json")
INERTIA_KGM2: Mat3 = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))
BOUNDS_DEG = (5.0, 1.0, 0.1)
QUIET_S = 15.0  # a run ends when the error has stayed below the smallest bound this long


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


def read_cases(path: Path = CASES_FILE) -> list[Case]:
    """Return the cases of a file."""
    return [parse_case(entry) for entry in json.loads(path.read_text())]


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
    """Return D, columns the true spin axes, of the paper's exact form with its misprint in d2 put right."""
    a, b = np.array(case.tilt_deg) * DEG, np.array(case.clock_deg) * DEG
    c, s = np.cos, np.sin
    lift, turn = math.asin(1.0 / math.sqrt(3.0)) + a[3], math.pi / 4.0 + b[3]
    columns = (
        (c(a[0]), s(a[0]) * c(b[0]), s(a[0]) * s(b[0])),
        (s(a[1]) * c(b[1]), c(a[1]), s(a[1]) * s(b[1])),
        (s(a[2]) * c(b[2]), s(a[2]) * s(b[2]), c(a[2])),
        (c(lift) * c(turn), c(lift) * s(turn), s(lift)),
    )
    rows = np.array(columns).T.tolist()
    return (tuple(rows[0]), tuple(rows[1]), tuple(rows[2]))


def apply_faults(faults: tuple[Fault, ...], t_s: float, command: Vec4) -> Vec4:
    """Return the wheel torques that act [N m]."""
    torque = list(command)
    for fault in faults:
        if fault.from_s <= t_s < fault.until_s:
            i = fault.wheel - 1
            torque[i] = {"loss": fault.effectiveness * torque[i], "stuck": fault.torque_nm, "dead": 0.0}[fault.kind]
    return (torque[0], torque[1], torque[2], torque[3])


State = tuple[float, ...]  # q0 qx qy qz, wx wy wz, and the wheels' momentum in body axes hx hy hz


@dataclass(frozen=True, slots=True)
class Plant:
    """J w' = -w x (J w + h) + u, h' = -u for momentum != 0, h = 0 for the paper's plant."""

    momentum: bool = False
    inverse: tuple[Vec3, Vec3, Vec3] = tuple(tuple(row) for row in np.linalg.inv(np.array(INERTIA_KGM2)).tolist())  # type: ignore[assignment]

    def slope(self, y: State, u: Vec3) -> State:
        """d/dt of the state under body torque u [N m]."""
        q0, q1, q2, q3, x, y_, z, mx, my, mz = y
        (a, b, c), (d, e, f), (g, h, i) = INERTIA_KGM2
        hx, hy, hz = a * x + b * y_ + c * z + mx, d * x + e * y_ + f * z + my, g * x + h * y_ + i * z + mz
        tx, ty, tz = u[0] - (y_ * hz - z * hy), u[1] - (z * hx - x * hz), u[2] - (x * hy - y_ * hx)
        (a, b, c), (d, e, f), (g, h, i) = self.inverse
        k = -1.0 if self.momentum else 0.0
        return (
            -0.5 * (q1 * x + q2 * y_ + q3 * z),
            0.5 * (q0 * x + q2 * z - q3 * y_),
            0.5 * (q0 * y_ + q3 * x - q1 * z),
            0.5 * (q0 * z + q1 * y_ - q2 * x),
            a * tx + b * ty + c * tz,
            d * tx + e * ty + f * tz,
            g * tx + h * ty + i * tz,
            k * u[0],
            k * u[1],
            k * u[2],
        )

    def advance(self, y: State, u: Vec3, dt_s: float) -> State:
        """One classical Runge-Kutta step under constant torque, attitude renormalised."""
        k1 = self.slope(y, u)
        k2 = self.slope(tuple(s + 0.5 * dt_s * k for s, k in zip(y, k1, strict=True)), u)
        k3 = self.slope(tuple(s + 0.5 * dt_s * k for s, k in zip(y, k2, strict=True)), u)
        k4 = self.slope(tuple(s + dt_s * k for s, k in zip(y, k3, strict=True)), u)
        new = [s + dt_s / 6.0 * (a + 2.0 * (b + c) + d) for s, a, b, c, d in zip(y, k1, k2, k3, k4, strict=True)]
        norm = math.sqrt(new[0] ** 2 + new[1] ** 2 + new[2] ** 2 + new[3] ** 2)
        return (new[0] / norm, new[1] / norm, new[2] / norm, new[3] / norm, *new[4:])


@dataclass(frozen=True, slots=True)
class Conditions:
    """How far a run is from the ideal: control period, plant step, sample delays, gyro noise, wheel momentum."""

    period_s: float = 0.1
    step_s: float = 0.05
    delay_periods: int = 0
    gyro_sigma_rad_s: float = 0.0
    momentum: bool = False
    until_s: float = 150.0


@dataclass(frozen=True, slots=True)
class Stack:
    """The three flight algorithms that close the loop."""

    observer: Observer
    controller: Controller
    allocator: Allocator


def fly(case: Case, make_stack: Callable[[Conditions], Stack], conditions: Conditions) -> dict[float, float]:
    """Return, for each bound of BOUNDS_DEG, the last time at which the error angle exceeds it [s]."""
    stack = make_stack(conditions)
    plant = Plant(conditions.momentum)
    axes = find_axes(case)
    noise = random.Random(case.id)
    scale = 1.0 / math.sqrt(sum(x * x for x in case.q0))
    y: State = (*(x * scale for x in case.q0), *case.omega0_rad_s, 0.0, 0.0, 0.0)
    command: Vec4 = (0.0, 0.0, 0.0, 0.0)
    queue = [command] * conditions.delay_periods
    last = dict.fromkeys(BOUNDS_DEG, 0.0)
    steps = round(conditions.period_s / conditions.step_s)
    for k in range(round(conditions.until_s / conditions.period_s)):
        t_s = k * conditions.period_s
        sigma = conditions.gyro_sigma_rad_s
        rate = (y[4] + noise.gauss(0.0, sigma), y[5] + noise.gauss(0.0, sigma), y[6] + noise.gauss(0.0, sigma))
        sign = 1.0 if y[0] >= 0.0 else -1.0
        q_err = (sign * y[0], sign * y[1], sign * y[2], sign * y[3])
        tau_fault = stack.observer.step(conditions.period_s, rate, combine_wheels(command), (y[7], y[8], y[9]))
        demand = stack.controller.step(conditions.period_s, q_err, rate, tau_fault)
        if demand.tau_rw_nm is None:
            command = stack.allocator.allocate(demand.tau_cmd_b_nm)
        else:
            command = stack.allocator.limit(demand.tau_rw_nm)
        queue.append(command)
        acting = queue.pop(0)
        for j in range(steps):
            a, b, c, d = apply_faults(case.faults, t_s + j * conditions.step_s + 1e-9, acting)
            u = tuple(row[0] * a + row[1] * b + row[2] * c + row[3] * d for row in axes)
            y = plant.advance(y, (u[0], u[1], u[2]), conditions.step_s)
            angle_deg = 2.0 * math.asin(min(1.0, math.sqrt(y[1] ** 2 + y[2] ** 2 + y[3] ** 2))) / DEG
            for bound in BOUNDS_DEG:
                if angle_deg > bound:
                    last[bound] = t_s + (j + 1) * conditions.step_s
        if t_s - last[BOUNDS_DEG[-1]] > QUIET_S:
            break
    return last
