"""What direct allocation gains and costs beside the pseudo-inverse, and null torque in a hold: docs/direct-allocation.md.

python -m tools.design.allocation_study              all of it
python -m tools.design.allocation_study capability   torque, volume and power; how many facets the sorted search tries
python -m tools.design.allocation_study time         run times
python -m tools.design.allocation_study flights      settling of shipped scenarios with each allocator
python -m tools.design.allocation_study hold         wheels that pass zero speed, with and without null torque
"""

from __future__ import annotations

import argparse
import sys
import timeit
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import linprog

from bus.units import Vec3, Vec4
from fsw.allocators.attainable_set import AttainableSet
from fsw.allocators.direct import Direct
from fsw.allocators.pseudo_inverse import PseudoInverse
from fsw.allocators.settings import DirectAllocationConfig, PseudoInverseConfig
from fsw.null_space import NullSpace
from fsw.records import HEALTHY, Allocation, Sensors, WheelHealth
from fsw.settings import ModelConfig, NullSpaceConfig
from fsw.vehicle import Vehicle
from tools.run.bench import Bench

LIMIT_NM = 0.1
VEHICLE = Vehicle(ModelConfig(inertia_kgm2=((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))))
AXES = VEHICLE.wheels.axes_b
MATRIX = np.array(AXES).T
LOW, HIGH, SOUND = (-LIMIT_NM,) * 4, (LIMIT_NM,) * 4, (1.0,) * 4
DIRECTIONS = 20_000
SHARES: dict[str, Vec4] = {
    "sound": SOUND,
    "0.4, 0.5, 1, 1": (0.4, 0.5, 1.0, 1.0),
    "0.2, 1, 1, 0.6": (0.2, 1.0, 1.0, 0.6),
    "x dead": (0.0, 1.0, 1.0, 1.0),
}
ALLOCATORS = (
    "pseudo_inverse, saturation: clip", "pseudo_inverse, saturation: direction", "direct", "direct, share_min: 0",
)  # fmt: skip
SLOW_RAD_S = 2.0


