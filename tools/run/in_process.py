"""Runs a scenario in one process and logs it: the fastest way, and the same bytes as two processes in lock-step."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from tools.config.scenario import Resolved
from tools.run.bench import Bench
from tools.run.runner import RunReport


def run_in_process(resolved: Resolved, out_dir: Path, on_progress: Callable[[int], None]) -> RunReport:
    """Run the scenario and log it; return how it ended. Raises RecordError when the log cannot be written."""
    out_dir.mkdir(parents=True, exist_ok=True)
    report = RunReport(out_dir / "run.mcap", 3)
    started_s = time.monotonic()
    bench = Bench(resolved, log=report.log)
    reason = "failed"  # the last ticks before a failure are those that tell of it
    try:
        report.first_cycle_s = time.monotonic() - started_s
        bench.step(resolved.ticks, on_progress)
        reason = "done"
        report.exit_code, report.ticks = 0, resolved.ticks
    except KeyboardInterrupt:
        reason = "interrupted"
        report.exit_code = 130
        report.problems.append("interrupted; the log is closed properly")
    finally:
        bench.close(reason)
    report.wall_s = time.monotonic() - started_s
    return report
