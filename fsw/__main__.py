"""The flight-software process: `python -P -m fsw --config FILE`. People start it with `hilsat fsw` or `hilsat run`."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType

from bus.clock import claim_realtime
from bus.errors import ConfigError, HilsatError
from bus.settings import RunConfig, build
from bus.telemetry import TelemetryLink, TickPacker, announce_topics
from bus.transport import Transport, open_transport
from fsw.config import FswConfig
from fsw.executive import Executive, Watchdog
from fsw.flight import Flight
from fsw.handshake import meet_plant
from fsw.lockstep import LockStep
from fsw.outputs import STATE_FAILED, STATE_STOPPED
from fsw.realtime import RealTime
from fsw.telemetry import FIRST_CHANNEL, SOURCE

MEETING_PATIENCE_S = 10.0


class Interrupted(Exception):
    """SIGINT or SIGTERM arrived; carries the signal's number."""


@dataclass(frozen=True, slots=True)
class FswFile:
    """The file this process is started with."""

    run: RunConfig
    fsw: FswConfig


def main(argv: list[str] | None = None) -> int:
    """Run until the plant stops; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m fsw", description="hilsat flight software process")
    parser.add_argument("--config", required=True, type=Path, help="resolved settings, as `hilsat` writes them")
    parser.add_argument("--telemetry-fd", type=int, help="write end of the recorder's pipe")
    parser.add_argument("--progress-fd", type=int, help="where to say at the end how the bus was, as a JSON line")
    args = parser.parse_args(argv)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    try:
        config = _load(args.config)
        _fly(config, args.telemetry_fd, args.progress_fd)
    except Interrupted as stop:
        return 128 + int(stop.args[0])
    except HilsatError as error:
        print(f"fsw: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise Interrupted(number)


def _load(path: Path) -> FswFile:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot read the flight software's settings: {error}") from None
    return build(FswFile, data, str(path))


def _fly(config: FswFile, telemetry_fd: int | None, progress_fd: int | None = None) -> None:
    run = config.run
    flight = Flight(config.fsw, run.tick_ns * 1e-9, run.run_hash)
    realtime = run.clock.mode == "realtime"
    link = TelemetryLink(telemetry_fd, SOURCE, blocking=not realtime)
    link.announce(announce_topics([TickPacker(flight.topics, FIRST_CHANNEL)]))
    reason = "failed"
    with contextlib.closing(open_transport(run.bus.address, node="fsw", bitrate_bps=run.bus.bitrate_bps)) as transport:
        try:
            meet_plant(transport, flight.outputs, run.run_hash, MEETING_PATIENCE_S)
            _loop(config, flight, transport, link, realtime)
            reason = "done"
        except Interrupted:
            reason = "interrupted"
            raise
        except HilsatError as error:
            link.event(0, "error", "fsw", str(error))
            raise
        finally:
            with contextlib.suppress(HilsatError, OSError):
                transport.send(flight.outputs.heartbeat(STATE_FAILED if reason == "failed" else STATE_STOPPED))
            if progress_fd is not None:
                with contextlib.suppress(OSError):  # nobody listening is no error
                    os.write(progress_fd, json.dumps({"fsw_bus": asdict(transport.counters)}).encode() + b"\n")
            if transport.counters.lossy:
                link.event(0, "warning", "fsw", transport.counters.describe())
            link.close(reason)


def _loop(config: FswFile, flight: Flight, transport: Transport, link: TelemetryLink, realtime: bool) -> None:
    tick_ns = config.run.tick_ns
    if not realtime:
        LockStep(flight, transport, link, tick_ns).run()
        return
    settings = config.fsw.executive
    executive = Executive(tick_ns, settings.overrun, settings.max_consecutive_slips)
    link.event(0, "info", "fsw", f"scheduling: {claim_realtime()}")
    RealTime(flight, executive, Watchdog(int(settings.watchdog_s * 1e9)), transport, link).run()


if __name__ == "__main__":
    sys.exit(main())
