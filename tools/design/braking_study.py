"""How fast each attitude law is, as a ratio to the clairvoyant optimum, over 133 fault cases (see docs/ilo-smc.md).

    python -m tools.design.braking_study                     every law, ideal sensors (about a minute)
    python -m tools.design.braking_study --law adaptive --degraded
    python -m tools.design.braking_study --law adaptive --cases

Settling is the last time the error exceeds 1 degree. The ratio can be below 1: the optimum is to rest at the target
itself, and 1 degree is passed before that.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from dataclasses import replace

from fsw.allocators.pseudo_inverse import PseudoInverse, PseudoInverseConfig
from fsw.controllers.braking_profile import BrakingProfile, BrakingProfileConfig
from fsw.controllers.smc import SlidingMode, SmcConfig
from fsw.controllers.variable_structure import VariableStructure, VariableStructureConfig
from fsw.observers.ilo import Ilo, IloConfig, scale_gains
from fsw.observers.none import NoObserver, NoObserverConfig
from fsw.records import Controller, Observer
from fsw.vehicle import ModelConfig
from tools.design.braking_cases import INERTIA_KGM2, Case, Conditions, Stack, fly, read_cases

GROUPS = ("zhang2018", "given", "random, seen", "random, fresh")
FIRST_FRESH = 88  # drawn and solved after the settings were fixed; the ones before were in view while they were chosen
ADAPTIVE = BrakingProfileConfig(kind="braking_profile")
FIXED = replace(ADAPTIVE, adapt=False, eta=0.8, k_theta=0.35, k_s=1.2)

Law = Callable[[ModelConfig, float], tuple[Observer, Controller]]


def _ilo(model: ModelConfig, period_s: float) -> Observer:
    return Ilo(scale_gains(IloConfig(kind="ilo"), period_s), model)


LAWS: dict[str, Law] = {
    "adaptive": lambda model, period_s: (_ilo(model, period_s), BrakingProfile(ADAPTIVE, model)),
    "fixed": lambda model, period_s: (_ilo(model, period_s), BrakingProfile(FIXED, model)),
    "smc": lambda model, period_s: (_ilo(model, period_s), SlidingMode(SmcConfig(kind="smc"), model)),
    "variable_structure": lambda model, period_s: (
        NoObserver(NoObserverConfig(kind="none"), model),
        VariableStructure(VariableStructureConfig(kind="variable_structure"), model),
    ),
}

DEGRADED: dict[str, Conditions] = {
    "ideal, 10 Hz": Conditions(),
    "50 Hz": Conditions(period_s=0.02, step_s=0.02),
    "10 Hz, one period late": Conditions(delay_periods=1),
    "50 Hz, one period late": Conditions(period_s=0.02, step_s=0.02, delay_periods=1),
    "10 Hz, gyro 1e-5 rad/s": Conditions(gyro_sigma_rad_s=1e-5),
    "10 Hz, gyro 1e-4 rad/s": Conditions(gyro_sigma_rad_s=1e-4),
    "10 Hz, wheel momentum": Conditions(momentum=True),
}


def find_ratios(law: Law, cases: list[Case], conditions: Conditions) -> list[float]:
    """Return settling time to 1 degree over the optimum, case by case."""

    def make(conditions: Conditions) -> Stack:
        model = ModelConfig(inertia_kgm2=INERTIA_KGM2, wheel_momentum=conditions.momentum)
        observer, controller = law(model, conditions.period_s)
        return Stack(observer, controller, PseudoInverse(PseudoInverseConfig(kind="pseudo_inverse"), model))

    return [fly(case, make, conditions)[1.0] / case.optimum_s for case in cases]


def summarise(name: str, cases: list[Case], ratios: list[float]) -> str:
    """Return one row: the published scenario, then mean / 90th percentile / maximum of each group of cases."""
    groups: dict[str, list[float]] = {group: [] for group in GROUPS}
    for case, ratio in zip(cases, ratios, strict=True):
        groups[_group_of(case)].append(ratio)
    return f"| {name} | " + " | ".join(_describe(group) for group in groups.values()) + " |"


def _group_of(case: Case) -> str:
    kind, _, number = case.id.partition("-")
    if kind == "random":
        return "random, seen" if int(number) < FIRST_FRESH else "random, fresh"
    return kind


def _describe(ratios: list[float]) -> str:
    if len(ratios) < 2:
        return f"{ratios[0]:.3f}" if ratios else "-"
    tenth = sorted(ratios)[math.ceil(0.9 * len(ratios)) - 1]
    return f"{sum(ratios) / len(ratios):.3f} / {tenth:.3f} / {max(ratios):.3f}"


def main(arguments: list[str]) -> int:
    """Print the table on stdout; 0 when done."""
    parser = argparse.ArgumentParser(prog="braking_study", description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--law", choices=sorted(LAWS), action="append", help="only this law (repeatable)")
    parser.add_argument("--degraded", action="store_true", help="also late, noisy, faster and with wheel momentum")
    parser.add_argument("--cases", action="store_true", help="one line a case")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="only every n-th case")
    options = parser.parse_args(arguments)
    cases = read_cases()[:: options.every]
    print("| law | " + " | ".join(GROUPS) + " |")
    print("|---" * (1 + len(GROUPS)) + "|")
    for name in options.law or LAWS:
        for condition, conditions in DEGRADED.items() if options.degraded else [("ideal, 10 Hz", Conditions())]:
            ratios = find_ratios(LAWS[name], cases, conditions)
            print(summarise(f"{name}, {condition}", cases, ratios), flush=True)
            if options.cases:
                for case, ratio in zip(cases, ratios, strict=True):
                    settled_s = ratio * case.optimum_s
                    print(f"{case.id:12s} optimum {case.optimum_s:6.2f} s  settled {settled_s:6.2f} s  {ratio:.3f}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
