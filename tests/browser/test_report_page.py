"""The report in a real browser: on a wide screen and a telephone, light and dark, printed, by keyboard and by ear."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tools.cli import main
from tools.report.page.charts import MODE_COLOURS
from tools.run.bench import Bench

pytestmark = pytest.mark.browser

WIDE, PHONE = {"width": 1400, "height": 900}, {"width": 360, "height": 740}
FAULT = "faults=[{unit: wheel.1, kind: dead, at_s: 2, until_s: 4}, {unit: gyro.x, kind: constant, rate_rad_s: 0.1, at_s: 5}]"
EXPECT = (
    "expect=[{name: points, check: below, signal: truth.attitude.error_deg, bound: 100, unit: deg},"
    "{name: a requirement with a long name that nothing in the world can meet, check: below, "
    "signal: 'norm(fsw.observer.tau_fault_hat_b_nm - truth.wheels.tau_fault_b_nm)', bound: 0.0, unit: N m},"
    "{name: settles, check: settles, signal: truth.attitude.error_deg, bound: 1, unit: deg, by_s: 8}]"
)


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A report of one run that fails, and one of three."""
    folder = tmp_path_factory.mktemp("pages")
    log = folder / "run.mcap"
    with Bench.open("zhang2018", ["duration_s=10", FAULT, EXPECT], log=log) as bench:
        bench.run_to_end()
    found = {"one": folder / "one.html", "three": folder / "three.html"}
    assert main(["report", str(log), "-o", str(found["one"])]) == 0
    assert main(["report", *[str(log)] * 3, "-o", str(found["three"])]) == 0
    return found


@pytest.fixture
def open_page(browser: Any) -> Callable[..., Any]:
    """Opens a page; whatever it fetches or complains of fails the test."""

    @contextmanager
    def open_(path: Path, size: dict[str, int] = WIDE, scheme: str = "light") -> Iterator[Any]:
        context = browser.new_context(viewport=size, color_scheme=scheme)
        page = context.new_page()
        complaints: list[str] = []
        page.on("console", lambda message: complaints.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: complaints.append(request.url) if request.url != path.as_uri() else None)
        page.goto(path.as_uri())
        yield page
        assert complaints == []
        context.close()

    return open_