def show_capability() -> None:
    """Print largest torques, and how much of them the pseudo-inverse, its direction kept, can have."""
    rng = np.random.default_rng(2016)
    ways = rng.standard_normal((DIRECTIONS, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    print(
        "| wheels | x axis | (1,1,1) | least | volume | loss, mean | most | more sum u^2 "
        "| tries, first right | mean | most |"
    )
    print("|---" * 11 + "|")
    for name, shares in SHARES.items():
        found = AttainableSet(AXES, shares, LOW, HIGH)
        pinv = np.linalg.pinv(MATRIX * shares)
        reach = np.array([found.find_reach((x, y, z)) for x, y, z in ways.tolist()])
        usual = LIMIT_NM / np.abs(ways @ pinv.T).max(axis=1)
        half = [np.array(found.allocate((x, y, z))) for x, y, z in (0.05 * ways).tolist()]
        power = np.mean([u @ u for u in half]) / np.mean(((0.05 * ways @ pinv.T) ** 2).sum(axis=1)) - 1.0
        tries = np.array([found.allocate_sorted((x, y, z))[1] for x, y, z in ways.tolist()])
        axis, skew = ((found.find_reach(way), LIMIT_NM / np.abs(pinv @ way).max()) for way in (AXES[0], AXES[3]))
        least = min(support for _, support in found.list_facets()), LIMIT_NM / np.linalg.norm(pinv, axis=1).max()
        print(
            f"| {name} | {axis[0]:.5f} / {axis[1]:.5f} | {skew[0]:.5f} / {skew[1]:.5f} | {least[0]:.5f} / {least[1]:.5f} "
            f"| {(usual**3).mean() / (reach**3).mean():.3f} | {1 - (usual / reach).mean():.1%} "
            f"| {1 - (usual / reach).min():.1%} | {power:.1%} | {(tries == 1).mean():.1%} "
            f"| {tries.mean():.2f} | {tries.max()} |"
        )


def show_times() -> None:
    """Print the least time of a call of several rounds [us]."""
    found = AttainableSet(AXES, SOUND, LOW, HIGH)
    direct = Direct(DirectAllocationConfig(kind="direct"), VEHICLE, 0.1)
    usual = PseudoInverse(PseudoInverseConfig(kind="pseudo_inverse"), VEHICLE, 0.1)
    null = NullSpace(NullSpaceConfig(momentum_gain_1_s=0.02, avoid_speed_rad_s=10.0), VEHICLE, 0.1)
    tau: Vec3 = (0.03, -0.02, 0.05)
    weak = (WheelHealth((0.4, 0.5, 1.0, 1.0)), HEALTHY)
    allocation, sensors = Allocation((0.01, 0.02, 0.03, 0.04)), Sensors(0, 0.0)
    cost = [0.0] * 4 + [-1.0]
    columns, bounds = np.column_stack([MATRIX, -np.array(tau)]), [*[(-LIMIT_NM, LIMIT_NM)] * 4, (0.0, None)]
    rows: dict[str, tuple[Callable[[], Any], int]] = {
        "attainable set, allocate": (lambda: found.allocate(tau), 2000),
        "attainable set, allocate_sorted": (lambda: found.allocate_sorted(tau), 1000),
        "attainable set, made": (lambda: AttainableSet(AXES, SOUND, LOW, HIGH), 100),
        "allocator direct": (lambda: direct.allocate(tau, HEALTHY), 2000),
        "allocator direct, shares changed": (lambda: [direct.allocate(tau, health) for health in weak], 100),
        "allocator pseudo_inverse": (lambda: usual.allocate(tau, HEALTHY), 2000),
        "null space": (lambda: null.step(0.1, allocation.tau_rw_nm, allocation, HEALTHY, sensors), 1000),
        "linear program, scipy's HiGHS": (
            lambda: linprog(cost, A_eq=columns, b_eq=[0.0] * 3, bounds=bounds, method="highs"), 20,
        ),
    }  # fmt: skip
    print("| call | us |\n|---|---|")
    for name, (call, count) in rows.items():
        calls = count * (2 if "changed" in name else 1)
        print(f"| {name} | {min(timeit.repeat(call, number=count, repeat=9)) / calls * 1e6:.1f} |", flush=True)


def show_flights() -> None:
    """Print when the error stays below a bound [s]."""
    print("| scenario | allocator | 1 deg | 0.1 deg | largest after 250 s [deg] |\n|---|---|---|---|---|")
    for name, changes in (
        ("zhang2018", []),
        ("zhang2018", ["faults=[]"]),
        ("braking-profile", []),
        ("variable-structure", []),
        ("zhang2018-flight", []),
    ):
        for allocator in ALLOCATORS if name == "braking-profile" else ALLOCATORS[:3]:
            said = [*changes, "expect=[]", f"fsw.allocator={{kind: {allocator}}}"]
            with Bench.open(name, said, log="memory") as bench:
                bench.run_to_end()
                error, tick_s = bench.log.signals("/truth/attitude")["error_deg"], bench.tick_s
            settled = [_find_settling(error, bound, tick_s) for bound in (1.0, 0.1)]
            worst = error[round(250.0 / tick_s) :].max()
            without = ", no faults" if changes else ""
            print(f"| `{name}`{without} | {allocator} | {settled[0]} | {settled[1]} | {worst:.4f} |", flush=True)


def _find_settling(error_deg: Any, bound_deg: float, tick_s: float) -> str:
    above = np.flatnonzero(error_deg > bound_deg)
    if not len(above):
        return "0.0"
    return "never" if above[-1] + 1 == len(error_deg) else f"{(above[-1] + 1) * tick_s:.1f}"


def show_hold() -> None:
    """Print five minutes of ithaco-hold with slow wheels and a torque that takes them through zero."""
    mounts = [
        f"{{mount: {mount}, model: ithaco, speed_rad_s: {speed}, speed_noise_rad_s: 0.05, current_noise_a: 0.001}}"
        for mount, speed in (("x", 12.0), ("y", -9.0), ("z", 10.0), ("skew", -14.0))
    ]
    changes = ["expect=[]", f"plant.wheels=[{', '.join(mounts)}]"]
    changes.append("plant.torques=[{kind: constant, torque_nm: [-4e-4, 3e-4, -2e-4]}]")
    print(
        "| `fsw.null_space` | sign changes | below 2 rad/s, all wheels [s] | error after 150 s, rms / largest [deg] |"
    )
    print("|---" * 4 + "|")
    for setting in (
        "",
        "avoid_speed_rad_s: 6",
        "momentum_gain_1_s: 0.02",
        "momentum_gain_1_s: 0.02, avoid_speed_rad_s: 6",
    ):
        with Bench.open("ithaco-hold", [*changes, f"fsw.null_space={{{setting}}}"], log="memory") as bench:
            bench.run_to_end()
            speed = bench.log.signals("/truth/wheels")["speed_rad_s"]
            error = bench.log.signals("/truth/attitude")["error_deg"][round(150.0 / bench.tick_s) :]
        turns = int((speed[1:] * speed[:-1] < 0.0).sum())
        slow_s = (np.abs(speed) < SLOW_RAD_S).sum() * bench.tick_s
        print(
            f"| {setting or 'off'} | {turns} | {slow_s:.1f} | {np.sqrt((error**2).mean()):.3f} / {error.max():.3f} |",
            flush=True,
        )


PARTS = {"capability": show_capability, "time": show_times, "flights": show_flights, "hold": show_hold}


def main(arguments: list[str]) -> int:
    """Print the tables on stdout; 0 when done."""
    parser = argparse.ArgumentParser(prog="allocation_study", description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="which tables; all unless said")
    for part in parser.parse_args(arguments).parts or PARTS:
        PARTS[part]()
        print()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
