"""Writes the page out of what was gathered."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from tools.grading.grade import WORDS
from tools.grading.verdict import Verdict
from tools.report.page.content import Section
from tools.report.page.drawing import number_ids

COLOURS: Final = {"pass": "pass", "fail": "fail", "not executed": "open"}


def render(sections: Sequence[Section]) -> str:
    """Return the HTML of a report."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.globals |= {
        "colour": COLOURS.__getitem__,
        "word": WORDS.__getitem__,
        "met": lambda section: sum(verdict.passed for verdict in section.grade.verdicts),
    }
    for number, chart in enumerate(chart for section in sections for chart in section.charts()):
        chart.svg = number_ids(chart.svg, number)
    names = [section.info.scenario or Path(section.info.log).name for section in sections]
    heading = f"Report: {names[0]}" if len(names) == 1 else f"Report of {len(names)} runs"
    return environment.get_template("report.html.j2").render(
        heading=heading, sections=sections, comparison=compare(sections) if len(sections) > 1 else []
    )  # fmt: skip


def compare(sections: Sequence[Section]) -> list[tuple[str, list[Verdict | None]]]:
    """Every requirement of some runs with the verdict of each run on it, None where a run has no such requirement.

    Requirements are the same where their titles are; of several with one title in a run, the first, second, ... go together.
    """
    columns: list[dict[tuple[str, int], Verdict]] = []
    for section in sections:
        column: dict[tuple[str, int], Verdict] = {}
        for verdict in section.grade.verdicts:
            number = sum(1 for title, _ in column if title == verdict.title)
            column[verdict.title, number] = verdict
        columns.append(column)
    keys = dict.fromkeys(key for column in columns for key in column)
    return [(key[0], [column.get(key) for column in columns]) for key in keys]
