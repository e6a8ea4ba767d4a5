"""The plant process: `python -P -m plant_server --config FILE`. People start it with `hilsat plant` or `hilsat run`."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType

from bus.clock import claim_realtime
from bus.errors import ConfigError, HilsatError
from bus.settings import RunConfig, build
from bus.telemetry import TelemetryLink
from bus.transport import Transport, open_transport
from bus.units import Vec4
from plant_server.config import FaultConfig, PlantConfig
from plant_server.handshake import meet_fsw
from plant_server.lockstep import LockStep
from plant_server.plant import Plant
from plant_server.realtime import RealTime
from plant_server.server import STATE_FAILED, STATE_STOPPED, PlantServer
from plant_server.telemetry import PlantLog
from plant_server.truth import SOURCE

MEETING_PATIENCE_S = 10.0
PROGRESS_EVERY_S = 0.2


class Interrupted(Exception):
    """SIGINT or SIGTERM arrived; carries the signal's number."""


@dataclass(frozen=True, slots=True)
class PlantFile:
    """The file this process is started with."""

    run: RunConfig
    plant: PlantConfig
    faults: tuple[FaultConfig, ...] = ()
    target_q: Vec4 = (1.0, 0.0, 0.0, 0.0)  # only to log the true pointing error


class Progress:
    """Tells whoever started us how far the run is, at most every PROGRESS_EVERY_S, as JSON lines on a descriptor."""

    def __init__(self, fd: int | None) -> None:
        self._fd = fd
        self._next_s = 0.0

    def __call__(self, tick: int) -> None:
        if self._fd is None or tick & 15:
            return
        now_s = time.monotonic()
        if now_s >= self._next_s:
            self._next_s = now_s + PROGRESS_EVERY_S
            self.say(tick=tick)

    def say(self, **what: object) -> None:
        """One JSON line; nobody listening is no error."""
        if self._fd is not None:
            with contextlib.suppress(OSError):
                os.write(self._fd, json.dumps(what).encode() + b"\n")


def main(argv: list[str] | None = None) -> int:
    """Run the scenario's ticks; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m plant_server", description="hilsat plant process")
    parser.add_argument("--config", required=True, type=Path, help="resolved settings, as `hilsat` writes them")
    parser.add_argument("--telemetry-fd", type=int, help="write end of the recorder's pipe")
    parser.add_argument("--progress-fd", type=int, help="where to write progress as JSON lines")
    args = parser.parse_args(argv)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    try:
        config = _load(args.config)
        _serve(config, args.telemetry_fd, Progress(args.progress_fd))
    except Interrupted as stop:
        return 128 + int(stop.args[0])
    except HilsatError as error:
        print(f"plant: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise Interrupted(number)


def _load(path: Path) -> PlantFile:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot read the plant's settings: {error}") from None
    return build(PlantFile, data, str(path))


def _serve(config: PlantFile, telemetry_fd: int | None, progress: Progress) -> None:
    run = config.run
    tick_s = run.tick_ns * 1e-9
    server = PlantServer(Plant(config.plant, config.faults, tick_s, run.seed, config.target_q), tick_s, run.run_hash)
    link = TelemetryLink(telemetry_fd, SOURCE, blocking=run.clock.mode != "realtime")
    log = PlantLog(server, link, run.tick_ns, stamped=run.bus.address.startswith("socketcan:"))
    reason = "failed"
    with contextlib.closing(
        open_transport(run.bus.address, node="plant", host=True, bitrate_bps=run.bus.bitrate_bps)
    ) as transport:
        try:
            progress.say(state="waiting", bus=transport.address)
            meet_fsw(transport, server, run.run_hash, MEETING_PATIENCE_S)
            progress.say(state="running")
            started_s = time.monotonic()
            _loop(run, server, transport, log, progress)
            progress.say(running_s=time.monotonic() - started_s)
            reason = "done"
        except Interrupted:
            reason = "interrupted"
            raise
        except HilsatError as error:
            link.event(server.tick * run.tick_ns, "error", "plant", str(error))
            raise
        finally:
            with contextlib.suppress(HilsatError, OSError):
                transport.send(server.heartbeat(STATE_FAILED if reason == "failed" else STATE_STOPPED))
            progress.say(plant_bus=asdict(transport.counters))
            if transport.counters.lossy:
                link.event(server.tick * run.tick_ns, "warning", "plant", transport.counters.describe())
            link.close(reason)


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
