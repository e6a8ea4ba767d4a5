"""Runs a scenario in one process and logs it: the fastest way, and the same bytes as two processes in lock-step."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from pathlib import Path

from bus.errors import RecordError
from tools.config.scenario import Resolved
from tools.ground.launch import GatewayPlan, end_gateway
from tools.run.bench import Bench
from tools.run.run_file import RunFile, describe_bench, write_run_file
from tools.run.runner import RunReport, make_private


def run_in_process(
    resolved: Resolved, out_dir: Path, on_progress: Callable[[int], None], gateway: GatewayPlan | None = None
) -> RunReport:
    """Run the scenario and log it; return how it ended. Raises RecordError when the log cannot be written.

    gateway : the links to ground stations, another process; None: no gateway
    """
    out_dir.mkdir(parents=True, exist_ok=True)
    report = RunReport(out_dir / "run.mcap", 3)
    with contextlib.ExitStack() as stack:
        has_sockets = gateway is not None or resolved.scenario.inject == "allowed"
        private = _enter_private(stack, has_sockets)
        started_s = time.monotonic()
        bench = Bench(resolved, log=report.log, ground_dir=private if has_sockets else None)
        if private is not None:
            described = describe_bench(resolved, private, address="in process", out=out_dir, linked=gateway is not None)
            write_run_file(private, described)
            if gateway is not None:
                _start_gateway(stack, gateway, private, described, report)
        _fly(bench, resolved.ticks, on_progress, report, started_s)
    report.wall_s = time.monotonic() - started_s
    return report


def _fly(bench: Bench, ticks: int, on_progress: Callable[[int], None], report: RunReport, started_s: float) -> None:
    reason = "failed"  # the last ticks before a failure are those that tell of it
    try:
        report.first_cycle_s = time.monotonic() - started_s
        bench.step(ticks, on_progress)
        reason = "done"
        report.exit_code, report.ticks = 0, ticks
    except KeyboardInterrupt:
        reason = "interrupted"
        report.exit_code = 130
        report.problems.append("interrupted; the log is closed properly")
    finally:
        bench.close(reason)


def _enter_private(stack: contextlib.ExitStack, needed: bool) -> Path | None:
    """A directory for what the bench says of itself; None where there is no place for one and nothing else needs it."""
    try:
        return stack.enter_context(make_private())
    except RecordError:
        if needed:
            raise
        return None


def _start_gateway(
    stack: contextlib.ExitStack, plan: GatewayPlan, private: Path, bench: RunFile, report: RunReport
) -> None:
    process = plan.start(private, bench)
    stack.callback(lambda: report.notes.extend(end_gateway(process)))
