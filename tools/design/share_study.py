"""How well `wheel_health: share_kalman` finds the share of a wheel that breaks, on drawn data.

    python -P -m tools.design.share_study [--sets 20] [--first-seed 1]

Each set is 120 s of four wheels at 10 Hz, whose commands are a slow sine and white noise. Each wheel breaks once, between
40 and 60 s, to a share drawn from 0, 0.2, 0.4, 0.6 and 0.8; half of those that give nothing hold 15 mN m of their own.
Speeds are read in whole steps.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass

import numpy as np

from bus.units import Vec4
from fsw.records import FourReadings, WheelReading
from fsw.settings import ModelConfig
from fsw.vehicle import Vehicle
from fsw.wheel_health.settings import ShareKalmanConfig
from fsw.wheel_health.share_kalman import ShareKalman

PERIOD_S = 0.1
LENGTH_S = 120.0
ROTOR_KGM2 = 0.01
MOST_NM = 0.1
STUCK_NM = 0.015
SETTLED_S = 20.0  # after the fault: errors are counted from then on
SHARES = (0.0, 0.2, 0.4, 0.6, 0.8)
PAPER_STEP_RAD_S = 0.1  # speed telemetry of the reference data
FRAME_STEP_RAD_S = 1e-3  # of the bench's frames


@dataclass(frozen=True, slots=True)
class Record:
    """Four wheels: what they were told [N m], their momentum after it [N m s], the true share, and when it changed [s]."""

    told_nm: np.ndarray  # (n, 4), over the interval that ends with the sample
    h_nms: np.ndarray  # (n, 4)
    share: np.ndarray  # (n, 4)
    broken_at_s: np.ndarray  # (4,)


@dataclass(frozen=True, slots=True)
class Finding:
    """How one fault was found."""

    rms_share: float  # error of the share, from 20 s after the fault on [1]
    delay_s: float  # until the share is half-way; infinite: never
    false_alarms: int  # intervals with an alarm before the fault


def draw_record(seed: int, step_rad_s: float) -> Record:
    """Return the set of a seed; amplitudes of 10 to 50 mN m, periods of 20 to 60 s, white noise of half the amplitude."""
    random = np.random.default_rng(seed)
    count = round(LENGTH_S / PERIOD_S)
    t_s = PERIOD_S * np.arange(count)
    amplitude = random.uniform(0.01, 0.05, 4)
    turn = 2.0 * np.pi * (t_s[:, None] / random.uniform(20.0, 60.0, 4) + random.uniform(0.0, 1.0, 4))
    told = np.clip(amplitude * (np.sin(turn) + 0.5 * random.standard_normal((count, 4))), -MOST_NM, MOST_NM)
    broken_at = random.uniform(40.0, 60.0, 4)
    left = random.choice(SHARES, 4)
    held = np.where(left == 0.0, STUCK_NM * random.integers(0, 2, 4), 0.0)
    broken = t_s[:, None] >= broken_at
    share = np.where(broken, left, 1.0)
    given = share * told + np.where(broken, held, 0.0)
    speed = random.uniform(-50.0, 50.0, 4) - np.cumsum(given, axis=0) * PERIOD_S / ROTOR_KGM2
    return Record(told, ROTOR_KGM2 * step_rad_s * np.round(speed / step_rad_s), share, broken_at)


def make_monitor(config: ShareKalmanConfig) -> ShareKalman:
    """Return the stage on the vehicle that the records are of."""
    inertia = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))
    return ShareKalman(config, Vehicle(ModelConfig(inertia_kgm2=inertia, wheel_max_torque_nm=MOST_NM)), PERIOD_S)


def read_wheels(h_nms: Vec4) -> FourReadings:
    """Return readings of these momenta."""
    a, b, c, d = (WheelReading(h / ROTOR_KGM2, 0.0, 0, True, h) for h in h_nms)
    return (a, b, c, d)


def follow(monitor: ShareKalman, told_nm: np.ndarray, h_nms: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Run the stage along; return shares (n, 4), biases (n, 4) [N m] and alarms (n, 4) as it has them after each sample."""
    shares, biases, alarms = [], [], []
    for told, h in zip(told_nm.tolist(), h_nms.tolist(), strict=True):
        health = monitor.step(PERIOD_S, read_wheels(tuple(h)), tuple(told), None)
        inside = monitor.internals
        shares.append(inside.share)
        biases.append(inside.bias_nm)
        alarms.append(health.alarm)
    return np.array(shares), np.array(biases), np.array(alarms)


