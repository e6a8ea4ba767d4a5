"""`hilsat bench`: what the bench costs on this machine, measured now. One CPU core, CPU time where that is the fair unit.

Speeds are simulated seconds per second: of CPU for one process, of wall time for two in lock-step. Both with the plant
and the flight cycle at 100 Hz, control at 10 Hz and full telemetry to a file. Start-up is left out and told apart.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from bus.build import CURRENT
from bus.units import Vec4
from fsw.families import Detector
from fsw.records import Detection, Estimate, Sensors
from tools.config.loader import load_scenario
from tools.config.scenario import Resolved
from tools.config.scenario_files import find_scenario
from tools.measure.other_build import BOTH, RATIO, has_other, measure_plain, set_beside

SCENARIOS = {  # scenario -> what makes it 100 Hz
    "zhang2018": ["clock.tick_hz=100", "fsw.executive.control_divider=10", "plant.star_tracker.rate_hz=10"],
    "zhang2018-flight": [],  # noisy sensors, Kalman filter, gravity gradient
}
ROUNDS = 5


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("bench", help="measure what a cycle costs", description=__doc__)
    parser.add_argument("--seconds", type=float, default=120.0, help="simulated seconds per round (default 120)")
    parser.add_argument(
        "--only",
        choices=sorted(MEASUREMENTS),
        action="append",
        help=f"measure just this; repeatable; only when asked for: {', '.join(SLOW)}",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Measure, print, return 0."""
    results: dict[str, Any] = {"build": CURRENT.words, "cpus": os.cpu_count(), "python": sys.version.split()[0]}
    wanted = args.only or [name for name in MEASUREMENTS if name not in SLOW]
    for name, measure in MEASUREMENTS.items():
        if name not in wanted:
            continue
        print(f"measuring {name} ...", file=sys.stderr)
        results[name] = measure(args.seconds)
        if name in BOTH and has_other():
            print(f"measuring {name} of the plain build ...", file=sys.stderr)
            results[name] = set_beside(results[name], measure_plain(name, args.seconds))
    if args.json:
        print(json.dumps(results, allow_nan=False))
    else:
        for name, value in results.items():
            print(f"{name:<12} {_format(value)}")
    return 0


def _format(value: Any) -> str:
    if isinstance(value, dict) and RATIO in value:  # one figure of both builds
        return "   ".join(f"{key} {_format(item)}" for key, item in value.items())
    if isinstance(value, dict):
        return "\n             ".join(f"{key:<36} {_format(item)}" for key, item in value.items())
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _measure_in_process(seconds: float) -> dict[str, Any]:
    return {name: measure_scenario(name, seconds) for name in SCENARIOS}


