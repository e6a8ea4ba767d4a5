"""What a finished run comes to: summary, grade, picture, exit code."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bus.errors import HilsatError
from tools.config.scenario import Resolved
from tools.foxglove.scene_log import add_scene, make_scene
from tools.grading.grade import Grade, format_grade, grade_run, to_json
from tools.log.mcap_reader import Run, read_run
from tools.log.mcap_writer import McapWriter
from tools.run.runner import RunReport


@dataclass(slots=True)
class Conclusion:
    """A finished run, graded."""

    scenario: str
    report: RunReport
    grade: Grade | None = None
    picture: Path | None = None
    figures: dict[str, Any] = field(default_factory=dict)

    @property
    def exit_code(self) -> int:
        """0 passed, 1 graded a fail, else what ended the run."""
        if self.report.exit_code:
            return self.report.exit_code
        return 0 if self.grade is not None and self.grade.passed else 1

    def as_dict(self) -> dict[str, Any]:
        """In JSON types."""
        report = asdict(self.report) | {"log": str(self.report.log)}
        return {
            "scenario": self.scenario,
            "exit_code": self.exit_code,
            "grade": None if self.grade is None else self.grade.as_dict(),
            "picture": None if self.picture is None else str(self.picture),
            "figures": self.figures,
            "run": report,
        }

    def as_text(self) -> str:
        """For people."""
        lines = []
        if self.figures:
            lines.append("summary")
            lines += [f"  {name:<34} {value}" for name, value in self.figures.items()]
        if self.grade is not None:
            lines += ["grade", format_grade(self.grade)]
        if self.report.log.exists() and self.figures:
            lines.append(f"log      {self.report.log}")
        if self.picture is not None:
            lines.append(f"picture  {self.picture}")
        return "\n".join(lines)


def conclude(resolved: Resolved, report: RunReport, draw: bool = True, scene: bool = True) -> Conclusion:
    """Grade the log, add grade and scene to it, draw it, sum it up. A run that broke is summed up as far as it got.

    One that broke before its first tick has nothing to sum up: why it broke is all there is to say.
    """
    result = Conclusion(resolved.scenario.name, report)
    try:
        run = read_run(report.log)
        if report.exit_code and not run.has("/truth/attitude"):
            return result
        result.figures = _sum_up(run, resolved, report)
        result.grade = grade_run(run, resolved)
        if report.exit_code == 0:
            shown = make_scene(run, resolved.scenario.plant.wheels) if scene else []
            writer = McapWriter.resume(report.log)  # from here to close() the file has no end: all is ready before
            writer.add_attachment("grade.json", "application/json", to_json(result.grade).encode())
            if shown:
                add_scene(writer, shown)
            writer.close()
        if draw:
            from tools.report.plot import draw_run

            result.picture = draw_run(run, resolved, report.log.with_suffix(".png"))
    except HilsatError as error:
        report.problems.append(str(error))
        report.exit_code = report.exit_code or error.exit_code
    return result


def _sum_up(run: Run, resolved: Resolved, report: RunReport) -> dict[str, Any]:
    figures: dict[str, Any] = {"simulated": f"{report.ticks / resolved.scenario.clock.tick_hz:g} s"}
    figures["wall time"] = f"{report.wall_s:.2f} s"
    if report.first_cycle_s is not None:
        figures["start to first cycle"] = f"{report.first_cycle_s:.2f} s"
    if report.memory_mb:
        both = sum(mb for name, mb in report.memory_mb.items() if name != "recorder")
        figures["peak memory, plant + flight software"] = f"{both:.0f} MB"
    if run.has("/truth/attitude"):
        error_deg = run.signals("/truth/attitude")["error_deg"]
        t_s = run.t_ns("/truth/attitude") * 1e-9
        for bound in (5.0, 1.0, 0.1, 0.01):
            above = np.flatnonzero(error_deg > bound)
            settled = f"{t_s[above[-1]]:.1f} s" if above.size else "0 s"
            if above.size and above[-1] == error_deg.size - 1:
                settled = "not settled"
            figures[f"pointing error stays below {bound:g} deg"] = settled
        figures["final pointing error"] = f"{error_deg[-1]:.2g} deg"
    figures["faults that took effect"] = sum(record["phase"] == "effect" for record in run.faults)
    figures |= _sum_up_executive(run, resolved)
    figures |= _sum_up_bus(report)
    figures["digest of the run"] = run.digest()[:16]
    return figures


def _sum_up_bus(report: RunReport) -> dict[str, Any]:
    """What each side says of its attachment to the bus; nothing for a run without one."""
    sides = {"plant": report.details.get("plant_bus"), "flight software": report.details.get("fsw_bus")}
    told = {name: bus for name, bus in sides.items() if bus}
    if not told:
        return {}
    figures = {"frames lost in receive buffers": ", ".join(f"{name} {bus['dropped']}" for name, bus in told.items())}
    for key, title in (
        ("tx_failed", "frames not sent"),
        ("error_frames", "error frames"),
        ("fd_frames", "CAN FD frames"),
    ):
        if any(bus[key] for bus in told.values()):
            figures[title] = ", ".join(f"{name} {bus[key]}" for name, bus in told.items())
    return figures


def _sum_up_executive(run: Run, resolved: Resolved) -> dict[str, Any]:
    if not run.has("/fsw/timing"):
        return {}
    timing = run.signals("/fsw/timing")
    figures: dict[str, Any] = {}
    cycle_us = timing["cycle_us"][1:]
    if cycle_us.size and not math.isclose(float(cycle_us.max()), 0.0):
        p50, p99 = np.percentile(cycle_us, [50, 99])
        figures["flight cycle, wall"] = f"p50 {p50:.0f} us, p99 {p99:.0f} us, max {cycle_us.max():.0f} us"
    if resolved.scenario.clock.mode == "realtime":
        p50, p99, p999 = np.percentile(timing["lateness_us"], [50, 99, 99.9])
        figures["wake-up latency"] = (
            f"p50 {p50:.0f} us, p99 {p99:.0f} us, p99.9 {p999:.0f} us, max {timing['lateness_us'].max():.0f} us"
        )
        slips = int(run.signals("/fsw/executive")["slips"][-1])
        figures["cycle slips"] = slips
        notes = [event["message"].removeprefix("scheduling: ") for event in run.events if "SCHED_" in event["message"]]
        figures["scheduling"] = "; ".join(sorted(set(notes))) or "unknown"
    return figures
