"""How each imperfection of a real loop moves the published settling times: `python -m tools.design.real_loop`.

One at a time on the published scenario, then all together as `zhang2018-flight`. In process, through CAN frames, so that
quantised torque commands (1e-7 N m) and attitudes (2^-23) are part of every line.
"""

from __future__ import annotations

import numpy as np

from tools.run.bench import Bench

LIMITS_DEG = (5.0, 1.0, 0.1, 0.01)
LAGGING = "[" + ", ".join(
    f"{{mount: {mount}, tilt_deg: {tilt}, clock_deg: {clock}, max_torque_nm: 0.1, torque_lag_s: 0.1}}"
    for mount, tilt, clock in (("x", 10, 12), ("y", 8, 15), ("z", 5, 8), ("skew", 6, 10))
) + "]"  # fmt: skip
TACTICAL = "plant.gyro.preset=tactical"
MATCHED = ["fsw.estimator.gyro_arw_rad_sqrt_s=2.91e-5", "fsw.estimator.gyro_rrw_rad_s_sqrt_s=1e-7"]  # the filter, to it
CASES: dict[str, tuple[str, list[str]]] = {
    "as published, ideal sensors": ("zhang2018", []),
    "one sample of command delay (0.1 s)": ("zhang2018", ["plant.command_latency_ticks=1"]),
    "wheel torque lag, 0.1 s": ("zhang2018", [f"plant.wheels={LAGGING}"]),
    "the wheels' momentum in plant and model": (
        "zhang2018",
        ["plant.body.wheel_gyroscopic=true", "fsw.model.wheel_momentum=true"],
    ),
    "gyro noise, space grade": ("zhang2018", ["plant.gyro.preset=space"]),
    "gyro noise, tactical grade": ("zhang2018", [TACTICAL]),
    "star tracker noise 10, 10, 52 arcsec": ("zhang2018", ["plant.star_tracker.noise_arcsec=[10, 10, 52]"]),
    "all of it, filtered, at 100 Hz (zhang2018-flight)": ("zhang2018-flight", []),
    "all of it with a tactical gyro, filter as it is": ("zhang2018-flight", [TACTICAL]),
    "all of it with a tactical gyro, filter to match": ("zhang2018-flight", [TACTICAL, *MATCHED]),
}


def measure(scenario: str, overrides: list[str]) -> tuple[list[float | None], float]:
    """Settling time for each limit [s], None where it does not; rms norm of the fault-torque error after 50 s [N m]."""
    bench = Bench.open(scenario, [*overrides, "expect=[]"])
    errors, torque_errors = [], []
    while bench.tick < bench.ticks:
        truth = bench.step().sampled_truth
        errors.append(truth.error_deg)
        torque_errors.append(np.subtract(bench.flight.tau_fault_hat_b_nm, truth.tau_fault_b_nm))
    error = np.array(errors)
    settled: list[float | None] = []
    for limit in LIMITS_DEG:
        above = np.flatnonzero(error > limit)
        settled.append(None if above[-1] == error.size - 1 else float(above[-1]) * bench.tick_s)
    late = np.array(torque_errors)[round(50 / bench.tick_s) :]
    return settled, float(np.sqrt(np.mean(np.sum(late * late, axis=1))))


def main() -> None:
    """Print the table."""
    print("| loop | 5 deg | 1 deg | 0.1 deg | 0.01 deg | fault torque error, rms after 50 s |")
    print("|---|---|---|---|---|---|")
    for name, (scenario, overrides) in CASES.items():
        settled, rms = measure(scenario, overrides)
        cells = " | ".join("never" if time_s is None else f"{time_s:.1f}" for time_s in settled)
        print(f"| {name} | {cells} | {rms:.2g} N m |", flush=True)


if __name__ == "__main__":
    main()
