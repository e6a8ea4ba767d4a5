"""The report of a run is one sound file that says what the log says; what is hostile in a log stays text."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from tools.cli import main
from tools.config.expect import Isolates
from tools.grading.expressions import Series
from tools.grading.grade import grade_file
from tools.report.page import charts
from tools.run.bench import Bench

VOID = {"meta", "br", "link", "img", "input", "hr"}
EXPECT = (
    "expect=[{name: '<b>small</b> & good', check: below, signal: truth.attitude.error_deg, bound: 1e6, unit: deg},"
    "{name: impossible, check: below, signal: 'norm(truth.attitude.omega_bi_b_rad_s)', bound: 0.0}]"
)


class Page(HTMLParser):
    """Elements, their attributes, and whether each that was opened was closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, tag

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten seconds with a fault, one requirement met and one not."""
    path = tmp_path_factory.mktemp("report") / "run.mcap"
    fault = "faults=[{unit: wheel.1, kind: dead, at_s: 2, until_s: 4}]"
    with Bench.open("zhang2018-flight", ["duration_s=10", fault, EXPECT], log=path) as bench:
        bench.run_to_end()
    return path


@pytest.fixture(scope="module")
def page(log: Path) -> Page:
    out = log.with_name("one.html")
    assert main(["report", str(log), "-o", str(out)]) == 0
    return Page(out.read_text(encoding="utf-8"))


def test_it_is_a_whole_document_on_its_own(page: Page) -> None:
    """Every element is closed, nothing is fetched from anywhere, no script runs, and landmarks are there."""
    assert not page.open
    names = [tag for tag, _ in page.tags]
    assert names.count("main") == names.count("header") == 1
    assert "script" not in names
    outside = [
        (tag, key, value) for tag, attrs in page.tags for key, value in attrs.items()
        if key in ("src", "href", "xlink:href") and value and not value.startswith("#")
    ]  # fmt: skip
    assert outside == []
    assert not re.search(r"url\((?!['\"]?#)|@import", page.text)


def test_every_picture_has_words(page: Page) -> None:
    """Each picture says what it shows to who cannot see it: signals, faults, modes, cycle times."""
    labels = [attrs.get("aria-label") or "" for tag, attrs in page.tags if tag == "svg"]
    assert len(labels) == 5
    assert all(len(label) > 20 for label in labels)
    assert any("wheel.1 dead from 2 s" in label for label in labels)
    assert any("point from" in label for label in labels)


def test_it_says_what_the_grade_says(page: Page, log: Path) -> None:
    """Outcome, every requirement and its value are in the text, as `hilsat grade` gives them."""
    grade = grade_file(log)
    assert grade.outcome == "fail"
    for verdict in grade.verdicts:
        assert verdict.name in page.text
        if verdict.value is not None:
            assert f"{verdict.value:.4g}" in page.text
    assert "<b>small</b> & good" in page.text  # as text, not as an element
    assert ("b", {}) not in page.tags


def test_several_runs_share_a_page_and_none_is_replaced(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two logs are two articles with a table of contents; a file that is there stays, also when a log cannot be read."""
    out = tmp_path / "two.html"
    assert main(["report", str(log), str(log), "-o", str(out)]) == 0
    names = [tag for tag, _ in Page(out.read_text(encoding="utf-8")).tags]
    assert (names.count("article"), names.count("nav")) == (2, 1)
    before = out.read_bytes()
    assert len(before) < 3_000_000
    assert main(["report", str(log), "-o", str(out)]) == 2
    (tmp_path / "none.mcap").write_bytes(b"nothing")
    assert main(["report", str(tmp_path / "none.mcap"), "-o", str(out), "-f"]) == 3
    assert out.read_bytes() == before
    assert "Traceback" not in capsys.readouterr().err


def test_a_vector_of_alarms_is_drawn_element_by_element() -> None:
    """Four alarms are three lines more than one, and the single sample on which one of them is up is not lost."""
    alarms = np.zeros((4000, 4))
    alarms[1234, 2] = 1.0
    series = Series(np.arange(4000) / 10, alarms)
    item = Isolates(name="i", check="isolates", signal="fsw.fdi.wheel_alarm", fault="wheel.3", within_s=1.0)
    picture = charts.draw_signal(series, "fsw.fdi.wheel_alarm", "", [item], ())
    assert "from 0 to 1" in picture
    one = charts.draw_signal(Series(series.t_s, alarms[:, 2]), "fsw.fdi.wheel_alarm", "", [item], ())
    assert picture.count("<path") == one.count("<path") + 3
