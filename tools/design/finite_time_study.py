"""Figures of docs/finite-time.md: the finite-time laws of Li & Liu 2011 in continuous time, sampled, and from random starts.

python -m tools.design.finite_time_study settling     law (14): a row a form and power
python -m tools.design.finite_time_study paper        law (28) with 10 N m, undisturbed and disturbed
python -m tools.design.finite_time_study small        0.1 N m about each axis, 0.1 s: settling, what is left, torque
python -m tools.design.finite_time_study latency      the same, torques late by one and two periods
python -m tools.design.finite_time_study noise        the same, with noise of attitude and rate
python -m tools.design.finite_time_study random       40 random starts
python -m tools.design.finite_time_study gains        m_min(beta)
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from bus.linear import scale
from bus.units import Vec3
from fsw.controllers.gain_condition import find_least_gain
from tools.design.finite_time_loop import (
    INERTIA,
    SMALL,
    Body,
    Torque,
    draw_trials,
    find_trial_settling,
    fly_continuous,
    fly_sampled,
    make_law,
    no_torque,
)

Settings = dict[str, Any]
PAPER: Settings = {"kind": "power_integrator", "m": 50.0, "inertia_weight": False, "gain_check": "off"}
WITH_SMALL_WHEELS: dict[str, Settings] = {
    "(28) implicit, beta .13": {"kind": "power_integrator"},
    "(28) implicit, beta .15": {"kind": "power_integrator", "beta": 0.15},
    "(28) explicit, beta .13": {"kind": "power_integrator", "sampling": "explicit"},
    "(28) implicit, m = 50 N m, beta 1": PAPER | {"beta": 1.0},
    "(14) A (1.2, 4)": {"kind": "finite_time", "k1": 1.2, "k2": 4.0},
    "(14) A (1, 4)": {"kind": "finite_time"},
    "(14) A (1, 4) implicit": {"kind": "finite_time", "sampling": "implicit"},
    "(14) A (6, 10)": {"kind": "finite_time", "k1": 6.0, "k2": 10.0},
    "PD (8, 20)": {"kind": "finite_time", "alpha1": 1.0, "k1": 8.0, "k2": 20.0},
    "PD (6, 10)": {"kind": "finite_time", "alpha1": 1.0, "k1": 6.0, "k2": 10.0},
}
RANDOM = ("(28) implicit, beta .13", "(28) implicit, beta .15", "(14) A (1, 4)", "PD (8, 20)", "PD (6, 10)")


def show_settling() -> None:
    """Law (14), k1 = 6, k2 = 10, no limit."""
    print("| law | 1e-3 | 1e-5 | 1e-8 | 1e-11 | peak [N m] |\n|---|---|---|---|---|---|")
    for form, alpha1, until_s in (("A", 0.5, 30), ("B", 0.5, 30), ("C", 0.5, 30), ("A", 0.7, 50), ("A", 1.0, 240)):
        law = make_law({"kind": "finite_time", "form": form, "alpha1": alpha1, "k1": 6.0, "k2": 10.0})
        flown = fly_continuous(law, Body(), until_s, 1e-2, every=5)
        times = " | ".join(f"{flown.find_settling(level):.2f}" for level in (1e-3, 1e-5, 1e-8, 1e-11))
        print(f"| {form}, alpha1 {alpha1} | {times} | {np.abs(flown.tau_nm).max():.2f} |")


def _push(t_s: float) -> Vec3:
    d = 8.0 * math.sin(2.0 * math.pi * t_s)
    return (d, 1.2 * d, d)


def show_paper() -> None:
    """Law (28) in continuous time, 10 N m about each axis."""
    print("| law | 1e-3 | 1e-5 | disturbed: sigma | omega [rad/s] |\n|---|---|---|---|---|")
    for beta, weight, inertia in (
        (1.0, False, INERTIA),
        (0.5, False, INERTIA),
        (1.0, False, SMALL),
        (0.5, False, SMALL),
    ):
        settings = PAPER | {"beta": beta, "inertia_weight": weight, "sampling": "explicit"}
        found = []
        for disturbance in (no_torque, _push):
            law = make_law(settings, inertia_kgm2=inertia)
            found.append(fly_continuous(law, Body(inertia=inertia), 20.0, 1e-3, 10.0, disturbance, every=5))
        calm, pushed = found
        last = pushed.t_s > 14.0
        sigma, omega = np.abs(pushed.sigma[last]).max(), np.abs(pushed.omega_rad_s[last]).max()
        name = f"beta {beta:g}, {'J of this page' if inertia is INERTIA else 'the small J'}"
        print(
            f"| {name} | {calm.find_settling(1e-3):.2f} | {calm.find_settling(1e-5):.2f} | {sigma:.2g} | {omega:.2g} |"
        )


def show_small() -> None:
    """0.1 N m about each axis, 0.1 s, undisturbed and under two disturbances."""
    print("| law | .1 | .01 | .001 deg | left [deg] | torque [N m/s] | left, constant | left, sine |")
    print("|---|---|---|---|---|---|---|---|")
    torques: list[Torque] = [no_torque, lambda t: (2e-3, -2e-3, 1e-3), lambda t: scale(_push(t), 0.01)]
    for name, settings in WITH_SMALL_WHEELS.items():
        calm, constant, sine = (
            fly_sampled(make_law(settings), Body(), 240.0, disturbance=torque) for torque in torques
        )
        times = " | ".join(_tell(calm.find_settling_deg(level)) for level in (0.1, 0.01, 0.001))
        left = [f"{flown.find_error_deg()[-200:].max():.1e}" for flown in (calm, constant, sine)]
        print(f"| {name} | {times} | {left[0]} | {calm.find_variation(200.0, 240.0):.2g} | {left[1]} | {left[2]} |")


def _tell(time_s: float) -> str:
    return "never" if time_s == math.inf else f"{time_s:.1f}"


def show_latency() -> None:
    """What is left at 120 s with torques late by one and two periods [deg], and with a wrong inertia."""
    print("| law | late by | as modelled | J x 0.8 | J x 1.25 |\n|---|---|---|---|---|")
    for late in (1, 2):
        for name, settings in (
            ("(28) explicit", {"kind": "power_integrator", "sampling": "explicit"}),
            ("(28) implicit", {"kind": "power_integrator"}),
            ("(28) implicit, prediction", {"kind": "power_integrator", "latency": late}),
            ("(14) A (1, 4)", {"kind": "finite_time"}),
            ("(14) A (1, 4) implicit, prediction", {"kind": "finite_time", "sampling": "implicit", "latency": late}),
        ):
            left = []
            for k in (1.0, 0.8, 1.25):
                x, y, z = (scale(row, k) for row in INERTIA)
                flown = fly_sampled(make_law(settings), Body(inertia=(x, y, z)), 120.0, latency=late)
                left.append(f"{flown.find_error_deg()[-200:].max():.1e}")
            print(f"| {name} | {late} | {' | '.join(left)} |")


def show_noise() -> None:
    """What is left with noise of 5e-6 in sigma (4 arcsec) and 1e-5 rad/s, 1 sigma a sample."""
    print("| law | left [deg] | torque [N m/s] |\n|---|---|---|")
    for name in ("(28) implicit, beta .13", "(14) A (1, 4)", "(14) A (1, 4) implicit", "PD (6, 10)"):
        rng = np.random.default_rng(1)

        def noise(rng: np.random.Generator = rng) -> tuple[Vec3, Vec3]:
            a, b, c = (5e-6 * rng.normal(size=3)).tolist()
            d, e, f = (1e-5 * rng.normal(size=3)).tolist()
            return (a, b, c), (d, e, f)

        flown = fly_sampled(make_law(WITH_SMALL_WHEELS[name]), Body(), 240.0, noise=noise)
        left, variation = flown.find_error_deg()[-400:].max(), flown.find_variation(200.0, 240.0)
        print(f"| {name} | {left:.1e} | {variation:.2g} |")


def show_random() -> None:
    """Time to 0.01 deg from 40 random starts, true inertia 0.8 .. 1.2 times the modelled one."""
    print("| law | median | 10 % | 90 % | max |\n|---|---|---|---|---|")
    trials = draw_trials(40, 1)
    for name in RANDOM:
        found = find_trial_settling(WITH_SMALL_WHEELS[name], trials, 0.01, 220.0)
        print(f"| {name} | " + " | ".join(f"{x:.1f}" for x in np.percentile(found, [50, 10, 90, 100])) + " |")


def show_gains() -> None:
    """The least gain that the proof covers."""
    print("| beta [rad/s] | m_min [rad/s^2] | b |\n|---|---|---|")
    for beta in (0.05, 0.1, 0.13, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0):
        gain, weight = find_least_gain(beta)
        print(f"| {beta:g} | {gain:.4g} | {weight:.3g} |")


SHOWS: dict[str, Callable[[], None]] = {
    "settling": show_settling,
    "paper": show_paper,
    "small": show_small,
    "latency": show_latency,
    "noise": show_noise,
    "random": show_random,
    "gains": show_gains,
}


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", choices=list(SHOWS))
    SHOWS[parser.parse_args().table]()


if __name__ == "__main__":
    main()