def judge_record(record: Record, config: ShareKalmanConfig) -> list[Finding]:
    """Return how each of the four faults was found."""
    shares, _, alarms = follow(make_monitor(config), record.told_nm, record.h_nms)
    t_s = PERIOD_S * np.arange(len(shares))
    found = []
    for wheel, at_s in enumerate(record.broken_at_s):
        settled = t_s >= at_s + SETTLED_S
        error = (np.minimum(shares, 1.0) - record.share)[settled, wheel]
        half = 0.5 * (1.0 + record.share[-1, wheel])
        late = t_s[(t_s >= at_s) & (shares[:, wheel] <= half)]
        found.append(
            Finding(
                math.sqrt(float(np.mean(error**2))),
                float(late[0] - at_s) if len(late) else math.inf,
                int(alarms[t_s < at_s, wheel].sum()),
            )
        )
    return found


def tune_to(step_rad_s: float) -> ShareKalmanConfig:
    """Return the settings for a step of the speed: the steps are all the noise of the paper's, the defaults else."""
    if step_rad_s < PAPER_STEP_RAD_S:
        return ShareKalmanConfig(kind="share_kalman", speed_quantum_rad_s=step_rad_s)
    return ShareKalmanConfig(kind="share_kalman", speed_quantum_rad_s=step_rad_s, torque_noise_nm=0.0)


def study(step_rad_s: float, sets: int, first_seed: int = 1) -> list[Finding]:
    """Return the findings of so many sets, four faults each."""
    config = tune_to(step_rad_s)
    return [
        finding
        for seed in range(first_seed, first_seed + sets)
        for finding in judge_record(draw_record(seed, step_rad_s), config)
    ]


def time_steps(batches: int = 20) -> float:
    """Return the wall time of a step, smallest of so many batches of one set [us]."""
    record = draw_record(1, FRAME_STEP_RAD_S)
    monitor = make_monitor(tune_to(FRAME_STEP_RAD_S))
    steps = [
        (read_wheels(tuple(h)), tuple(told))
        for told, h in zip(record.told_nm.tolist(), record.h_nms.tolist(), strict=True)
    ]
    best = math.inf
    for _ in range(batches):
        monitor.reset()
        begun = time.perf_counter()
        for wheels, told in steps:
            monitor.step(PERIOD_S, wheels, told, (0.0, 0.0, 1e-3))
        best = min(best, time.perf_counter() - begun)
    return 1e6 * best / len(steps)


def main() -> None:
    """Print the figures of docs/wheel-health.md."""
    parser = argparse.ArgumentParser(description="share_kalman on drawn data")
    parser.add_argument("--sets", type=int, default=20, help="sets of four faults (default: 20)")
    parser.add_argument("--first-seed", type=int, default=1, help="seed of the first (default: 1)")
    wanted = parser.parse_args()
    for step_rad_s in (PAPER_STEP_RAD_S, FRAME_STEP_RAD_S):
        found = study(step_rad_s, wanted.sets, wanted.first_seed)
        rms = np.array([one.rms_share for one in found])
        delay = np.array([one.delay_s for one in found])
        wrong = sum(one.false_alarms > 0 for one in found)
        print(f"speed in steps of {step_rad_s:g} rad/s, {len(found)} faults")
        print(f"  rms share: median {np.median(rms):.4f}  p90 {np.quantile(rms, 0.9):.4f}  max {rms.max():.4f}")
        late = np.quantile(delay, (0.5, 0.9), method="higher")
        print(f"  delay to half-way [s]: median {late[0]:.2f}  p90 {late[1]:.2f}  max {delay.max():.2f}")
        print(f"  later than 10 s: {(delay > 10.0).sum()}  with a false alarm before: {wrong}")
    print(f"a step: {time_steps():.1f} us, smallest of 20 batches")


if __name__ == "__main__":
    main()
