"""Grades a log: every expectation of the scenario attached to it, and every fault that should have bitten.

Everything comes from the MCAP file: the resolved scenario is an attachment, so a log can be graded anywhere, later.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bus.errors import RecordError
from plant_server.faults import GYRO_AXES
from tools.config.loader import load_text
from tools.config.scenario import Resolved
from tools.grading.judge import Verdict, judge
from tools.log.mcap_reader import Run, read_run

SCENARIO_ATTACHMENT = "scenario.yaml"


@dataclass(frozen=True, slots=True)
class Grade:
    """All verdicts on one run."""

    scenario: str
    verdicts: tuple[Verdict, ...]
    complete: bool  # the run went to its end

    @property
    def passed(self) -> bool:
        """True when the run is complete and nothing failed."""
        return self.complete and all(verdict.passed for verdict in self.verdicts)

    def as_dict(self) -> dict[str, Any]:
        """In JSON types."""
        return {
            "scenario": self.scenario,
            "passed": self.passed,
            "complete": self.complete,
            "verdicts": [verdict.as_dict() for verdict in self.verdicts],
        }


def grade_file(path: Path) -> Grade:
    """The grade of a log file. Raises RecordError when it is not a log of ours, ConfigError for its scenario."""
    run = read_run(path)
    return grade_run(run, scenario_of(run, path))


def scenario_of(run: Run, path: Path) -> Resolved:
    """The resolved scenario that a log carries. Raises RecordError when it carries none."""
    text = run.attachments.get(SCENARIO_ATTACHMENT)
    if text is None:
        raise RecordError(
            f"{path}: no {SCENARIO_ATTACHMENT} is attached, so there is nothing to grade against; only logs written by "
            "`hilsat run` can be graded"
        )
    return load_text(text.decode() if isinstance(text, bytes) else text, f"{path}:{SCENARIO_ATTACHMENT}")


def grade_run(run: Run, resolved: Resolved) -> Grade:
    """The grade of an opened log."""
    scenario = resolved.scenario
    verdicts = [judge(run, item) for item in scenario.expect]
    fired = _fired(run)
    for fault in scenario.faults:
        due = round(fault.at_s * scenario.clock.tick_hz)
        units = GYRO_AXES if fault.unit == "gyro" else (fault.unit,)
        ticks = [
            [tick for name, kind, tick in fired if (name, kind) == (unit, fault.kind) and abs(tick - due) <= 1]
            for unit in units
        ]
        near = [found[0] for found in ticks if found]
        detail = "" if near else "it is not in the log as having taken effect"
        verdicts.append(
            Verdict(
                f"fault fired: {fault.unit} {fault.kind}",
                len(near) == len(units),
                near[0] / scenario.clock.tick_hz if near else None,
                f"at {fault.at_s:g} s",
                None,
                "s",
                detail,
            )
        )
    return Grade(scenario.name, tuple(verdicts), _complete(run, resolved))


def _fired(run: Run) -> set[tuple[str, str, int]]:
    return {(record["unit"], record["fault"], record["tick"]) for record in run.faults if record["phase"] == "onset"}


def _complete(run: Run, resolved: Resolved) -> bool:
    topic = "/truth/attitude"
    if topic not in run.topics:
        return False
    stamps = run.t_ns(topic)
    last_ns = (resolved.ticks - 1) * (1_000_000_000 // resolved.scenario.clock.tick_hz)
    return bool(stamps.size) and int(stamps[-1]) >= last_ns


def format_grade(grade: Grade) -> str:
    """The grade as a table for people."""
    rows = []
    for verdict in grade.verdicts:
        value = "-" if verdict.value is None else f"{verdict.value:.4g}"
        margin = "" if verdict.margin is None else f"margin {verdict.margin:+.3g} {verdict.unit}"
        words = "PASS" if verdict.passed else "FAIL"
        tail = f"  ({verdict.detail})" if verdict.detail and not verdict.passed else ""
        rows.append(f"  {words}  {verdict.name:<44} {value:>10}   {verdict.bound:<44} {margin}{tail}")
    if not grade.complete:
        rows.append("  FAIL  the run did not go to its end")
    count = sum(verdict.passed for verdict in grade.verdicts)
    word = "PASS" if grade.passed else "FAIL"
    rows.append(f"{word}: {grade.scenario}, {count} of {len(grade.verdicts)} requirements met")
    return "\n".join(rows)


def to_json(grade: Grade) -> str:
    """One JSON object."""
    return json.dumps(grade.as_dict(), allow_nan=False)
