"""The flight-software process: `python -P -m fsw --config FILE`. People start it with `hilsat fsw` or `hilsat run`."""

from __future__ import annotations

import argparse
import contextlib
import sys
from dataclasses import dataclass
from pathlib import Path

from bus.clock import SystemClock, claim_realtime
from bus.icd.heartbeat import FAILED, STOPPED
from bus.process import MEETING_PATIENCE_S, Progress, last_word, run_process
from bus.run import GroundConfig, RunConfig
from bus.settings import build_file
from bus.telemetry.link import TelemetryLink
from bus.wire.address import open_transport
from bus.wire.transport import Transport
from fsw.config import FswConfig
from fsw.executive import Executive, Watchdog
from fsw.flight import Flight
from fsw.guidance.timeline import make_command
from fsw.handshake import meet_plant
from fsw.node import FswNode
from fsw.pacing import LockStep, RealTime
from fsw.telemetry import SOURCE


@dataclass(frozen=True, slots=True)
class FswFile:
    """The file this process is started with."""

    run: RunConfig
    fsw: FswConfig
    ground: GroundConfig | None = None  # no socket for the ground


def main(argv: list[str] | None = None) -> int:
    """Run until the plant stops; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m fsw", description="hilsat flight software process")
    parser.add_argument("--config", required=True, type=Path, help="resolved settings, as `hilsat` writes them")
    parser.add_argument("--telemetry-fd", type=int, help="write end of the recorder's pipe")
    parser.add_argument("--progress-fd", type=int, help="where to say at the end how the bus was, as a JSON line")
    args = parser.parse_args(argv)
    return run_process("fsw", lambda: _fly(build_file(FswFile, args.config), args.telemetry_fd, args.progress_fd))


def _fly(config: FswFile, telemetry_fd: int | None, progress_fd: int | None) -> None:
    run = config.run
    tick_s = run.tick_ns * 1e-9
    flight = Flight(config.fsw, tick_s, run.run_hash)
    link = TelemetryLink(telemetry_fd, SOURCE, blocking=run.clock.mode != "realtime")
    timeline = [make_command(entry, tick_s) for entry in config.fsw.timeline]
    node = FswNode(flight, link, run.tick_ns, SystemClock(), timeline)
    with contextlib.ExitStack() as stack:
        if config.ground is not None:
            from fsw.ground import open_ground  # a run without it is not to wait for the dialect

            stack.callback(open_ground(node, config.ground, SystemClock()).close)
        transport = open_transport(run.bus.address, node="fsw", bitrate_bps=run.bus.bitrate_bps)
        stack.enter_context(last_word(
            "fsw", transport, link, Progress(progress_fd),
            lambda failed: flight.outputs.heartbeat(FAILED if failed else STOPPED),
            lambda: flight.executive.cycles * run.tick_ns,
        ))  # fmt: skip
        meet_plant(transport, flight.outputs, run.run_hash, MEETING_PATIENCE_S)
        _loop(config, node, transport)


def _loop(config: FswFile, node: FswNode, transport: Transport) -> None:
    run, clock = config.run, SystemClock()
    if run.clock.mode != "realtime":
        LockStep(node, transport, clock, run.ticks).run()
        return
    settings = config.fsw.executive
    executive = Executive(run.tick_ns, settings.overrun, settings.max_consecutive_slips, clock)
    node.log.link.event(0, "info", "fsw", f"scheduling: {claim_realtime()}")
    watchdog = Watchdog(int(settings.watchdog_s * 1e9), clock)
    RealTime(node, executive, watchdog, transport, clock, run.ticks).run()


if __name__ == "__main__":
    sys.exit(main())
