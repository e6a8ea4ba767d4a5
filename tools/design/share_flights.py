"""Flights through the published faults under each way to learn what the wheels give.

python -P -m tools.design.share_flights [--scenario zhang2018] [--seeds 1]
"""

from __future__ import annotations

import argparse

import numpy as np

from tools.run.bench import Bench

MONITORS = (
    "{kind: none}",
    "{kind: share_learner}",
    "{kind: share_kalman}",
    "{kind: share_kalman, dead_below: 0}",
    "{kind: share_kalman, probe_nm: 0}",
)
LAWS = ("smc", "braking_profile")
BOUNDS_DEG = (1.0, 0.1)
LATE = {"zhang2018-flight": ", command_latency_s: 0.01}"}  # what the scenario's wheels need to have their commands
PERIOD_S = 0.1  # of the control in both scenarios


def fly(scenario: str, law: str, monitor: str, seed: int) -> tuple[float, float, float, float]:
    """Return when the error last exceeds 1 and 0.1 deg [s], its largest in the last minute, and the integral of u^2."""
    if "share_kalman" in monitor and scenario in LATE:
        monitor = monitor[:-1] + LATE[scenario]
    changes = ["expect=[]", f"seed={seed}", f"fsw.controller={{kind: {law}}}", f"fsw.wheel_health={monitor}"]
    with Bench.open(scenario, changes, log="memory") as bench:
        bench.step(bench.ticks)
        error = bench.log.signals("/truth/attitude")["error_deg"]
        t_s = bench.log.t_ns("/truth/attitude") * 1e-9
        told = bench.log.signals("/fsw/control")["tau_rw_cmd_nm"]
    late = [float(t_s[error > bound][-1]) for bound in BOUNDS_DEG]
    return late[0], late[1], float(error[t_s > t_s[-1] - 60.0].max()), float((told**2).sum() * PERIOD_S)


def main() -> None:
    """Print a row for each law and monitor: the median over the seeds, and how many were lost (beyond 5 deg at the end)."""
    parser = argparse.ArgumentParser(description="the published faults under each wheel health")
    parser.add_argument("--scenario", default="zhang2018", choices=("zhang2018", "zhang2018-flight"))
    parser.add_argument("--seeds", type=int, default=1)
    wanted = parser.parse_args()
    print("law | wheel health | 1 deg [s] | 0.1 deg [s] | largest in the last minute [deg] | u^2 [N^2 m^2 s] | lost")
    for law in LAWS:
        for monitor in MONITORS:
            rows = np.array([fly(wanted.scenario, law, monitor, seed + 1) for seed in range(wanted.seeds)])
            one, tenth, end, effort = np.median(rows, axis=0)
            lost = int((rows[:, 2] > 5.0).sum())
            print(f"{law} | {monitor} | {one:.1f} | {tenth:.1f} | {end:.2g} | {effort:.2f} | {lost}/{len(rows)}")


if __name__ == "__main__":
    main()
