"""Is a fuzzy PID better than a PID? Nine ways of flying the same random faults: docs/fuzzy-pid.md, section 5.

    python -P -m tools.design.fuzzy_study [--runs 200] [--seed 1] [--rows NAME ...] [--jobs 1] [--json]

The flight software's own laws, allocator, wheel filters and drive, around a plant of the spec of paper 003 (section 2.2)
that is small enough for thousands of flights: three ITHACO Type-A wheels on the body axes, no limiters (they bite beyond 600
rad/s; no flight comes near), no ripple. The draws of run k are the same for every row and depend on the seed and k alone.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import random
import statistics
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from bus.linear import ZERO3
from bus.units import Vec3, Vec4
from fsw import allocators, controllers, wheel_health
from fsw.drive import REST, Drive
from fsw.records import PointingError, four_readings, without
from fsw.settings import DriveConfig, ModelConfig, WheelModelConfig, WheelMotorConfig
from fsw.vehicle import Vehicle
from tools.design.fuzzy_plant import DRIVER_GAIN, ROTOR_KGM2, TORQUE_CONSTANT, Draw, FuzzyPlant

PERIOD_S = 0.1
UNTIL_S = 400.0
FINAL_S = 50.0  # the final error is the largest mean over this long at the end
INERTIA_KGM2: Vec3 = (12.49, 13.85, 15.75)
LIMIT_NM = 0.0275
COMMAND_V = 5.0
ANGLE_NOISE_RAD, RATE_NOISE_RAD_S = 2e-5, 1e-5
CURRENT_NOISE_A, SPEED_NOISE_RAD_S = 1e-3, 0.05  # of the wheels' telemetry

MEAN_GAINS = {"kind": "rate_pid", "kp": (50.7,) * 3, "ki": (3.5,) * 3, "kd": (5.0,) * 3}
FUZZY_B = {"kind": "fuzzy_pid", "base": "engineering"}
NOMINAL, ESTIMATED = {"friction": "nominal"}, {"friction": "nominal", "gain": "estimated"}
# The filters only estimate here: `isolate` would switch wheels off, and with three of them there is none to spare.
FILTER = {"kind": "wheel_kalman", "reaction": "compensate"}
NO_FILTER = {"kind": "none"}
# name -> law, drive, wheel health
ROWS: dict[str, tuple[dict[str, Any], dict[str, Any], dict[str, Any]]] = {
    "paper PID": ({"kind": "rate_pid"}, {}, NO_FILTER),
    "paper fuzzy": ({"kind": "fuzzy_pid"}, {}, NO_FILTER),
    "fixed mean gains": (MEAN_GAINS, {}, NO_FILTER),
    "tuned PID": ({"kind": "pid"}, {}, NO_FILTER),
    "canonical fuzzy on tuned": (FUZZY_B, {}, NO_FILTER),
    "even fuzzy on tuned": ({**FUZZY_B, "tables": "even"}, {}, NO_FILTER),
    "tuned + drag": ({"kind": "pid", "integral_rad_s": 0.01}, NOMINAL, NO_FILTER),
    "tuned + drag + filter": ({"kind": "pid", "integral_rad_s": 0.01}, ESTIMATED, FILTER),
    "even fuzzy + drag + filter": (
        {**FUZZY_B, "tables": "even", "integral_rad_s": 0.01}, ESTIMATED, FILTER,
    ),
}  # fmt: skip


@dataclass(slots=True)
class Flown:
    """What one flight is judged by."""

    overshoot_pct: float  # past the target before the fault, of the axis' own way, the worst axis
    overshoot_of_largest_pct: float  # the same, of the largest way of the three
    post_fault_mrad: float  # largest angle of an axis from the fault on
    final_mrad: float  # largest mean magnitude of an axis over the last FINAL_S
    square_n2m2s: float  # integral of the torques squared that the currents are worth: what the windings heat
    variation_nm: float  # sum of the steps of the body torque commanded, mean of the axes
    thetas: list[Vec3] = field(default_factory=list)  # every period, where kept


def make_vehicle() -> Vehicle:
    """The satellite as the flight software knows it: nominal inertia, three wheels, the fourth not fitted."""
    axes: tuple[Vec3, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0))
    a, b, c, d = (
        WheelModelConfig(
            axis_b=axis,
            max_torque_nm=LIMIT_NM,
            inertia_kgm2=ROTOR_KGM2,
            motor=WheelMotorConfig(preset="ithaco_a"),
            fitted=number < 3,
        )
        for number, axis in enumerate(axes)
    )
    x, y, z = INERTIA_KGM2
    inertia = ((x, 0.0, 0.0), (0.0, y, 0.0), (0.0, 0.0, z))
    return Vehicle(ModelConfig(inertia_kgm2=inertia, wheels=(a, b, c, d), wheel_momentum=False))


def draw_run(seed: int, run: int) -> Draw:
    """The flight of this number: attitude, rates, faults, inertia, disturbance."""
    rng = random.Random(seed * 1_000_003 + run)

    def three(low: float, high: float) -> Vec3:
        return (rng.uniform(low, high), rng.uniform(low, high), rng.uniform(low, high))

    x, y, z = INERTIA_KGM2
    theta, omega, speeds = three(-0.04, 0.04), three(-0.003, 0.003), three(-150.0, 150.0)
    gain, (fx, fy, fz) = three(0.3, 1.0), three(0.8, 1.2)
    return Draw(
        theta_rad=theta,
        omega_rad_s=omega,
        speeds_rad_s=speeds,
        gain=gain,
        onset_s=rng.uniform(50.0, 150.0),
        ramp_s=rng.choice((0.0, rng.uniform(10.0, 100.0))),
        inertia_kgm2=(x * fx, y * fy, z * fz),
        disturbance_nm=10.0 ** rng.uniform(-6.0, math.log10(5e-5)),
    )


def fly(
    row: str, draw: Draw, noise_seed: int, keep: bool = False, noisy: bool = True, until_s: float = UNTIL_S
) -> Flown:
    """One flight, in the order of fsw/flight.py: judge the wheels, control, allocate, drive."""
    law, drive_settings, filters = ROWS[row]
    vehicle = make_vehicle()
    law_settings = controllers.REGISTRY.kinds[law["kind"]][0](**law)
    controller = controllers.REGISTRY.make(law_settings, vehicle, PERIOD_S)
    allocator_settings = allocators.REGISTRY.kinds["pseudo_inverse"][0](kind="pseudo_inverse")
    allocator = allocators.REGISTRY.make(allocator_settings, vehicle, PERIOD_S)
    monitor_settings = wheel_health.REGISTRY.kinds[filters["kind"]][0](**filters)
    monitor = wheel_health.REGISTRY.make(monitor_settings, vehicle, PERIOD_S)
    drive = Drive(DriveConfig(**drive_settings), vehicle)
    plant = FuzzyPlant(draw)
    noise = random.Random(noise_seed)
    size = 1.0 if noisy else 0.0
    readings, commands, before = four_readings(), REST, ZERO3
    scorer = _Scorer(draw, until_s)
    thetas: list[Vec3] = []
    for k in range(round(until_s / PERIOD_S)):
        t_s = k * PERIOD_S
        theta = plant.find_theta()
        scorer.see(t_s, theta)
        if keep:
            thetas.append(theta)
        error = _measure_attitude(plant, noise, size)
        _measure_wheels(plant, noise, size, readings)
        if drive.compensates:
            monitor.note_sent(commands.tau_rw_nm)
        health = drive.see(without(monitor.step(PERIOD_S, readings, commands.meant_nm, ZERO3), vehicle.fitted))
        torque = controller.step(PERIOD_S, error, ZERO3, health)
        commands = drive.command(allocator.allocate(torque, health).tau_rw_nm, health, readings)
        if k:
            scorer.variation += sum(abs(a - b) for a, b in zip(torque, before, strict=True)) / 3.0
        before = torque
        plant.advance(PERIOD_S, t_s, _drive_motors(commands.tau_rw_nm))
    scorer.see(until_s, plant.find_theta())
    return scorer.judge(plant.square_n2m2s, thetas)


def _measure_attitude(plant: FuzzyPlant, noise: random.Random, size: float) -> PointingError:
    q0, qx, qy, qz = plant.q
    wx, wy, wz = plant.omega
    gauss = noise.gauss
    angle, rate = 0.5 * ANGLE_NOISE_RAD * size, RATE_NOISE_RAD_S * size
    q: Vec4 = (q0, qx + gauss(0.0, angle), qy + gauss(0.0, angle), qz + gauss(0.0, angle))
    return PointingError(q, (wx + gauss(0.0, rate), wy + gauss(0.0, rate), wz + gauss(0.0, rate)))


def _measure_wheels(plant: FuzzyPlant, noise: random.Random, size: float, readings: Any) -> None:
    for reading, speed, current in zip(readings[:3], plant.find_speeds(), plant.current, strict=True):
        reading.speed_rad_s = speed + noise.gauss(0.0, SPEED_NOISE_RAD_S * size)
        reading.current_a = -current - noise.gauss(0.0, CURRENT_NOISE_A * size)  # signed as the torque on the body
        reading.h_nms = ROTOR_KGM2 * reading.speed_rad_s


def _drive_motors(tau_rw_nm: Vec4) -> Vec3:
    """Command voltages: the rotor gets the opposite of the torque on the body."""
    per_nm = -1.0 / (DRIVER_GAIN * TORQUE_CONSTANT)
    a, b, c = (max(-COMMAND_V, min(COMMAND_V, per_nm * torque)) for torque in tau_rw_nm[:3])
    return (a, b, c)


class _Scorer:
    """Judges a flight while it is flown."""

    def __init__(self, draw: Draw, until_s: float) -> None:
        self._start = draw.theta_rad
        self._onset_s = draw.onset_s
        self._final_from_s = until_s - FINAL_S
        self._past = [0.0, 0.0, 0.0]
        self._worst = 0.0
        self._sums = [0.0, 0.0, 0.0]
        self._count = 0
        self.variation = 0.0

    def see(self, t_s: float, theta: Vec3) -> None:
        """One sample of the true angles."""
        if t_s < self._onset_s:
            for i in (0, 1, 2):
                self._past[i] = max(self._past[i], -theta[i] if self._start[i] > 0.0 else theta[i])
        else:
            self._worst = max(self._worst, abs(theta[0]), abs(theta[1]), abs(theta[2]))
        if t_s >= self._final_from_s:
            self._count += 1
            for i in (0, 1, 2):
                self._sums[i] += abs(theta[i])

    def judge(self, square_n2m2s: float, thetas: list[Vec3]) -> Flown:
        """The figures of the flight."""
        own = max(past / abs(start) for past, start in zip(self._past, self._start, strict=True))
        largest = max(self._past) / max(map(abs, self._start))
        final = max(self._sums) / max(1, self._count)
        return Flown(100.0 * own, 100.0 * largest, 1e3 * self._worst, 1e3 * final, square_n2m2s, self.variation, thetas)


# -- the table -----------------------------------------------------------------------------------------------------


def summarise(flown: Sequence[Flown]) -> dict[str, float]:
    """Medians and 90th percentiles of a row."""

    def both(key: str, name: str) -> dict[str, float]:
        values = sorted(getattr(run, key) for run in flown)
        return {f"{name}_p50": statistics.median(values), f"{name}_p90": values[math.ceil(0.9 * len(values)) - 1]}

    return {
        **both("overshoot_pct", "overshoot_pct"),
        **both("overshoot_of_largest_pct", "overshoot_of_largest_pct"),
        **both("post_fault_mrad", "post_fault_mrad"),
        **both("final_mrad", "final_mrad"),
        "below_1_mrad_pct": 100.0 * sum(run.final_mrad < 1.0 for run in flown) / len(flown),
        "square_1e3": 1e3 * statistics.median(run.square_n2m2s for run in flown),
        "variation_nm": statistics.median(run.variation_nm for run in flown),
    }


def format_table(rows: dict[str, dict[str, float]]) -> str:
    """The rows as docs/fuzzy-pid.md has them."""
    lines = [
        "| | overshoot %, p50 / p90 | after fault, mrad | at the end, mrad | < 1 mrad | torque squared, 1e-3 | variation |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {name} | {f['overshoot_of_largest_pct_p50']:.1f} / {f['overshoot_of_largest_pct_p90']:.1f} "
        f"| {f['post_fault_mrad_p50']:.2f} / {f['post_fault_mrad_p90']:.2f} "
        f"| {f['final_mrad_p50']:.3f} / {f['final_mrad_p90']:.3f} | {f['below_1_mrad_pct']:.0f} % "
        f"| {f['square_1e3']:.1f} | {f['variation_nm']:.2f} |"
        for name, f in rows.items()
    ]
    return "\n".join(lines)


def _fly_one(job: tuple[str, int, int]) -> Flown:
    row, seed, run = job
    return fly(row, draw_run(seed, run), noise_seed=seed * 2_000_003 + run)


def main(arguments: Sequence[str] | None = None) -> None:
    """Fly all rows; the table or one JSON object goes to stdout, progress to stderr."""
    parser = argparse.ArgumentParser(prog="fuzzy_study", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rows", nargs="*", choices=list(ROWS), default=list(ROWS))
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    rows = {}
    with multiprocessing.Pool(args.jobs) as pool:
        for row in args.rows:
            flown = pool.map(_fly_one, [(row, args.seed, run) for run in range(args.runs)], chunksize=1)
            rows[row] = summarise(flown)
            print(f"{row}: {args.runs} flights", file=sys.stderr, flush=True)
    print(json.dumps({"runs": args.runs, "seed": args.seed, "rows": rows}) if args.json else format_table(rows))


if __name__ == "__main__":
    main()
