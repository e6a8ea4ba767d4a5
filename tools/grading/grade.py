"""Grades a log: every expectation of the scenario attached to it, every fault that should have bitten, every tick.

Everything comes from the MCAP file: the resolved scenario is an attachment, so a log can be graded anywhere, later, and
nothing outside it is read. What the log lacks is never passed over: a requirement that needs it is not executed.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bus.errors import RecordError
from tools.config.expect import Expectation, expressions_of
from tools.config.loader import load_text
from tools.config.requirements import load_requirements
from tools.config.scenario import Resolved
from tools.grading.bus import COUNTERS, judge_senders
from tools.grading.expressions import name_signals
from tools.grading.faults import judge_faults
from tools.grading.judge import judge
from tools.grading.verdict import Outcome, Verdict, decide
from tools.log.completeness import Completeness, Timetable, check_completeness
from tools.log.mcap_reader import Run, read_run

SCENARIO_ATTACHMENT = "scenario.yaml"
WORDS: dict[Outcome, str] = {"pass": "PASS", "fail": "FAIL", "not executed": "NOT EXECUTED"}
SHOWN = 3  # holes that a verdict names


@dataclass(frozen=True, slots=True)
class Grade:
    """All verdicts on one run."""

    scenario: str
    verdicts: tuple[Verdict, ...]
    complete: bool  # the run went to its end
    required: int  # requirements of the scenario itself, expectations and faults, and those that were added
    added: int = 0  # of them, from files beside the log

    @property
    def outcome(self) -> Outcome:
        """Pass when the run is complete, something was asked of it, and all of that was seen to hold."""
        if not self.complete or any(verdict.outcome == "fail" for verdict in self.verdicts):
            return "fail"
        return "pass" if self.required and all(verdict.passed for verdict in self.verdicts) else "not executed"

    @property
    def passed(self) -> bool:
        """True for a pass and nothing else."""
        return self.outcome == "pass"

    def as_dict(self) -> dict[str, Any]:
        """In JSON types."""
        return {
            "scenario": self.scenario,
            "outcome": self.outcome,
            "passed": self.passed,
            "complete": self.complete,
            "verdicts": [verdict.as_dict() for verdict in self.verdicts],
        }


def grade_file(path: Path, requirements: Sequence[Path] = (), reference: Run | None = None) -> Grade:
    """The grade of a log file against its scenario, and against more requirements from files.

    reference : the log that expectations with `check: matches` compare with

    Raises RecordError when it is not a log of ours, ConfigError for its scenario and for the files.
    """
    run = read_run(path)
    resolved = scenario_of(run, path)
    scenario = resolved.scenario
    more = [item for file in requirements for item in load_requirements(file, scenario.name, scenario.duration_s)]
    return grade_run(run, resolved, more, reference)


def scenario_of(run: Run, path: Path, overrides: Sequence[str] = ()) -> Resolved:
    """The resolved scenario that a log carries, and nothing but what it carries; `overrides`: key.path=value words.

    Raises RecordError when it carries none, or a damaged one; ConfigError when it is not sound or refers to a file.
    """
    data = run.attachment(SCENARIO_ATTACHMENT)
    if data is None:
        raise RecordError(
            f"{path}: no {SCENARIO_ATTACHMENT} is attached, so there is nothing to grade against; only logs written by "
            "`hilsat run` can be graded"
        )
    name = f"{path}:{SCENARIO_ATTACHMENT}"
    try:
        text = data.decode()
    except UnicodeDecodeError:
        raise RecordError(f"{name}: the attached scenario is not UTF-8 text") from None
    return load_text(text, name, overrides, files=False)


def make_timetable(resolved: Resolved) -> Timetable:
    """Which ticks a run of the scenario has."""
    scenario = resolved.scenario
    return Timetable(
        resolved.ticks,
        scenario.clock.tick_hz,
        scenario.fsw.executive.control_divider,
        scenario.clock.mode == "realtime",
    )


def grade_run(run: Run, resolved: Resolved, more: Sequence[Expectation] = (), reference: Run | None = None) -> Grade:
    """The grade of an opened log.

    more      : what is required beside what its scenario expects
    reference : as for `grade_file`
    """
    scenario = resolved.scenario
    expect = [*scenario.expect, *more]
    timetable = make_timetable(resolved)
    _prefetch(run, [expression for item in expect for expression in expressions_of(item)])
    faults = run.faults  # read before the damage is counted
    completeness = check_completeness(run, timetable)
    complete = _complete(run, timetable)
    verdicts = [judge(run, item, completeness, timetable, reference) for item in expect]
    verdicts += judge_faults(faults, scenario.faults, completeness, timetable)
    if not any(fault.effect.brings_rivals for fault in scenario.faults):
        verdicts.append(_need_end(judge_senders(run), complete))
    verdicts.append(_judge_completeness(completeness))
    required = len(expect) + len(scenario.faults)
    return Grade(scenario.name, tuple(verdicts), complete, required, len(more))


def _prefetch(run: Run, expressions: list[str]) -> None:
    """Read all signals that a grade needs in one pass; what cannot be read is left to each to say."""
    wanted: dict[str, list[str]] = {}
    counters = [(topic, field) for topic, _ in COUNTERS for field in ("rivals", "slips", "shed")]
    for topic, field in [*counters, *(name for expression in expressions for name in name_signals(expression))]:
        if topic in run.topics:
            try:
                if field in run.signals(topic):
                    wanted.setdefault(topic, []).append(field)
            except RecordError:
                continue
    try:
        run.prefetch(wanted)
    except RecordError:
        return


def _need_end(verdict: Verdict, complete: bool) -> Verdict:
    """What must hold to the end of the run is not executed where the log does not go there."""
    if complete or not verdict.passed:
        return verdict
    return replace(verdict, outcome="not executed", detail="the log does not go to the end of the run")


def _judge_completeness(completeness: Completeness) -> Verdict:
    lines = completeness.describe()
    rest = [f"and {len(lines) - SHOWN} more"] if len(lines) > SHOWN else []
    missing = completeness.missing
    detail = "; ".join(lines[:SHOWN] + rest)
    outcome = decide(completeness.whole)
    return Verdict("no tick is missing in the log", outcome, missing, "0 dropped ticks", -missing, "ticks", detail)


def _complete(run: Run, timetable: Timetable) -> bool:
    """Whether the truth goes to the last tick of the run."""
    topic = "/truth/attitude"
    ticks = run.ticks(topic) if run.has(topic) else None
    return ticks is not None and int(ticks.max()) >= timetable.ticks - 1


def format_grade(grade: Grade) -> str:
    """The grade as a table for people."""
    rows = []
    width = max((len(WORDS[verdict.outcome]) for verdict in grade.verdicts), default=0)
    for verdict in grade.verdicts:
        value = "-" if verdict.value is None else f"{verdict.value:.4g}"
        margin = "" if verdict.margin is None else f"margin {verdict.margin:+.3g} {verdict.unit}"
        tail = f"  ({verdict.detail})" if verdict.detail and not verdict.passed else ""
        word = f"{WORDS[verdict.outcome]:<{width}}"
        rows.append(f"  {word}  {verdict.title:<44} {value:>10}   {verdict.bound:<44} {margin}{tail}")
    if not grade.complete:
        rows.append("  FAIL  the run did not go to its end")
    count = sum(verdict.passed for verdict in grade.verdicts)
    tail = "" if grade.required else "; nothing was graded: the scenario expects nothing and has no faults"
    rows.append(f"{WORDS[grade.outcome]}: {grade.scenario}, {count} of {len(grade.verdicts)} requirements met{tail}")
    return "\n".join(map(_on_one_line, rows))


def _on_one_line(text: str) -> str:
    """The text with everything that would start a line of its own, or move the cursor, shown as ?."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def to_json(grade: Grade) -> str:
    """One JSON object."""
    return json.dumps(grade.as_dict(), allow_nan=False)
