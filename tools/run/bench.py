"""Runs a scenario in one process: the same frames, encoded, checked and decoded, passed from hand to hand.

The fastest way to run one, and the one for campaigns and tests. What it logs is what the two processes log.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from pathlib import Path

from bus.errors import RecordError
from bus.telemetry.link import Link, TelemetryLink
from fsw.flight import Flight
from fsw.flight_log import FlightLog
from fsw.telemetry import SOURCE as FSW_SOURCE
from plant_server.node import PlantNode
from plant_server.pacing import Accept
from plant_server.plant import Plant
from plant_server.truth import SOURCE as PLANT_SOURCE
from tools.config.scenario import Resolved
from tools.log.recorder import Recorder
from tools.run.provenance import describe_run, list_attachments
from tools.run.runner import RunReport


class Bench:
    """Both sides of a scenario in this process, one tick at a time."""

    def __init__(self, resolved: Resolved, plant_link: Link | None = None, fsw_link: Link | None = None) -> None:
        """plant_link, fsw_link: where telemetry goes; None: nowhere."""
        scenario = resolved.scenario
        self._tick_ns = 1_000_000_000 // scenario.clock.tick_hz
        tick_s = self._tick_ns * 1e-9
        plant = Plant(scenario.plant, scenario.faults, tick_s, scenario.seed)
        link = plant_link or TelemetryLink(None, PLANT_SOURCE, False)
        self.node = PlantNode(plant, link, self._tick_ns, resolved.run_hash)
        self.flight = Flight(scenario.fsw, tick_s, resolved.run_hash)
        self._flight_log = FlightLog(self.flight, fsw_link or TelemetryLink(None, FSW_SOURCE, False), self._tick_ns)

    def run(self, ticks: int, on_progress: Callable[[int], None] | None = None) -> None:
        """Run that many ticks from where the bench stands."""
        node, flight, flight_log = self.node, self.flight, self._flight_log
        counters = flight.executive

        def exchange(frames: bytes, accept: Accept) -> bytes:
            answer = flight.cycle(tick, frames)
            accept(answer)
            return answer

        for tick in range(node.tick_number, node.tick_number + ticks):
            node.tick(exchange)
            counters.cycles += 1
            flight_log.write(tick)
            if on_progress is not None and not tick % 100:
                on_progress(tick)


def run_in_process(resolved: Resolved, out_dir: Path, on_progress: Callable[[int], None]) -> RunReport:
    """Run the scenario and log it; return how it ended. Raises RecordError when the log cannot be written."""
    out_dir.mkdir(parents=True, exist_ok=True)
    report = RunReport(out_dir / "run.mcap", 3)
    started_s = time.monotonic()
    recorder = Recorder(
        report.log, metadata=describe_run(resolved, "in process"), attachments=list_attachments(resolved)
    )
    plant_link, fsw_link = recorder.link(PLANT_SOURCE), recorder.link(FSW_SOURCE)
    reason = "failed"
    try:
        bench = Bench(resolved, plant_link, fsw_link)
        report.first_cycle_s = time.monotonic() - started_s
        bench.run(resolved.ticks, on_progress)
        plant_link.close("done")
        fsw_link.close("done")
        report.exit_code, report.ticks = 0, resolved.ticks
    except KeyboardInterrupt:
        reason = "interrupted"
        report.exit_code = 130
        report.problems.append("interrupted; the log is closed properly")
    finally:  # the last ticks before a failure are those that tell of it
        for link in (plant_link, fsw_link):
            with contextlib.suppress(RecordError):
                link.close(reason)
        recorder.close()
    report.wall_s = time.monotonic() - started_s
    return report
