"""The plant process: `python -P -m plant_server --config FILE`. People start it with `hilsat plant` or `hilsat run`."""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from bus.clock import claim_realtime
from bus.process import MEETING_PATIENCE_S, Progress, last_word, run_process
from bus.run import RunConfig
from bus.settings import build_file
from bus.telemetry.link import TelemetryLink
from bus.units import Vec4
from bus.wire.address import open_transport
from bus.wire.transport import Transport
from plant_server.channel import STATE_FAILED, STATE_STOPPED, PlantServer
from plant_server.config import FaultConfig, PlantConfig
from plant_server.handshake import meet_fsw
from plant_server.lockstep import LockStep
from plant_server.plant import Plant
from plant_server.plant_log import PlantLog
from plant_server.realtime import RealTime
from plant_server.truth import SOURCE


@dataclass(frozen=True, slots=True)
class PlantFile:
    """The file this process is started with."""

    run: RunConfig
    plant: PlantConfig
    faults: tuple[FaultConfig, ...] = ()
    target_q: Vec4 = (1.0, 0.0, 0.0, 0.0)  # only to log the true pointing error


def main(argv: list[str] | None = None) -> int:
    """Run the scenario's ticks; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m plant_server", description="hilsat plant process")
    parser.add_argument("--config", required=True, type=Path, help="resolved settings, as `hilsat` writes them")
    parser.add_argument("--telemetry-fd", type=int, help="write end of the recorder's pipe")
    parser.add_argument("--progress-fd", type=int, help="where to write progress as JSON lines")
    args = parser.parse_args(argv)
    progress = Progress(args.progress_fd)
    return run_process("plant", lambda: _serve(build_file(PlantFile, args.config), args.telemetry_fd, progress))


def _serve(config: PlantFile, telemetry_fd: int | None, progress: Progress) -> None:
    run = config.run
    tick_s = run.tick_ns * 1e-9
    server = PlantServer(Plant(config.plant, config.faults, tick_s, run.seed, config.target_q), tick_s, run.run_hash)
    link = TelemetryLink(telemetry_fd, SOURCE, blocking=run.clock.mode != "realtime")
    log = PlantLog(server, link, run.tick_ns, stamped=run.bus.address.startswith("socketcan:"))
    transport = open_transport(run.bus.address, node="plant", host=True, bitrate_bps=run.bus.bitrate_bps)
    with last_word(
        "plant", transport, link, progress,
        lambda failed: server.heartbeat(STATE_FAILED if failed else STATE_STOPPED),
        lambda: server.tick * run.tick_ns,
    ):  # fmt: skip
        progress.say(state="waiting", bus=transport.address)
        meet_fsw(transport, server, run.run_hash, MEETING_PATIENCE_S)
        progress.say(state="running")
        started_s = time.monotonic()
        _loop(run, server, transport, log, progress)
        progress.say(running_s=time.monotonic() - started_s)


def _loop(run: RunConfig, server: PlantServer, transport: Transport, log: PlantLog, progress: Progress) -> None:
    if run.clock.mode != "realtime":
        LockStep(server, transport, log, progress).run(run.ticks)
        return
    scheduling = claim_realtime()
    log.link.event(0, "info", "plant", f"scheduling: {scheduling}")
    loop = RealTime(server, transport, log, progress, run.tick_ns)
    loop.run(run.ticks)
    progress.say(plant_slips=loop.slips, plant_max_lateness_us=loop.max_lateness_ns / 1e3, scheduling=scheduling)


if __name__ == "__main__":
    sys.exit(main())
