"""The plant process: `python -P -m plant_server --config FILE`. People start it with `hilsat plant` or `hilsat run`."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from bus.clock import MonotonicClock, SystemClock, claim_realtime
from bus.icd.heartbeat import FAILED, STOPPED
from bus.process import MEETING_PATIENCE_S, Progress, last_word, run_process
from bus.run import GroundConfig, RunConfig
from bus.settings import build_file
from bus.telemetry.link import TelemetryLink
from bus.wire.address import open_transport
from bus.wire.transport import Transport
from plant_server.config import PlantConfig
from plant_server.faults import Fault
from plant_server.handshake import meet_fsw
from plant_server.node import PlantNode
from plant_server.pacing import Exchange, LockStep, RealTime
from plant_server.plant import Plant
from plant_server.truth import SOURCE


@dataclass(frozen=True, slots=True)
class PlantFile:
    """The file this process is started with."""

    run: RunConfig
    plant: PlantConfig
    faults: tuple[Fault, ...] = ()
    ground: GroundConfig | None = None  # no socket for commands and telemetry


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
    run, clock = config.run, SystemClock()
    plant = Plant(config.plant, config.faults, run.tick_ns * 1e-9, run.seed)
    link = TelemetryLink(telemetry_fd, SOURCE, blocking=run.clock.mode != "realtime")
    stamped = run.bus.address.startswith("socketcan:")
    node = PlantNode(plant, link, run.tick_ns, run.run_hash, stamped=stamped, bus=run.bus)
    transport = open_transport(run.bus.address, node="plant", host=True, bitrate_bps=run.bus.bitrate_bps)
    with last_word(
        "plant", transport, link, progress,
        lambda failed: node.channel.heartbeat(FAILED if failed else STOPPED),
        lambda: node.tick_number * run.tick_ns,
    ), _ground_of(node, config, clock):  # fmt: skip
        progress.say(state="waiting", bus=transport.address)
        meet_fsw(transport, node.channel, run.run_hash, MEETING_PATIENCE_S, clock)
        progress.say(state="running")
        started_ns = clock.now_ns()
        if run.clock.mode == "realtime":
            _run_realtime(node, transport, clock, run, progress)
        else:
            _run_ticks(node, LockStep(transport, clock, node.log).exchange, run.ticks, progress)
        progress.say(running_s=(clock.now_ns() - started_ns) * 1e-9)


@contextlib.contextmanager
def _ground_of(node: PlantNode, config: PlantFile, clock: MonotonicClock) -> Iterator[None]:
    """Keep the socket for commands open, where the run has one."""
    if config.ground is None:
        yield
        return
    from plant_server.ground import open_ground  # a run without it is not to wait for the dialect

    ground = open_ground(node, config.ground, clock, name=config.run.name, ticks=config.run.ticks)
    try:
        yield
    finally:
        ground.close()


def _run_realtime(
    node: PlantNode, transport: Transport, clock: MonotonicClock, run: RunConfig, progress: Progress
) -> None:
    scheduling = claim_realtime()
    node.log.link.event(0, "info", "plant", f"scheduling: {scheduling}")
    pacing = RealTime(transport, clock, run.tick_ns, node.log)
    _run_ticks(node, pacing.exchange, run.ticks, progress)
    progress.say(plant_slips=pacing.slips, plant_max_lateness_us=pacing.max_lateness_ns / 1e3, scheduling=scheduling)


def _run_ticks(node: PlantNode, exchange: Exchange, ticks: int, progress: Progress) -> None:
    for tick in range(ticks):
        node.tick(exchange)
        progress(tick)


if __name__ == "__main__":
    sys.exit(main())
