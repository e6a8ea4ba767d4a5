"""The same 300 s in Basilisk's own Monte-Carlo pool: a rigid body with four reaction wheels, RK4 at 10 ms, no frames.

Each run has another initial rate, as a dispersion of its Controller. Runs as a program of its own, with nothing of ours,
in whatever interpreter has Basilisk; prints runs per second of processor time as JSON, without imports.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import tempfile
import time
from typing import Any

RUNS, WORKERS, SECONDS = 12, 2, 300.0


def make() -> Any:
    """One simulation, not yet begun."""
    from Basilisk.simulation import reactionWheelStateEffector, spacecraft
    from Basilisk.utilities import SimulationBaseClass, macros, simIncludeRW

    sim = SimulationBaseClass.SimBaseClass()
    process = sim.CreateNewProcess("process")
    process.addTask(sim.CreateNewTask("task", macros.sec2nano(0.01)))
    body = spacecraft.Spacecraft()
    body.hub.mHub = 100.0
    body.hub.IHubPntBc_B = [[45, 3, 2], [3, 38, -1.5], [2, -1.5, 50]]
    body.hub.omega_BN_BInit = [[0.0089], [0.0052], [0.00016]]
    sim.AddModelToTask("task", body)
    factory = simIncludeRW.rwFactory()
    s = 3**-0.5
    for axis in ([1, 0, 0], [0, 1, 0], [0, 0, 1], [s, s, s]):
        factory.create("custom", axis, Js=0.01, Omega_max=6000.0, u_max=0.1, useMaxTorque=True)
    effector = reactionWheelStateEffector.ReactionWheelStateEffector()
    factory.addToSpacecraft("wheels", effector, body)
    sim.AddModelToTask("task", effector)
    sim.body, sim.factory, sim.effector = body, factory, effector  # kept alive, and reached by the dispersion
    return sim


def execute(sim: Any) -> None:
    """Fly it."""
    from Basilisk.utilities import macros

    sim.InitializeSimulation()
    sim.ConfigureStopTime(macros.sec2nano(SECONDS))
    sim.ExecuteSimulation()


def main() -> None:
    """Fly RUNS of them by WORKERS processes."""
    from Basilisk.simulation import reactionWheelStateEffector, spacecraft  # noqa: F401 (what the runs import)
    from Basilisk.utilities.MonteCarlo.Controller import Controller
    from Basilisk.utilities.MonteCarlo.Dispersions import UniformVectorDispersion

    pool = Controller()
    pool.setSimulationFunction(make)
    pool.setExecutionFunction(execute)
    pool.setExecutionCount(RUNS)
    pool.setThreadCount(WORKERS)
    pool.setShouldDisperseSeeds(False)
    pool.setVerbose(False)
    with tempfile.TemporaryDirectory() as directory, contextlib.redirect_stdout(sys.stderr):
        pool.setArchiveDir(os.path.join(directory, "archive"))
        pool.addDispersion(UniformVectorDispersion("body.hub.omega_BN_BInit", [-0.01, 0.01]))
        before, started_s = sum(os.times()[:4]), time.perf_counter()
        failures = pool.executeSimulations()
        spent_s, wall_s = sum(os.times()[:4]) - before, time.perf_counter() - started_s
    if failures:
        sys.exit(f"{len(failures)} runs failed")
    print(json.dumps({"runs_per_cpu_s": RUNS / spent_s, "wall_s": wall_s}))


if __name__ == "__main__":
    main()