def measure_scenario(name: str, seconds: float, rounds: int = ROUNDS) -> dict[str, Any]:
    """The whole loop in this process: frames encoded, checked, decoded, telemetry written to a file."""
    from tools.run.in_process import run_in_process

    resolved = _load(name, seconds, "inprocess")
    speeds = []
    size = 0
    for _ in range(rounds):
        begun: list[float] = []
        with tempfile.TemporaryDirectory(prefix="hilsat-bench-") as directory:
            report = run_in_process(resolved, Path(directory), _note_times(begun))
            speeds.append(seconds / (time.process_time() - begun[0]))
            size = report.log.stat().st_size
    best = max(speeds)
    return {
        "sim-s per cpu-s, median": sorted(speeds)[len(speeds) // 2],
        "sim-s per cpu-s, best": best,
        "us per tick, best": 1e6 / (best * resolved.scenario.clock.tick_hz),
        "log, bytes per tick": size / resolved.ticks,
    }


def _note_times(times_s: list[float]) -> Callable[[int], None]:
    """A progress callback that notes the CPU time at which it was called; the first time is after the first tick."""
    return lambda tick: times_s.append(time.process_time())


def _measure_lockstep(seconds: float) -> dict[str, Any]:
    """Beside the floor: what two processes on one processor take to hand a frame over and back, and nothing else."""
    from tools.measure.bus import measure_round_trip

    floor = measure_round_trip("pair")["p50_us"]
    results: dict[str, Any] = {name: _measure_processes(name, seconds) for name in SCENARIOS}
    return results | {"floor": {"bare socket pair, there and back, us, p50": floor}}


def _measure_processes(name: str, seconds: float) -> dict[str, Any]:
    """Two processes and a recorder over the embedded bus."""
    from tools.run.runner import run_processes

    resolved = _load(name, seconds, "lockstep")
    speeds, starts, memory = [], [], []
    for _ in range(ROUNDS):
        with tempfile.TemporaryDirectory(prefix="hilsat-bench-") as directory:
            report = run_processes(resolved, Path(directory), lambda tick: None)
            if report.exit_code:
                return {"failed": "; ".join(report.problems)}
            speeds.append(seconds / (report.details["running_s"]))
            starts.append(report.first_cycle_s or 0.0)
            memory.append(sum(mb for name, mb in report.memory_mb.items() if name != "recorder"))
    best = max(speeds)
    return {
        "sim-s per wall-s, median": sorted(speeds)[len(speeds) // 2],
        "sim-s per wall-s, best": best,
        "us per tick, best": 1e6 / (best * resolved.scenario.clock.tick_hz),
        "start to first cycle, s, median": sorted(starts)[len(starts) // 2],
        "peak memory, plant + fsw, MB": max(memory),
    }


def _load(name: str, seconds: float, mode: str) -> Resolved:
    settings = [*SCENARIOS[name], f"duration_s={seconds}", f"clock.mode={mode}", "expect=[]"]
    return load_scenario(find_scenario(name), settings)


def _measure_set_up(seconds: float) -> dict[str, Any]:
    from tools.measure.set_up import measure_set_up

    return {name: measure_set_up(name, settings) for name, settings in SCENARIOS.items()}


def _measure_instructions(seconds: float) -> dict[str, Any]:
    from tools.measure.instructions import count_instructions

    return {name: count_instructions(name, settings) for name, settings in SCENARIOS.items()}


def _measure_codec(seconds: float) -> dict[str, Any]:
    """One frame, CRC and alive counter included."""
    from bus.icd.codec import DECODERS, encode_RW1_TLM
    from bus.icd.e2e import Link

    frames = [encode_RW1_TLM(k % 15, 0, 12.345 + k, 100, k & 0xFF)[8:] for k in range(1500)]
    link = Link(DECODERS[0x190])
    return {
        "encode, us": _time(lambda k: encode_RW1_TLM(k % 15, 0, 12.345 + k, 100, k & 0xFF), 1500),
        "check and decode, us": _time(lambda k: link.accept(frames[k], k), 1500),
    }


def _time(call: Callable[[int], object], count: int) -> float:
    """Best of five: microseconds per call."""
    best = float("inf")
    for _ in range(5):
        started = time.perf_counter()
        for k in range(count):
            call(k)
        best = min(best, time.perf_counter() - started)
    return best / count * 1e6


def _measure_detection(seconds: float) -> dict[str, Any]:
    """One cycle of the practical gyro detector at 20 Hz with each residual observer: all axes, CPU time, mean."""
    from tools.run.bench import Bench

    overrides = ["clock.tick_hz=20", "fsw.executive.control_divider=2", "clock.mode=inprocess", "expect=[]"]
    results: dict[str, Any] = {"bar, us": 150.0}
    for observer in ("static", "ts_b", "ts_bx"):
        resolved = load_scenario(find_scenario("gyro-drift-flight"), [*overrides, f"fsw.detector.observer={observer}"])
        bench = Bench(resolved)
        bench.flight.detector = timed = _Timed(bench.flight.detector)
        bench.step(resolved.ticks)
        results[f"practical + {observer}, us"] = timed.spent_ns / resolved.ticks / 1e3
    return results


class _Timed(Detector):
    """A detector whose steps are timed, in CPU time of this thread."""

    def __init__(self, detector: Detector) -> None:
        self._detector = detector
        self.spent_ns = 0

    @property
    def internals(self) -> tuple[Any, ...]:
        return self._detector.internals

    def reset(self) -> None:
        self._detector.reset()

    def step(self, sensors: Sensors, estimate: Estimate, tau_rw_cmd_nm: Vec4) -> Detection:
        started = time.thread_time_ns()
        detection = self._detector.step(sensors, estimate, tau_rw_cmd_nm)
        self.spent_ns += time.thread_time_ns() - started
        return detection


def _measure_algorithms(seconds: float) -> dict[str, Any]:
    from tools.measure.algorithms import measure_algorithms

    return measure_algorithms()


def _measure_wheels(seconds: float) -> dict[str, Any]:
    from tools.measure.wheels import measure_wheels

    return measure_wheels()


def _measure_bus(seconds: float) -> dict[str, Any]:
    from tools.measure.bus import measure_all

    return measure_all()


def _measure_ground(seconds: float) -> dict[str, Any]:
    from tools.measure.ground import measure_ground

    return measure_ground(seconds)


def _measure_campaign(seconds: float) -> dict[str, Any]:
    from tools.measure.campaign import measure_campaign

    return measure_campaign()


def _measure_basilisk(seconds: float) -> dict[str, Any]:
    from tools.measure.basilisk import compare

    return compare({name: partial(_measure_once, name, seconds) for name in SCENARIOS})


def _measure_once(name: str, seconds: float) -> float:
    speed: float = measure_scenario(name, seconds, rounds=1)["sim-s per cpu-s, best"]
    return speed


MEASUREMENTS: dict[str, Callable[[float], dict[str, Any]]] = {
    "in-process": _measure_in_process,
    "lock-step": _measure_lockstep,
    "set-up": _measure_set_up,
    "codec": _measure_codec,
    "detection": _measure_detection,
    "algorithms": _measure_algorithms,
    "wheels": _measure_wheels,
    "bus": _measure_bus,
    "ground": _measure_ground,
    "basilisk": _measure_basilisk,
    "campaign": _measure_campaign,
    "instructions": _measure_instructions,
}
SLOW = ("campaign", "ground", "instructions")  # minutes: only when asked for
