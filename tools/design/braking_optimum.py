"""Shortest time to rest at the target when every fault is known in advance: the `optimum_s` of the case files.

    pip install --group design
    python -m tools.design.braking_optimum                  every case of both files against its stored value
    python -m tools.design.braking_optimum random-03
    python -m tools.design.braking_optimum healthy          the published start, wheels aligned and healthy

Direct multiple shooting: 200 intervals of one RK4 step, wheel torques constant over an interval and within 0.1 N m,
free end time, solved by IPOPT from two guesses of the end time; fault edges smoothed over 0.15 s. A local optimum, so a
bound from above. CasADi is needed by this script only, hence a dependency group of its own.
"""

from __future__ import annotations

import importlib
import math
import sys
from typing import Any

import numpy as np

from tools.design.braking_cases import FRESH_FILE, INERTIA_KGM2, Case, find_axes, make_healthy, read_cases

INTERVALS = 200
EDGE_S = 0.15
LIMIT_NM = 0.1
GUESSES_S = (45.0, 60.0)


def find_optimum(case: Case, ca: Any) -> float:
    """Return the least end time found [s]; infinite when no guess converged. `ca` is the casadi module."""
    end = ca.MX.sym("end")
    states = ca.MX.sym("states", 7, INTERVALS + 1)
    commands = ca.MX.sym("commands", 4, INTERVALS)
    h = end / INTERVALS
    advance = _make_step(case, ca).map(INTERVALS)
    times = ca.horzcat(*[h * k for k in range(INTERVALS)])
    reached = advance(states[:, :-1], commands, times, ca.repmat(h, 1, INTERVALS))
    q0 = np.array(case.q0) / np.linalg.norm(case.q0)
    start = np.concatenate([q0, case.omega0_rad_s])
    defects = ca.vertcat(ca.vec(reached - states[:, 1:]), states[:, 0] - start, states[1:, -1])
    unknowns = ca.vertcat(end, ca.vec(states), ca.vec(commands))
    options = {"ipopt.print_level": 0, "print_time": 0, "ipopt.max_iter": 600, "ipopt.sb": "yes", "ipopt.tol": 1e-6}
    solver = ca.nlpsol("solver", "ipopt", {"x": unknowns, "f": end, "g": defects}, options)
    state_count, command_count = 7 * (INTERVALS + 1), 4 * INTERVALS
    low = np.concatenate([[5.0], np.full(state_count, -2.0), np.full(command_count, -LIMIT_NM)])
    high = np.concatenate([[200.0], np.full(state_count, 2.0), np.full(command_count, LIMIT_NM)])
    best = math.inf
    for guess_s in GUESSES_S:
        guess = np.concatenate([[guess_s], _guess_states(q0, guess_s).T.ravel(), np.zeros(command_count)])
        solution = solver(x0=guess, lbx=low, ubx=high, lbg=0, ubg=0)
        if solver.stats()["success"]:
            best = min(best, float(solution["f"]))
    return best


def _make_step(case: Case, ca: Any) -> Any:
    """One RK4 step of the plant as a function of state, command, start time and length."""
    inertia = np.array(INERTIA_KGM2)
    x, u, t, h = ca.MX.sym("x", 7), ca.MX.sym("u", 4), ca.MX.sym("t"), ca.MX.sym("h")
    q, w = x[:4], x[4:]
    torque = np.array(find_axes(case)) @ ca.vertcat(*[_act(case, i, u[i - 1], t, ca) for i in (1, 2, 3, 4)])
    slope = ca.vertcat(
        -0.5 * ca.dot(q[1:], w),
        0.5 * (ca.cross(q[1:], w) + q[0] * w),
        np.linalg.inv(inertia) @ (torque - ca.cross(w, inertia @ w)),
    )
    f = ca.Function("f", [x, u, t], [slope])
    k1 = f(x, u, t)
    k2 = f(x + h / 2 * k1, u, t + h / 2)
    k3 = f(x + h / 2 * k2, u, t + h / 2)
    k4 = f(x + h * k3, u, t + h)
    return ca.Function("step", [x, u, t, h], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])


def _act(case: Case, wheel: int, command: Any, t: Any, ca: Any) -> Any:
    """Torque of a wheel under its faults, edges smoothed."""
    share, bias = 1.0, 0.0
    for fault in case.faults:
        if fault.wheel != wheel:
            continue
        on = 0.5 * (1.0 + ca.tanh(2.0 * (t - fault.from_s) / EDGE_S))
        if math.isfinite(fault.until_s):
            on -= 0.5 * (1.0 + ca.tanh(2.0 * (t - fault.until_s) / EDGE_S))
        share = share * (1.0 - on * (1.0 - fault.effectiveness if fault.kind == "loss" else 1.0))
        if fault.kind == "stuck":
            bias = bias + on * fault.torque_nm
    return share * command + bias


def _guess_states(q0: np.ndarray, end_s: float) -> np.ndarray:
    """A smooth turn about the eigenaxis, shape (7, INTERVALS + 1)."""
    r = np.linspace(0.0, 1.0, INTERVALS + 1)
    angle = 2.0 * math.acos(min(1.0, abs(q0[0])))
    axis = np.sign(q0[0]) * q0[1:] / np.linalg.norm(q0[1:])
    left = angle * (1.0 - 3.0 * r**2 + 2.0 * r**3)
    rate = -angle * (6.0 * r - 6.0 * r**2) / end_s
    return np.vstack([np.cos(left / 2.0), np.outer(axis, np.sin(left / 2.0)), np.outer(axis, rate)])


def main(names: list[str]) -> int:
    """Print found and stored optimum of the named cases, or of all."""
    try:
        ca = importlib.import_module("casadi")
    except ImportError:
        print("this script needs CasADi: pip install --group design", file=sys.stderr)
        return 2
    cases = [*read_cases(), *read_cases(FRESH_FILE)]
    for case in [*cases, make_healthy(cases[0])]:
        if not names or case.id in names:
            print(f"{case.id:12s} found {find_optimum(case, ca):7.3f} s  stored {case.optimum_s:7.3f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
