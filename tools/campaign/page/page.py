"""Writes the page out of what was gathered."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from tools.campaign.page.content import MOST_SHOWN, Page, gather
from tools.campaign.results import RESULTS_FILE
from tools.campaign.summary import WORDS, load, name_troubles
from tools.campaign.table import describe_tally, say_labels, say_rate
from tools.log.outputs import create
from tools.report import page as report_page
from tools.report.page.drawing import number_ids

PAGE: Final = "report.html"
COLOURS: Final = {"pass": "pass", "fail": "fail", "not executed": "open", "infra": "infra"}
FOLDERS: Final = (Path(__file__).parent, Path(report_page.__file__).parent)  # the style is that of a run's report


def write_page(
    directory: Path, out: Path | None = None, force: bool = False, rows: str | None = None, columns: str | None = None
) -> Path:
    """Write the page of a campaign's directory; return its path (report.html in the directory, if nothing else is said).

    Raises RecordError when it is not the directory of a campaign, UsageError for a file that is there already.
    """
    loaded = load(directory)
    target = out or directory / PAGE
    with create(target, directory / RESULTS_FILE, force) as part:
        part.write_text(render(gather(loaded, rows, columns)), encoding="utf-8")
    return target


def render(page: Page) -> str:
    """Return the HTML."""
    environment = Environment(
        loader=FileSystemLoader(FOLDERS), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.globals |= {
        "colour": COLOURS.__getitem__,
        "word": WORDS.__getitem__,
        "rate": say_rate,
        "labels": say_labels,
        "troubles": name_troubles,
        "most": MOST_SHOWN,
    }
    for number, chart in enumerate((*page.distributions, *page.scatters, *page.search)):
        chart.svg = number_ids(chart.svg, number)
    info = page.loaded.info
    return environment.get_template("campaign.html.j2").render(
        heading=f"Campaign: {info.name}",
        page=page,
        info=info,
        lines=describe_tally(page.tally, page.loaded.missing),
        found=[str(line) for line in page.loaded.found.get("summary", ())],
    )
