"""Writes the page out of what was gathered."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from tools.grading.grade import WORDS
from tools.report.page.content import Section

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
    names = [section.info.scenario or Path(section.info.log).name for section in sections]
    heading = f"Report: {names[0]}" if len(names) == 1 else f"Report of {len(names)} runs"
    return environment.get_template("report.html.j2").render(heading=heading, sections=sections)
