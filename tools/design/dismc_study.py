"""Six sets of wheel faults under the discrete integral sliding mode, over frames: `python -P -m tools.design.dismc_study`.

Vehicle and start of Zhang, Ye & Sun 2018 at 10 Hz, noise of 1e-5 rad and 1e-5 rad/s a sample, and a disturbance of
2e-3 (1, -1, 0.5) N m with 1e-3 N m of a 100 s sine on top. Median over the seeds; steady error: the largest of the last
minute.
"""

from __future__ import annotations

import argparse

import numpy as np

from tools.run.bench import Bench

BOUNDS_DEG = (1.0, 0.1)
STRAIGHT = "[" + ", ".join(f"{{mount: {mount}, max_torque_nm: 0.1}}" for mount in ("x", "y", "z", "skew")) + "]"
PUBLISHED = [
    "{unit: wheel.1, kind: loss, effectiveness: 0.6, at_s: 30, until_s: 100}",
    "{unit: wheel.1, kind: loss, effectiveness: 0.4, at_s: 100}",
    "{unit: wheel.2, kind: loss, effectiveness: 0.5, at_s: 10, until_s: 50}",
    "{unit: wheel.3, kind: stuck_torque, torque_nm: 0.015, at_s: 20, until_s: 40}",
    "{unit: wheel.4, kind: dead, at_s: 30}",
]
MULTI = [
    "{unit: wheel.1, kind: loss, effectiveness: 0.4, at_s: 20}",
    "{unit: wheel.2, kind: loss, effectiveness: 0.5, at_s: 30}",
    "{unit: wheel.4, kind: dead, at_s: 40}",
]
DEAD = ["{unit: wheel.1, kind: dead, at_s: 20}"]
DEAD_AND_WEAK = [
    *DEAD,
    "{unit: wheel.2, kind: loss, effectiveness: 0.5, at_s: 30}",
    "{unit: wheel.3, kind: loss, effectiveness: 0.7, at_s: 30}",
]
CASES: dict[str, tuple[list[str], bool]] = {  # faults, and whether the wheels are misaligned
    "none": ([], False),
    "published": (PUBLISHED, False),
    "published, misaligned": (PUBLISHED, True),
    "X and Y weak, skew dead, misaligned": (MULTI, True),
    "X dead, misaligned": (DEAD, True),
    "X dead, Y and Z weak, misaligned": (DEAD_AND_WEAK, True),
}
CONDITIONS = [
    "expect=[]",
    "plant.gyro.arw_rad_sqrt_s=3.16e-6",
    "plant.star_tracker.noise_arcsec=[2.06, 2.06, 2.06]",
    "plant.torques=[{kind: constant, torque_nm: [2e-3, -2e-3, 1e-3]}, "
    "{kind: sinusoidal, amplitude_nm: [1e-3, 1e-3, 1e-3], period_s: 100, phase_deg: [0, 57.3, 114.6]}]",
]
DISMC = ["fsw.observer={kind: none}", "fsw.allocator={kind: direct}"]
LAWS: dict[str, list[str]] = {
    "dismc, share_kalman": [*DISMC, "fsw.controller={kind: dismc}", "fsw.wheel_health={kind: share_kalman}"],
    "dismc, no health": [*DISMC, "fsw.controller={kind: dismc}"],
    "dismc c = 0, share_kalman": [
        *DISMC, "fsw.controller={kind: dismc, c_1_s: 0}", "fsw.wheel_health={kind: share_kalman}",
    ],
    "smc and ilo, as published": [],
}  # fmt: skip


def fly(case: str, law: str, seed: int) -> tuple[float, float, float]:
    """Return the last times beyond 1 and 0.1 deg [s], and the steady error [deg]."""
    faults, misaligned = CASES[case]
    changes = [*CONDITIONS, *LAWS[law], f"seed={seed}", f"faults=[{', '.join(faults)}]"]
    if not misaligned:
        changes.append(f"plant.wheels={STRAIGHT}")
    errors = []
    with Bench.open("zhang2018", changes) as bench:
        while bench.tick < bench.ticks:
            errors.append(bench.step().truth.error_deg)
        tick_s = bench.tick_s
    error = np.array(errors)
    late = [tick_s * (np.flatnonzero(error > bound)[-1] + 1) for bound in BOUNDS_DEG]
    return float(late[0]), float(late[1]), float(error[-round(60.0 / tick_s) :].max())


def main() -> None:
    """Print the table: 1 deg / 0.1 deg [s] / steady error [deg]; a time of the whole run is never."""
    parser = argparse.ArgumentParser(description="six sets of wheel faults under the discrete integral sliding mode")
    parser.add_argument("--seeds", type=int, default=3)
    seeds = parser.parse_args().seeds
    print("| faults | " + " | ".join(LAWS) + " |")
    print("|---" * (1 + len(LAWS)) + "|")
    for case in CASES:
        cells = []
        for law in LAWS:
            one, tenth, steady = np.median([fly(case, law, seed + 1) for seed in range(seeds)], axis=0)
            words = [f"{value:.1f}" if value < 299.0 else "never" for value in (one, tenth)]
            cells.append(f"{words[0]} / {words[1]} s / {steady:.1e}")
        print(f"| {case} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
