"""Monte Carlo of the practical gyro fault detector: false alarms, delays, estimate errors, kinds, coupling.

    python -m tools.design.fdi_campaign false-alarms --hours 1 --runs 5 [--fog space] [--rate 20]
    python -m tools.design.fdi_campaign delays --runs 20 [--all-axes] [--amplitude 0.001 ...]
    python -m tools.design.fdi_campaign kinds --runs 5
    python -m tools.design.fdi_campaign separation --runs 20
    python -m tools.design.fdi_campaign coupling [--amplitude 0.1 ...]
    python -m tools.design.fdi_campaign rates --runs 10

Every flight is a closed loop with misaligned wheels and a wrong inertia; all draws come from --seed. One JSON object
with the figures goes to stdout, progress to stderr.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fsw.gyro_fdi.classification import FaultKind
from plant_server.faults import make_fault
from tools.design.fdi_flight import NEVER, WHEEL_FAULTS, FlightSettings, Moment, fly, with_detector

AXES = ("gyro.x", "gyro.y", "gyro.z")
ALARM = 2
SETTLE_S = 2.0  # the estimate is graded from this long after the alarm
AMPLITUDES = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0005)
KIND_CASES = ((0.1, 0.0), (0.001, 0.0), (0.05, 0.5), (0.05, 2.0), (0.05, 5.0), (0.01, 0.5))  # amplitude, frequency
BLIND_FROM_S = 20.0
RATES_DEG_S = (1.0, 2.0, 5.0, 10.0, 20.0, 25.0, 30.0, 40.0, 60.0)  # of the body at the start
COUPLING_AMPLITUDES = (0.0, 0.001, 0.01, 0.1)


@dataclass(slots=True)
class Watch:
    """What one flight showed."""

    onset_s: float
    axes: tuple[int, ...]  # at fault
    alarm_s: list[float] = field(default_factory=lambda: [math.inf] * 3)
    suspect_s: list[float] = field(default_factory=lambda: [math.inf] * 3)
    wheel_alarm_s: list[float] = field(default_factory=lambda: [math.inf] * 4)
    suspect_ticks: int = 0
    estimate_errors: list[float] = field(default_factory=list)
    torque_errors: list[float] = field(default_factory=list)  # observer's, worst axis per tick from onset on
    pointing_deg: list[float] = field(default_factory=list)  # from onset on
    rates_deg_s: list[float] = field(default_factory=list)

    def __call__(self, moment: Moment) -> None:
        detection, t_s = moment.detection, moment.t_s
        for axis, state in enumerate(detection.gyro_state):
            if state >= ALARM and t_s < self.alarm_s[axis]:
                self.alarm_s[axis] = t_s
            if state:
                self.suspect_s[axis] = min(self.suspect_s[axis], t_s)
            self.suspect_ticks += state == 1
        for wheel, alarm in enumerate(moment.wheel_alarm):
            if alarm and t_s < self.wheel_alarm_s[wheel]:
                self.wheel_alarm_s[wheel] = t_s
        if t_s >= self.onset_s:
            self._grade(moment)

    def _grade(self, moment: Moment) -> None:
        for axis in self.axes:
            if moment.t_s > self.alarm_s[axis] + SETTLE_S:
                error = moment.detection.fault_hat_b_rad_s[axis] - moment.truth.fault_b_rad_s[axis]
                self.estimate_errors.append(error)
        pair = zip(moment.tau_fault_hat_b_nm, moment.truth.tau_fault_b_nm, strict=True)
        self.torque_errors.append(max(abs(a - b) for a, b in pair))
        self.pointing_deg.append(moment.truth.error_deg)
        self.rates_deg_s.append(math.degrees(math.hypot(*moment.truth.omega_bi_b_rad_s)))

    @property
    def delays_s(self) -> list[float]:
        """From onset to alarm of each axis at fault; inf where missed [s]."""
        return [self.alarm_s[axis] - self.onset_s for axis in self.axes]

    @property
    def wrong_axes(self) -> int:
        """Axes without fault that raised an alarm, and alarms before the onset."""
        healthy = sum(math.isfinite(t) for axis, t in enumerate(self.alarm_s) if axis not in self.axes)
        return healthy + sum(delay < 0.0 for delay in self.delays_s)


def count_false_alarms(base: FlightSettings, runs: int, hours: float) -> dict[str, Any]:
    """Return alarms of fault-free gyros over `runs` flights of `hours`; every other flight has the wheel faults."""
    alarms = suspect_ticks = 0
    for run in range(runs):
        watch = Watch(math.inf, ())
        faults = WHEEL_FAULTS if run % 2 else ()
        fly(vary(base, seed=base.seed + run, duration_s=3600.0 * hours, faults=faults), watch)
        alarms += sum(math.isfinite(t) for t in watch.alarm_s)
        suspect_ticks += watch.suspect_ticks
        report(f"run {run + 1}/{runs}: {alarms} alarms, {suspect_ticks} suspect ticks so far")
    return {"hours": hours * runs, "gyro_alarms": alarms, "suspect_ticks": suspect_ticks}


def measure_delays(base: FlightSettings, runs: int, amplitude: float, all_axes: bool, wait_s: float) -> dict[str, Any]:
    """Return detection delays of a constant drift of `amplitude` [rad/s] at a random time, axis and sign."""
    delays: list[float] = []
    suspects: list[float] = []
    errors: list[float] = []
    wrong = 0
    for run in range(runs):
        rng = np.random.default_rng([base.seed, run, 3])
        axes = (0, 1, 2) if all_axes else (int(rng.integers(3)),)
        onset_s, sign = float(60.0 + 20.0 * rng.random()), float(rng.choice([-1.0, 1.0]))
        drift = tuple(
            make_fault(unit=AXES[axis], kind="constant", at_s=onset_s, rate_rad_s=sign * amplitude) for axis in axes
        )
        watch = Watch(onset_s, axes)
        fly(vary(base, seed=base.seed + run, duration_s=onset_s + wait_s, faults=(*WHEEL_FAULTS, *drift)), watch)
        delays += watch.delays_s
        suspects += [watch.suspect_s[axis] - onset_s for axis in axes]
        errors += watch.estimate_errors
        wrong += watch.wrong_axes
    seen = sorted(d for d in delays if math.isfinite(d))
    return {
        "amplitude_rad_s": amplitude,
        "axis_faults": len(delays),
        "missed": len(delays) - len(seen),
        "wrong_axis": wrong,
        "delay_mean_s": round(float(np.mean(seen)), 3) if seen else None,
        "delay_p95_s": round(float(np.percentile(seen, 95)), 3) if seen else None,
        "delay_max_s": round(max(seen), 3) if seen else None,
        "suspect_max_s": round(max(suspects), 3) if math.isfinite(max(suspects)) else None,
        "estimate_rmse_rad_s": float(f"{np.sqrt(np.mean(np.square(errors))):.3g}") if errors else None,
    }


def judge_kind(base: FlightSettings, runs: int, amplitude: float, frequency: float) -> dict[str, Any]:
    """Return how a fault was classified within 32 s of its onset, and the errors of its parameters.

    amplitude, frequency : of the sinusoid [rad/s]; frequency 0: a constant
    """
    right, frequency_errors, size_errors = 0, [], []
    wanted = FaultKind.PERIODIC if frequency else FaultKind.CONSTANT
    for run in range(runs):
        rng = np.random.default_rng([base.seed, run, 4])
        axis, onset_s = int(rng.integers(3)), float(60.0 + 20.0 * rng.random())
        fault = make_fault(
            unit=AXES[axis], kind="periodic" if frequency else "constant", at_s=onset_s, rate_rad_s=amplitude,
            frequency_rad_s=frequency or None,
        )  # fmt: skip
        flight = vary(base, seed=base.seed + run, duration_s=onset_s + 32.0, faults=(*WHEEL_FAULTS, fault))
        bench = fly(flight, lambda moment: None)
        right += bench.read("fsw.detector.fault_kind")[axis] == wanted
        size_errors.append(abs(bench.read("fsw.detector.fault_magnitude_rad_s")[axis]) / amplitude - 1.0)
        found_rad_s = bench.read("fsw.detector.fault_frequency_rad_s")[axis]
        frequency_errors.append(found_rad_s / frequency - 1.0 if frequency else 0.0)
    return {
        "amplitude_rad_s": amplitude, "frequency_rad_s": frequency, "right": right, "runs": runs,
        "size_error_rms": rms(size_errors), "frequency_error_rms": rms(frequency_errors),
    }  # fmt: skip


def check_separation(base: FlightSettings, runs: int) -> dict[str, Any]:
    """Return gyro alarms with wheel faults only, wheel alarm delays, and wheel alarms with gyro faults only."""
    onsets = (30.0, 10.0, 20.0, 30.0)
    worst, gyro_alarms, missed, wrong = [0.0] * 4, 0, 0, 0
    for run in range(runs):
        watch = Watch(math.inf, ())
        fly(vary(base, seed=base.seed + run, duration_s=130.0, faults=WHEEL_FAULTS, published_start=True), watch)
        gyro_alarms += sum(math.isfinite(t) for t in watch.alarm_s)
        for wheel, onset_s in enumerate(onsets):
            delay = watch.wheel_alarm_s[wheel] - onset_s
            missed += not math.isfinite(delay)
            wrong += delay < 0.0
            worst[wheel] = max(worst[wheel], delay if math.isfinite(delay) else 0.0)
    crossed = 0
    for run in range(runs):
        fault = make_fault(unit=AXES[run % 3], kind="constant", at_s=60.0, rate_rad_s=0.05)
        watch = Watch(60.0, (run % 3,))
        fly(vary(base, seed=base.seed + run, duration_s=130.0, faults=(fault,), published_start=True), watch)
        crossed += sum(math.isfinite(t) for t in watch.wheel_alarm_s)
    return {
        "runs": runs, "gyro_alarms_on_wheel_faults": gyro_alarms, "wheel_alarms_on_gyro_faults": crossed,
        "wheel_alarms_missed": missed, "wheel_alarms_before_fault": wrong,
        "wheel_delay_max_s": [round(d, 2) for d in worst],
    }  # fmt: skip


def measure_coupling(base: FlightSettings, amplitude: float, recovery: str) -> dict[str, Any]:
    """Return what a constant drift on three axes does to observer, pointing and rate, recovery on or off."""
    onset_s = 150.0
    at_fault = AXES if amplitude else ()
    drift = tuple(make_fault(unit=unit, kind="constant", at_s=onset_s, rate_rad_s=amplitude) for unit in at_fault)
    faults = (*WHEEL_FAULTS, *drift)
    settings = vary(base, duration_s=270.0, manoeuvre_every_s=0.0, published_start=True, faults=faults)
    watch = Watch(onset_s, (0, 1, 2) if amplitude else ())
    fly(with_detector(settings, recovery=recovery), watch)
    return {
        "amplitude_rad_s": amplitude,
        "recovery": recovery,
        "torque_error_peak_nm": round(max(watch.torque_errors), 4),
        "torque_error_rms_nm": round(rms(watch.torque_errors), 4),
        "pointing_max_deg": round(max(watch.pointing_deg), 3),
        "rate_max_deg_s": round(max(watch.rates_deg_s), 3),
    }


def count_accused(base: FlightSettings, runs: int, rate_deg_s: float, blind: bool) -> dict[str, Any]:
    """Return how often a healthy gyro is accused in 120 s of flight that start at a rate about a random axis.

    blind : the star tracker is lost after BLIND_FROM_S; else it sees throughout, whatever the rate
    """
    lost = (make_fault(unit="star_tracker", kind="dropout", at_s=BLIND_FROM_S),) if blind else ()
    accused, soonest_s, suspect_ticks = 0, math.inf, 0
    for run in range(runs):
        axis = np.random.default_rng([base.seed, run, 5]).normal(size=3)
        x, y, z = (rate_deg_s / np.linalg.norm(axis) * axis).tolist()
        watch = Watch(math.inf, ())
        start = vary(base, seed=base.seed + run, duration_s=120.0, start_rate_deg_s=(x, y, z), faults=lost)
        fly(vary(start, star_max_rate_deg_s=NEVER), watch)
        accused += min(watch.alarm_s) < math.inf
        soonest_s = min(soonest_s, *watch.alarm_s)
        suspect_ticks += watch.suspect_ticks
    return {
        "rate_deg_s": rate_deg_s, "tracker": f"lost at {BLIND_FROM_S:g} s" if blind else "sees",
        "runs": runs, "accused": accused, "suspect_ticks": suspect_ticks,
        "soonest_s": soonest_s if math.isfinite(soonest_s) else None,
    }  # fmt: skip


def vary(base: FlightSettings, **changes: object) -> FlightSettings:
    """Return a flight with some settings changed."""
    values = {name: getattr(base, name) for name in base.__slots__}
    return FlightSettings(**(values | changes))


def rms(values: Sequence[float]) -> float:
    """Root mean square."""
    return float(f"{np.sqrt(np.mean(np.square(values))):.4g}")


def report(text: str) -> None:
    """Progress, to stderr."""
    print(text, file=sys.stderr, flush=True)


def main(arguments: list[str] | None = None) -> int:
    """Run one campaign and print its figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("false-alarms", "delays", "kinds", "separation", "coupling", "rates"))
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--hours", type=float, default=1.0, help="length of each false-alarm flight")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--fog", choices=("tactical", "space"), default="tactical")
    parser.add_argument("--rate", type=int, default=20, help="tick rate [Hz]")
    parser.add_argument("--amplitude", type=float, nargs="+", help="constant drifts [rad/s]")
    parser.add_argument("--all-axes", action="store_true")
    parser.add_argument("--wait", type=float, default=40.0, help="watched after onset [s]")
    options = parser.parse_args(arguments)
    base = FlightSettings(seed=options.seed, duration_s=0.0, rate_hz=options.rate, fog=options.fog)
    base = with_detector(base, fog=options.fog)
    print(json.dumps(run_campaign(options, base), indent=1))
    return 0


def run_campaign(options: argparse.Namespace, base: FlightSettings) -> Any:
    """Return the figures of the campaign that was asked for."""
    if options.what == "false-alarms":
        return count_false_alarms(base, options.runs, options.hours)
    if options.what == "kinds":
        return [judge_kind(base, options.runs, *case) for case in KIND_CASES]
    if options.what == "separation":
        return check_separation(base, options.runs)
    if options.what == "rates":
        return [count_accused(base, options.runs, rate, blind) for blind in (False, True) for rate in RATES_DEG_S]
    out = []
    if options.what == "coupling":
        for amplitude in options.amplitude or COUPLING_AMPLITUDES:
            out += [measure_coupling(base, amplitude, recovery) for recovery in ("off", "on")]
        return out
    for amplitude in options.amplitude or AMPLITUDES:
        out.append(measure_delays(base, options.runs, amplitude, options.all_axes, options.wait))
        report(json.dumps(out[-1]))
    return out


if __name__ == "__main__":
    sys.exit(main())
