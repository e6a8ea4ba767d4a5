"""What a report says of one run, gathered from its log alone."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from bus.errors import HilsatError
from tools.config.expect import EventCount, Expectation, Isolates
from tools.config.scenario import Resolved
from tools.grading.expressions import evaluate
from tools.grading.grade import Grade, grade_run, scenario_of
from tools.log.mcap_reader import Run, read_run
from tools.report.info import LogInfo, collect_info
from tools.report.page import charts

WORST_FRAME_BITS: Final = 135  # eight bytes, 11-bit id, as many stuff bits as there can be
COUNTERS: Final = {
    "/plant/channel": ("refused", "foreign", "too_old", "timeouts", "rivals"),
    "/fsw/executive": (
        "refused",
        "foreign",
        "implausible",
        "unit_fault",
        "rivals",
        "slips",
        "skipped",
        "torques_saturated",
    ),
}


@dataclass(slots=True)
class Chart:
    """One picture with its caption."""

    title: str
    svg: str = ""
    note: str = ""  # in place of a picture: why there is none


@dataclass(slots=True)
class Section:
    """One run in a report."""

    number: int
    info: LogInfo
    grade: Grade
    title: str
    scenario_yaml: str
    signals: list[Chart] = field(default_factory=list)
    timelines: list[Chart] = field(default_factory=list)
    cycles: Chart | None = None
    counters: list[tuple[str, str, int]] = field(default_factory=list)  # side, what, how many
    zeros: list[str] = field(default_factory=list)  # what was counted and never happened
    load: str = ""
    events: list[tuple[float, str, str]] = field(default_factory=list)  # s, who, what

    def charts(self) -> list[Chart]:
        """All pictures, in the order of the page."""
        return [*self.signals, *self.timelines, *([self.cycles] if self.cycles else [])]


def gather(path: Path, number: int) -> Section:
    """Everything that is said of a log. Raises RecordError or ConfigError where it cannot be graded."""
    run = read_run(path)
    resolved = scenario_of(run, path)
    grade = grade_run(run, resolved)
    info = collect_info(run)
    section = Section(number, info, grade, resolved.scenario.title, resolved.to_yaml())
    section.signals = _draw_signals(run, resolved, info)
    section.timelines = _draw_timelines(run, info)
    section.cycles = _draw_cycles(run)
    counted = list(_read_counters(run))
    section.counters = [row for row in counted if row[2]]
    section.zeros = [f"{side} {what}" for side, what, count in counted if not count]
    section.load = _describe_load(run, resolved)
    section.events = [(e["t_ns"] / 1e9, e["name"], e["message"]) for e in run.events][:500]
    return section


def _draw_signals(run: Run, resolved: Resolved, info: LogInfo) -> list[Chart]:
    """A picture for every signal that a requirement names, with all that is asked of it."""
    asked: dict[str, list[Expectation]] = {}
    for item in resolved.scenario.expect:
        if not isinstance(item, EventCount):
            asked.setdefault(item.signal, []).append(item)
    found = []
    for signal, items in asked.items():
        unit = next((item.unit for item in items if item.unit), "")
        try:
            series = evaluate(run, signal, vector=any(isinstance(item, Isolates) for item in items))
        except HilsatError as error:
            found.append(Chart(signal, note=f"not drawn: {error}"))
            continue
        if not series.values.size:
            found.append(Chart(signal, note="not drawn: the log has no sample of it"))
            continue
        found.append(Chart(signal, charts.draw_signal(series, signal, unit, items, info.faults)))
    return found


def _draw_timelines(run: Run, info: LogInfo) -> list[Chart]:
    found = []
    if any(fault.onset_s is not None for fault in info.faults):
        found.append(Chart("Faults", charts.draw_faults(info.faults, info.simulated_s)))
    if run.has("/fsw/executive"):
        modes = np.asarray(run.signals("/fsw/executive")["mode"], np.int64)
        found.append(
            Chart(
                "Modes of the flight software",
                charts.draw_modes(run.t_ns("/fsw/executive") / 1e9, modes, info.simulated_s),
            )
        )
    return found


def _draw_cycles(run: Run) -> Chart | None:
    if not run.has("/fsw/timing"):
        return None
    return Chart("Cycle times", charts.draw_cycle_times(np.asarray(run.signals("/fsw/timing")["cycle_us"], np.float64)))


def _read_counters(run: Run) -> Any:
    """What the sides refused, as they counted it by the end."""
    for topic, names in COUNTERS.items():
        if run.has(topic):
            fields = run.signals(topic)
            for name in names:
                if name in fields:
                    yield topic[1:], name, int(fields[name][-1])


def _describe_load(run: Run, resolved: Resolved) -> str:
    """How much of a real bus the frames would take, as many as were logged, eight bytes and full stuffing."""
    frames = sum(len(part) for part in run.iterate_frames())
    length_s = max(
        (run.count("/truth/attitude") if run.has("/truth/attitude") else 0) / resolved.scenario.clock.tick_hz, 1e-9
    )
    bitrate = resolved.scenario.bus.bitrate_bps
    share = 100.0 * frames * WORST_FRAME_BITS / length_s / bitrate
    return f"{frames} frames, {frames / length_s:.0f} a second: at most {share:.1f} % of {bitrate / 1000:g} kbit/s"