@pytest.mark.parametrize("name", ["one", "three"])
@pytest.mark.parametrize("size", [WIDE, PHONE, {"width": 768, "height": 1024}], ids=["wide", "phone", "tablet"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_is_wider_than_the_screen(
    open_page: Callable[..., Any], pages: dict[str, Path], name: str, size: dict[str, int], scheme: str
) -> None:
    """No horizontal scroll of the page, nothing fetched, no word on the console, and no picture without a size."""
    with open_page(pages[name], size, scheme) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
        sizes = page.evaluate("[...document.querySelectorAll('svg')].map(s => [s.clientWidth, s.clientHeight])")
        assert len(sizes) >= 5
        assert all(width > 200 and height > 40 for width, height in sizes)


def test_letters_of_pictures_can_be_read_on_a_telephone(open_page: Callable[..., Any], pages: dict[str, Path]) -> None:
    """The smallest text of any picture is 7 px high or more at 360 px."""
    with open_page(pages["one"], PHONE) as page:
        heights = page.evaluate("[...document.querySelectorAll('svg text')].map(t => t.getBoundingClientRect().height)")
        assert min(height for height in heights if height > 0) >= 7.0


LOOK = """() => {
  const rgb = (text) => { const m = text.match(/[\\d.]+/g).map(Number); return {r: m[0], g: m[1], b: m[2], a: m[3] ?? 1}; };
  const light = ({r, g, b}) => { const f = [r, g, b].map((v) => { v /= 255; return v <= 0.03928 ? v / 12.92
    : ((v + 0.055) / 1.055) ** 2.4; }); return 0.2126 * f[0] + 0.7152 * f[1] + 0.0722 * f[2]; };
  const behind = (e) => { for (; e; e = e.parentElement) { const c = rgb(getComputedStyle(e).backgroundColor);
    if (c.a === 1) return c; } return {r: 255, g: 255, b: 255}; };
  const found = [];
  for (const e of document.querySelectorAll('body *')) {
    const own = [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim());
    if (!own || !e.checkVisibility() || ['title', 'style', 'STYLE'].includes(e.tagName)) continue;
    const style = getComputedStyle(e), svg = e.tagName === 'text';
    const front = rgb(svg ? style.fill : style.color);
    if (svg && style.fill === 'rgb(255, 255, 255)' && e.textContent.match(/point|standby|detumble|safe|degraded/)) continue;
    const [a, b] = [light(front), light(behind(e))].sort((x, y) => y - x);
    found.push([e.textContent.trim().slice(0, 40), (a + 0.05) / (b + 0.05)]);
  }
  return found;
}"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("medium", ["screen", "print"])
def test_every_text_has_contrast(
    open_page: Callable[..., Any], pages: dict[str, Path], scheme: str, medium: str
) -> None:
    """4.5 to 1 and better for every text, those of pictures too, as the browser computes the colours (WCAG 2.1, 1.4.3)."""
    with open_page(pages["three"], WIDE, scheme) as page:
        page.emulate_media(media=medium, color_scheme=scheme)
        found = page.evaluate(LOOK)
        assert len(found) > 100
        assert [(text, ratio) for text, ratio in found if ratio < 4.5] == []


def test_names_of_modes_have_contrast_on_their_bars() -> None:
    """White letters on each colour of a mode: 4.5 to 1 and better."""
    for colour in MODE_COLOURS:
        parts = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
        linear = [part / 12.92 if part <= 0.03928 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
        light = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
        assert 1.05 / (light + 0.05) >= 4.5, colour


def test_dark_is_dark_and_paper_is_white(open_page: Callable[..., Any], pages: dict[str, Path]) -> None:
    """The reader's scheme turns the colours of page and lines; print is dark on white whatever the scheme."""
    seen = {}
    for scheme, medium in (("light", "screen"), ("dark", "screen"), ("dark", "print")):
        with open_page(pages["one"], WIDE, scheme) as page:
            page.emulate_media(media=medium, color_scheme=scheme)
            seen[scheme, medium] = page.evaluate(
                "[getComputedStyle(document.body).backgroundColor, getComputedStyle(document.body).color,"
                " getComputedStyle(document.querySelector('svg path[style*=\"--chart-line\"]')).stroke]"
            )
    light, dark = seen["light", "screen"], seen["dark", "screen"]
    assert all(a != b for a, b in zip(light, dark, strict=True))
    assert seen["dark", "print"][:2] == ["rgb(255, 255, 255)", "rgb(0, 0, 0)"]


def test_it_prints_on_pages(open_page: Callable[..., Any], pages: dict[str, Path]) -> None:
    """A run takes two to five sheets of A4; a report of three runs begins each on a sheet of its own."""

    def count(name: str) -> int:
        with open_page(pages[name]) as page:
            return len(re.findall(rb"/Type\s*/Page\b", page.pdf(format="A4", print_background=True)))

    one, three = count("one"), count("three")
    assert 2 <= one <= 5
    assert 3 * one <= three <= 3 * one + 2


def test_it_has_landmarks_and_names(open_page: Callable[..., Any], pages: dict[str, Path]) -> None:
    """One main, one header, a navigation, named regions; headings without a gap; words for pictures; no id twice."""
    with open_page(pages["three"]) as page:
        for role, count in (("main", 1), ("banner", 1), ("navigation", 1), ("article", 3)):
            assert page.get_by_role(role).count() == count, role
        unnamed = page.evaluate(
            "[...document.querySelectorAll('section,article,nav,[role=region]')].filter(e => {"
            " const by = e.getAttribute('aria-labelledby');"
            " return !(e.getAttribute('aria-label') || (by && document.getElementById(by)?.textContent.trim())); }).length"
        )
        assert unnamed == 0
        levels = page.evaluate("[...document.querySelectorAll('h1,h2,h3')].map(h => Number(h.tagName[1]))")
        assert levels[0] == 1
        assert all(after - before <= 1 for before, after in itertools.pairwise(levels))
        assert page.evaluate("document.documentElement.lang") == "en"
        labels = page.evaluate("[...document.querySelectorAll('svg')].map(s => s.getAttribute('aria-label') ?? '')")
        assert all(len(label) > 20 for label in labels)
        assert page.evaluate(
            "(() => { const all = [...document.querySelectorAll('[id]')].map(e => e.id);"
            " return all.length - new Set(all).size; })()"
        ) == 0  # fmt: skip
        lost = page.evaluate(
            "[...document.querySelectorAll('[clip-path]')].filter(e => {"
            " const id = e.getAttribute('clip-path').match(/#([^)]+)/)[1]; return !document.getElementById(id); }).length"
        )
        assert lost == 0


def test_the_keyboard_reaches_all_and_shows_where_it_is(open_page: Callable[..., Any], pages: dict[str, Path]) -> None:
    """Tab goes through links, tables and folds, each with an outline; Enter unfolds the events."""
    with open_page(pages["three"]) as page:
        wanted = page.evaluate("document.querySelectorAll('a[href],[tabindex=\"0\"],summary').length")
        seen = []
        for _ in range(wanted):
            page.keyboard.press("Tab")
            seen.append(
                page.evaluate(
                    "(() => { const e = document.activeElement, s = getComputedStyle(e);"
                    " return [e.tagName, s.outlineStyle !== 'none' && parseFloat(s.outlineWidth) >= 2]; })()"
                )
            )
        assert {tag for tag, _ in seen} == {"A", "DIV", "SUMMARY"}
        assert all(outlined for _, outlined in seen)
        page.locator("summary").first.focus()
        page.keyboard.press("Enter")
        assert page.locator("details[open]").count() == 1


def test_verdicts_come_first(open_page: Callable[..., Any], pages: dict[str, Path]) -> None:
    """On a wide screen outcome and first margin are on the first screen, without scrolling."""
    with open_page(pages["one"]) as page:
        assert page.get_by_text("FAIL", exact=True).first.bounding_box()["y"] < WIDE["height"]
        assert page.locator("td[data-name=margin]").first.bounding_box()["y"] < WIDE["height"]
