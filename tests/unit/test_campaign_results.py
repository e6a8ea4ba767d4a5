"""What a campaign's results say: tables, page, comparison and export, of results whose structure is known beforehand."""

from __future__ import annotations

import csv
import importlib
import io
import json
import math
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats

from bus.errors import RecordError, UsageError
from tools.campaign.comparison import compare
from tools.campaign.coverage import cover, list_faults
from tools.campaign.importance import list_targets, weigh_axes
from tools.campaign.page.charts import draw_distribution, draw_scatter, make_ticks
from tools.campaign.page.content import find_bounds
from tools.campaign.results import AxisInfo, RunResult, read_results
from tools.campaign.summary import BITTEN_ALL, load, make_matrix, rank_worst, tally_by_axis
from tools.campaign.table import list_grids, say_rate, to_text
from tools.cli import main

MakeResults = Callable[..., Path]


def make_infra(result: RunResult) -> RunResult:
    return replace(result, outcome="infra", verdicts=(), metrics={}, reason="the worker was killed by SIGKILL")


def make_unseen(result: RunResult) -> RunResult:
    verdicts = tuple(replace(v, outcome="not executed", value=None, margin=None) for v in result.verdicts)
    return replace(result, outcome="not executed", verdicts=verdicts)


# -- counts --------------------------------------------------------------------------------------------------------


def test_every_run_is_counted_once_in_its_cell(make_results: MakeResults) -> None:
    """Cells add up to the campaign; each holds what a count by hand over the file's lines gives."""
    directory = make_results(runs=240, edit=lambda r: make_infra(r) if r.number % 50 == 3 else r)
    loaded = load(directory)
    matrix = make_matrix(loaded, "unit", "law")
    lines = [json.loads(line) for line in (directory / "results.jsonl").read_text().splitlines()]
    for (unit, law), cell in matrix.cells.items():
        own = [line["outcome"] for line in lines if line["labels"]["unit"] == unit and line["labels"]["law"] == law]
        assert (cell.tally.passed, cell.tally.failed, cell.tally.infra) == tuple(
            map(own.count, ("pass", "fail", "infra"))
        )
    assert sum(cell.tally.planned for cell in matrix.cells.values()) == 240


def test_infra_and_not_executed_are_never_passes(make_results: MakeResults) -> None:
    """A cell of infra runs alone is INFRA, one with an unseen requirement NOT EXECUTED; the rate counts the latter."""

    def edit(result: RunResult) -> RunResult:
        if result.labels["law"] == "smc":
            return make_infra(result)
        return make_unseen(result) if result.labels["unit"] == "gyro.z" else replace(result, outcome="pass")

    loaded = load(make_results(runs=60, edit=edit))
    cells = make_matrix(loaded, "law", "unit").cells
    assert {cell.outcome for (law, _), cell in cells.items() if law == "smc"} == {"infra"}
    assert cells["pid", "gyro.z"].outcome == "not executed"
    assert cells["pid", "wheel.1"].outcome == "pass"
    assert loaded.tally.rate == pytest.approx(20 / 30)
    assert loaded.tally.least_rate == pytest.approx(20 / 60)


def test_the_axis_that_matters_comes_first(make_results: MakeResults) -> None:
    """The law changes the bound and the unit nothing: rows are laws without being asked for."""
    matrix = make_matrix(load(make_results(runs=600)))
    assert (matrix.rows, matrix.columns) == ("law", "unit")
    assert matrix.column_labels == ("wheel.1", "wheel.2", "gyro.z")


def test_worst_runs_come_first(make_results: MakeResults) -> None:
    """What failed by most is first, to the three digits that count; then what passed; infra runs are nowhere."""
    loaded = load(make_results(runs=120, edit=lambda r: make_infra(r) if r.number == 7 else r))
    ranked = rank_worst(loaded.results)
    assert len(ranked) == 119
    margins = [result.verdicts[0].margin or 0.0 for result in ranked if result.outcome == "fail"]
    assert all(later > earlier - 0.1 for earlier, later in pairwise(margins))
    assert margins[0] < -5.0 < -0.5 < margins[-1]
    assert [result.outcome for result in ranked] == sorted(result.outcome for result in ranked)


def test_requirements_of_faults_are_one(make_results: MakeResults) -> None:
    """Each fault's own verdict has a name of its own; over a campaign they are one requirement, failed if one of them is."""

    def edit(result: RunResult) -> RunResult:
        bitten = result.verdicts[-1]
        more = replace(bitten, name="fault took effect: gyro.x bias", outcome="fail")
        return replace(result, verdicts=(*result.verdicts, more)) if result.number == 4 else result

    (found,) = [item for item in load(make_results(runs=30, edit=edit)).requirements if item.key == BITTEN_ALL]
    assert (found.tally.passed, found.tally.failed) == (29, 1)


def test_axis_tables_add_up(make_results: MakeResults) -> None:
    """Over the labels of any axis the counts of a requirement add up to those of the campaign."""
    loaded = load(make_results(runs=90))
    whole = {item.key: item.tally for item in loaded.requirements}
    for axis in ("law", "unit"):
        parts = tally_by_axis(loaded, axis)
        for key, tally in whole.items():
            assert sum(part[key].passed for part in parts.values()) == tally.passed


def test_intervals_are_never_shown_narrower_than_they_are() -> None:
    """Of 9896 of 9896 the lower bound is 99.96 %: shown as 99.9, not as 100.0."""
    from tools.campaign.statistics import Tally

    assert say_rate(Tally(9896)) == "100.0 % [99.9, 100.0]"
    assert say_rate(Tally(infra=3)) == "none judged"


# -- coverage and importance ---------------------------------------------------------------------------------------


def test_faults_are_read_from_settings() -> None:
    """Whole lists in JSON and in YAML, and single entries in either spelling of a key."""
    assert list(list_faults(['faults=[{"unit":"wheel.1","kind":"loss","at_s":3}]'])) == [("loss", "wheel.1", 3.0)]
    assert list(list_faults(["faults=[{unit: gyro.x, kind: constant, at_s: 2.5}]", "seed=3"])) == [
        ("constant", "gyro.x", 2.5)
    ]
    parts = [
        "faults=[{unit: wheel.1, kind: loss, at_s: 1}]",
        "faults[0].at_s=9",
        "faults.1={unit: wheel.2, kind: dead}",
    ]
    assert list(list_faults(parts)) == [("loss", "wheel.1", 9.0), ("dead", "wheel.2", 0.0)]
    assert list(list_faults(["faults=[", "faults=7", "faultsy=[{unit: a}]"])) == []


def test_coverage_counts_each_fault_once(make_results: MakeResults) -> None:
    """240 runs with one fault each are 240 faults over one kind, three units and four phases, and each phase is met."""
    found = cover(load(make_results(runs=240)).results)
    assert (found.kinds, found.units, len(found.phases), found.possible) == (
        ("loss",), ("gyro.z", "wheel.1", "wheel.2"), 4, 12,
    )  # fmt: skip
    assert sum(tally.planned for tally in found.cells.values()) == 240
    assert len(found.cells) == 12


def make_linear(count: int) -> tuple[list[RunResult], tuple[AxisInfo, ...]]:
    """y = 3 a - b + noise, with a and b correlated; c has nothing to do with it; w shifts it by its label."""
    rng = np.random.default_rng(7)
    a = rng.normal(size=count)
    b, c = 0.7 * a + rng.normal(size=count), rng.normal(size=count)
    word = rng.integers(0, 3, count)
    y = 3.0 * a - b + 2.0 * word + 0.5 * rng.normal(size=count)
    axes = (
        *(AxisInfo(name=n, kind="normal") for n in "abc"),
        AxisInfo(name="w", kind="values", labels=("0", "1", "2")),
    )
    results = [
        RunResult(
            number=i, values={"a": a[i], "b": b[i], "c": c[i], "w": int(word[i])}, labels={"w": str(word[i])}, repeat=0,
            base="b", overrides=(), seed=i, outcome="pass", metrics={"y": float(y[i])},
        )
        for i in range(count)
    ]  # fmt: skip
    return results, axes


@pytest.mark.parametrize("count", [300, 3000])
def test_importance_of_a_linear_model(count: int) -> None:
    """Partial rank correlations are those of residuals, shares equal H / (n - 1); what does nothing holds 0."""
    results, axes = make_linear(count)
    found = {item.axis: item for item in weigh_axes(results, axes, list_targets(results, ["y"])) if item.target == "y"}
    ranks = {n: scipy.stats.rankdata([r.values[n] for r in results]) for n in "abc"}
    y = scipy.stats.rankdata([r.metrics["y"] for r in results])
    words = np.array([r.values["w"] for r in results])
    for name in "abc":
        others = np.column_stack([np.ones(count), words == 1, words == 2, *(ranks[o] for o in "abc" if o != name)])

        def rest(v: Any, others: Any = others) -> Any:
            return v - others @ np.linalg.lstsq(others, v, rcond=None)[0]

        expected = scipy.stats.pearsonr(rest(ranks[name]), rest(y)).statistic
        assert found[name].effect == pytest.approx(expected, abs=1e-6)
        assert found[name].low <= expected <= found[name].high
    assert found["c"].low < 0.0 < found["c"].high
    assert found["a"].effect > 0.8 > -0.5 > found["b"].effect
    h = scipy.stats.kruskal(*([r.metrics["y"] for r in results if r.values["w"] == w] for w in range(3))).statistic
    assert found["w"].effect == pytest.approx(h / (count - 1), rel=1e-6)


def test_importance_says_nothing_of_what_does_not_vary(make_results: MakeResults) -> None:
    """A campaign in which every run passes has no importance for passing, and margins that are constant have none."""
    loaded = load(make_results(runs=60, edit=lambda r: replace(r, outcome="pass")))
    targets = list_targets(loaded.results, list(loaded.info.metrics))
    assert "passing" not in {item.target for item in weigh_axes(loaded.results, loaded.info.axes, targets)}


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (0.0, 1.0, ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]),
        (-3.0, 8.0, ["-2", "0", "2", "4", "6", "8"]),
        (0.011, 0.029, ["0.015", "0.020", "0.025"]),
        (0.0, 2.5e7, ["0", "5e+06", "1e+07", "1.5e+07", "2e+07", "2.5e+07"]),
    ],
)
def test_ticks_are_round_numbers(low: float, high: float, words: list[str]) -> None:
    """Steps of 1, 2 or 5, none outside, the words of each as short as tells them apart."""
    ticks = make_ticks(low, high)
    assert [word for _, word in ticks] == words
    assert all(low - 1e-12 <= value <= high * (1.0 + 1e-12) for value, _ in ticks)


def test_points_are_where_their_values_are() -> None:
    """Of a picture of three runs the places of points are those of a straight line: equal steps, upwards; one is a cross."""
    x = np.array([0.0, 1.0, 2.0])
    svg = draw_scatter(x, 10.0 * x, np.array([True, True, False]), ("a", "b"), ("s", ""))
    dots = [tuple(map(float, pair)) for pair in re.findall(r"M([\d.]+) ([\d.]+)h0", svg)]
    (cross,) = [tuple(map(float, pair)) for pair in re.findall(r"M([\d.]+) ([\d.]+)l", svg)]
    places = [*dots, (cross[0] + 2.4, cross[1] + 2.4)]
    steps = np.diff(places, axis=0)
    assert steps[0] == pytest.approx(steps[1], abs=0.6)
    assert steps[0][0] > 50.0
    assert steps[0][1] < -20.0
    assert "a [s]" in svg


def test_bars_are_as_high_as_their_counts() -> None:
    """Of ten runs with the smallest value and five with the largest, the first bar is twice as high, above it stripes."""
    values = np.array([0.0] * 10 + [1.0] * 5)
    svg = draw_distribution(values, np.array([True] * 10 + [False] * 5), "deg", (0.5,), "error")
    bars = [tuple(map(float, pair)) for pair in re.findall(r"M[\d.]+ ([\d.]+)V([\d.]+)H[\d.]+V[\d.]+z", svg)]
    heights = [bottom - top for bottom, top in bars]
    assert heights == pytest.approx([heights[0], 0.5 * heights[0]], abs=0.2)
    assert svg.count("stroke-dasharray") == 1
    assert "stroke:var(--paper)" in svg


def test_bounds_are_drawn_where_words_and_margins_agree() -> None:
    """Both ends of a band, one of a limit; none where the value is not what the number in the words bounds."""
    assert find_bounds([(0.4, 0.6, True, "<= 1 deg")]) == [1.0]
    assert find_bounds([(0.4, 0.4, True, "0 .. 1 deg"), (0.9, 0.1, True, "0 .. 1 deg")]) == [0.0, 1.0]
    assert find_bounds([(99.3, 0.7, True, "within 1 deg for good: 99 +- 1 s")]) == [100.0]
    assert find_bounds([(12.0, 3.0, True, "<= 1 deg for 10 s from 15 s at the latest")]) == []


# -- comparison ----------------------------------------------------------------------------------------------------


def worsen(share: float, law: str = "pid") -> Callable[[RunResult], RunResult]:
    """Of the runs of a law that pass, this share fails by requirement R-1."""

    def edit(result: RunResult) -> RunResult:
        if result.outcome != "pass" or result.labels["law"] != law or (result.number * 7919) % 1000 >= 1000 * share:
            return result
        first = replace(result.verdicts[0], outcome="fail", margin=-1.0)
        return replace(result, outcome="fail", verdicts=(first, *result.verdicts[1:]))

    return edit


def test_equal_campaigns_show_no_change(make_results: MakeResults) -> None:
    """The same campaign against itself: not one changed pair, every p-value is 1."""
    found = compare(load(make_results("a")), load(make_results("b")))
    assert not found.is_worse
    assert {(change.changed, change.p_value) for change in found.changes} == {((0, 0), 1.0)}


def test_false_alarms_are_rare(make_results: MakeResults) -> None:
    """Of 20 pairs of campaigns with one truth and other seeds, seven cells and nine tests each, at most 3 alarm."""
    sides = [load(make_results(f"c{seed}", runs=100, seed=seed)) for seed in range(40)]
    alarms = sum(
        bool(compare(a, b).by_verdict("worse", "better")) for a, b in zip(sides[::2], sides[1::2], strict=True)
    )
    assert alarms <= 3


def test_what_got_worse_is_named_with_its_cells(make_results: MakeResults) -> None:
    """Four fifths of the passes of one law lost: its cells and all runs are worse for outcome and R-1, nothing else is."""
    found = compare(load(make_results("a", runs=900)), load(make_results("b", runs=900, seed=2, edit=worsen(0.8))))
    worse = found.by_verdict("worse")
    assert found.is_worse
    assert {change.requirement for change in worse} == {"outcome", "R-1"}
    assert {change.labels.get("law", "pid") for change in worse} == {"pid"}
    assert len({change.cell for change in worse if change.labels}) == 3
    assert all(change.test == "fisher" for change in worse)
    for change in worse:
        (low, high), rate = change.interval or (math.nan, math.nan), change.after.rate or 0.0
        assert low < rate - (change.before.rate or 0.0) < high < 0.0


def test_matching_runs_are_compared_one_to_one(make_results: MakeResults) -> None:
    """With the same seeds 12 lost and none won of 90 runs are beyond chance by McNemar, 2 / 2^12; Fisher sees nothing."""
    before = load(make_results("a", runs=90))
    passed = [r.number for r in before.results if r.outcome == "pass" and r.labels == {**r.labels, "law": "smc"}][:12]

    def edit(result: RunResult) -> RunResult:
        return replace(result, outcome="fail") if result.number in passed else result

    found = compare(before, load(make_results("b", runs=90, edit=edit)))
    (whole,) = [change for change in found.changes if not change.labels and change.requirement == "outcome"]
    assert (whole.test, whole.changed, whole.p_value) == ("mcnemar", (12, 0), pytest.approx(2.0 / 2.0**12))
    assert whole.verdict == "worse"
    a, b = whole.before, whole.after
    assert scipy.stats.fisher_exact([[a.passed, a.failed], [b.passed, b.failed]]).pvalue > 0.05


def test_a_cell_that_is_not_judged_any_more_is_worse(make_results: MakeResults) -> None:
    """All runs of a cell infra: no rate got worse, and still the comparison does not come out well."""
    hidden = {"law": "pid", "unit": "gyro.z"}

    def edit(result: RunResult) -> RunResult:
        return make_infra(result) if {k: result.labels[k] for k in hidden} == hidden else result

    found = compare(load(make_results("a")), load(make_results("b", edit=edit)))
    assert {change.cell for change in found.by_verdict("lost")} == {"pid, gyro.z"}
    assert found.is_worse
    assert any("infra runs" in note for note in found.notes)


def test_what_cannot_be_compared_is_refused(make_results: MakeResults, capsys: pytest.CaptureFixture[str]) -> None:
    """No label or no requirement in common: exit 2, with words that name what each has."""
    a = make_results("a")
    b = make_results("b", edit=lambda r: replace(r, labels={**r.labels, "law": "lqr"}))
    c = make_results("c", edit=lambda r: replace(r, verdicts=(replace(r.verdicts[0], id="X-9"),)))
    assert main(["campaign", "diff", str(a), str(b)]) == 2
    assert "no cell in common" in capsys.readouterr().err
    assert main(["campaign", "diff", str(a), str(c)]) == 2
    assert "different requirements" in capsys.readouterr().err


def test_exit_codes_of_diff(make_results: MakeResults, capsys: pytest.CaptureFixture[str]) -> None:
    """0 for equal campaigns and for a better one, 1 the other way round; --json says the same."""
    a, b = str(make_results("a", runs=300)), str(make_results("b", runs=300, edit=worsen(0.8)))
    assert [main(["campaign", "diff", x, y]) for x, y in ((a, a), (b, a), (a, b))] == [0, 0, 1]
    capsys.readouterr()
    assert main(["campaign", "diff", a, b, "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["worse"]
    assert {change["verdict"] for change in found["changes"]} == {"worse", "no difference"}


# -- terminal ------------------------------------------------------------------------------------------------------


def test_show_names_the_command_of_each_worst_run(
    make_results: MakeResults, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three worst runs, each with a command that names its directory and number; the plan's missing runs are said."""
    directory = make_results(runs=60, planned=64)
    assert main(["campaign", "show", str(directory), "--worst", "3"]) == 0
    out = capsys.readouterr().out
    ranked = load(directory).worst_first[:3]
    assert re.findall(r"hilsat run (\S+)", out) == [f"{directory}#{result.number}" for result in ranked]
    assert "4 runs of the plan have no result" in out
    assert main(["campaign", "show", str(directory), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["missing"] == 4


def test_what_the_strategy_found_is_shown(make_results: MakeResults) -> None:
    """The sentences of found.json are in the table and on the page."""
    directory = make_results(edit=shorten, found={"summary": ["pid: fails from 0.4 on"], "trace": [0.5, 0.2]})
    text = "\n".join(to_text(grid) for grid in list_grids(load(directory), None, None, 3))
    assert "pid: fails from 0.4 on" in text
    assert main(["campaign", "report", str(directory)]) == 0
    page = (directory / "report.html").read_text()
    assert "pid: fails from 0.4 on" in page
    assert "by generation: from 0.5 to 0.2" in page


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["show", "{d}", "--rows", "lww"], 2, "axis 'lww' has no listed values"),
        (["show", "{d}", "--rows", "law", "--columns", "law"], 2, "name two axes"),
        (["show", "{d}/nothing"], 3, "is not the directory of a campaign"),
        (["show", "{d}", "--worst", "-1"], 2, "give 0 or more"),
        (["report", "{d}", "-o", "{d}/results.jsonl"], 2, "name another file"),
        (["diff", "{d}", "{d}", "--confidence", "95"], 2, "give a share above 0.5"),
        (["export", "{d}"], 2, "--csv FILE"),
    ],
)
def test_mistakes_are_said(
    words: list[str], code: int, message: str, make_results: MakeResults, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit 2 for usage, 3 for what cannot be read, and what to do about it."""
    directory = make_results()
    assert main(["campaign", *(word.format(d=directory) for word in words)]) == code
    assert message in capsys.readouterr().err


def test_damaged_directories_are_refused(make_results: MakeResults) -> None:
    """No result yet, a line that is no result, a found.json that is a list: a RecordError each; a cut last line is none."""
    directory = make_results(runs=10)
    path = directory / "results.jsonl"
    whole = path.read_text()
    path.write_text(whole + '{"number": 10, "val')
    assert len(load(directory).results) == 10
    for text in ("", whole.replace('"seed"', '"sed"', 1)):
        path.write_text(text)
        with pytest.raises(RecordError):
            load(directory)
    path.write_text(whole)
    (directory / "found.json").write_text("[]")
    with pytest.raises(RecordError, match=r"found\.json"):
        load(directory)


# -- page ----------------------------------------------------------------------------------------------------------


class Page(HTMLParser):
    """Tags that do not close, ids, links, texts."""

    VOID = ("meta", "br", "use", "path", "image", "rect", "link")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.tags: list[str] = []
        self.labels: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        keys = dict(attrs)
        self.tags.append(tag)
        self.links += [keys[key] for key in ("href", "src") if keys.get(key)]
        if tag == "svg":
            self.labels.append(keys.get("aria-label", ""))
        if "id" in keys and "svg" not in self.open:
            self.ids.append(keys["id"])
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: Any) -> None:
        self.tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.open.pop() == tag


def shorten(result: RunResult) -> RunResult:
    """Fewer numbers, so that a page has few pictures; every fortieth run is infra."""
    if result.number % 40 == 3:
        return make_infra(result)
    short = (*result.verdicts[:1], result.verdicts[-1])
    return replace(result, verdicts=short, metrics={"effort": result.metrics["effort"]})


def test_the_page_is_whole_and_needs_nothing(make_results: MakeResults) -> None:
    """Every tag closes, ids are unique, links lead to what is there, no script, and each picture has words."""
    directory = make_results(runs=120, edit=shorten)
    assert main(["campaign", "report", str(directory)]) == 0
    text = (directory / "report.html").read_text()
    page = Page(text)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    assert "script" not in page.tags
    links = [link for link in page.links if not link.startswith("data:")]
    assert all(link[1:] in page.ids for link in links if link.startswith("#") and "run-" in link)
    assert not any(link.startswith("http") for link in links)
    assert page.labels
    assert all(page.labels)
    assert "Wheels that lose torque &lt;and a gyro &amp; more&gt;" in text
    assert "&lt;markup&gt;" in text


def test_the_page_says_what_the_results_say(make_results: MakeResults) -> None:
    """Each cell's counts, the ten worst commands, every reason of an infra run, and the numbers of faults tried."""
    directory = make_results(runs=120, edit=shorten)
    assert main(["campaign", "report", str(directory), "--rows", "unit", "--columns", "law"]) == 0
    text = (directory / "report.html").read_text()
    loaded = load(directory)
    for cell in make_matrix(loaded, "unit", "law").cells.values():
        assert f"{cell.tally.passed}/{cell.tally.judged}" in text
    for result in loaded.worst_first[:10]:
        assert f"<code>hilsat run {directory}#{result.number}</code>" in text
    assert "3 INFRA" in text
    assert "the worker was killed by SIGKILL" in text
    assert "12 of 12 combinations" in text


def test_a_page_is_not_overwritten_and_always_the_same(
    make_results: MakeResults, capsys: pytest.CaptureFixture[str]
) -> None:
    """A second report needs --force or another name, and equals the first to the byte: nothing on it is of today."""
    directory = make_results(edit=shorten)
    words, path = ["campaign", "report", str(directory)], directory / "report.html"
    assert main(words) == 0
    first = path.read_bytes()
    assert main(words) == 2
    assert "is there already" in capsys.readouterr().err
    assert main([*words, "--force"]) == 0
    assert path.read_bytes() == first


@pytest.mark.parametrize("kind", ["infra", "unseen", "unasked"])
def test_a_campaign_without_numbers_has_a_page(make_results: MakeResults, kind: str) -> None:
    """All infra, nothing executed, nothing asked: the page says so and does not break."""
    edits: dict[str, Callable[[RunResult], RunResult]] = {
        "infra": make_infra,
        "unseen": lambda r: replace(make_unseen(r), metrics={}),
        "unasked": lambda r: replace(r, verdicts=(), metrics={}, outcome="not executed"),
    }
    directory = make_results(runs=12, edit=edits[kind])
    assert main(["campaign", "report", str(directory)]) == 0
    assert Page((directory / "report.html").read_text()).open == []


def test_the_command_is_for_a_shell(make_results: MakeResults, capsys: pytest.CaptureFixture[str]) -> None:
    """A directory with a space in its name is one word of the command that repeats a run; others stay as they are."""
    directory = make_results()
    spaced = directory.rename(directory.parent / "a b")
    assert main(["campaign", "show", str(spaced)]) == 0
    told = capsys.readouterr().out
    assert f"hilsat run {shlex.quote(f'{spaced}#')[:-1]}" in told
    for line in told.splitlines():
        if "hilsat run" in line:
            assert shlex.split(line[line.index("hilsat run") :])[2].startswith(f"{spaced}#")


# -- export --------------------------------------------------------------------------------------------------------


def test_csv_holds_every_number_exactly(make_results: MakeResults, capsys: pytest.CaptureFixture[str]) -> None:
    """Read back, values, margins and metrics equal those of the results to the last bit; what is not known is empty."""
    directory = make_results(edit=lambda r: make_infra(r) if r.number == 3 else r)
    assert main(["campaign", "export", str(directory), "--csv", "-"]) == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    for row, result in zip(rows, read_results(directory), strict=True):
        assert float(row["onset_s"]) == result.values["onset_s"]
        assert row["outcome"] == result.outcome
        if result.number == 3:
            assert row["R-1.value"] == row["effort"] == ""
            continue
        assert float(row["R-1.value"]) == result.verdicts[0].value
        assert float(row["effort"]) == result.metrics["effort"]
        assert float(row["wall_s"]) == 0.5


def test_an_axis_called_like_a_cost_keeps_its_values(
    make_results: MakeResults, capsys: pytest.CaptureFixture[str]
) -> None:
    """Wall time has its own column; an axis of that name is beside it, with the values that the runs had."""
    directory = make_results(edit=lambda r: replace(r, values={**r.values, "wall_s": 7.0 + r.number}))
    assert main(["campaign", "export", str(directory), "--csv", "-"]) == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert [float(row["axis.wall_s"]) for row in rows] == [7.0 + number for number in range(len(rows))]
    assert {row["wall_s"] for row in rows} == {"0.5"}


def test_lines_of_results_are_alike(make_results: MakeResults) -> None:
    """Every line is one object with the same keys in the same order, infra runs too: what reads JSON lines makes a table."""
    directory = make_results(edit=lambda r: make_infra(r) if r.number % 7 == 3 else r)
    lines = (directory / "results.jsonl").read_text().splitlines()
    assert len(lines) == 60
    assert len({tuple(json.loads(line)) for line in lines}) == 1


@pytest.mark.parametrize("library", ["pandas", "duckdb"])
def test_one_line_of_other_libraries(library: str, make_results: MakeResults) -> None:
    """The lines of docs/campaigns.md: runs by law and outcome are as many as ours."""
    directory = make_results()
    page = Path(__file__).parents[2].joinpath("docs", "campaigns.md").read_text()
    (line,) = re.findall(rf"^    (python -c .*{library}.*json.*)$", page, re.MULTILINE)
    words = [sys.executable if word == "python" else word for word in shlex.split(line.replace("DIR", str(directory)))]
    out = subprocess.run(words, capture_output=True, text=True, check=True, timeout=120).stdout
    results = read_results(directory)
    for law in ("smc", "pid"):
        assert str(sum(r.labels["law"] == law and r.outcome == "pass" for r in results)) in out


def test_parquet_holds_the_same(make_results: MakeResults) -> None:
    """Columns have types, unknown values are null, and every number is that of the results."""
    parquet = importlib.import_module("pyarrow.parquet")  # no types
    directory = make_results(edit=lambda r: make_infra(r) if r.number == 3 else r)
    path = directory.parent / "c.parquet"
    assert main(["campaign", "export", str(directory), "--parquet", str(path)]) == 0
    table = parquet.read_table(path)
    results = read_results(directory)
    assert table["number"].to_pylist() == [result.number for result in results]
    assert table["R-1.margin"].to_pylist() == [r.verdicts[0].margin if r.verdicts else None for r in results]
    assert str(table.schema.field("onset_s").type) == "double"


def test_parquet_without_pyarrow_says_how_to_get_it(
    make_results: MakeResults, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The line that installs it, exit 2, and no file."""
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    directory = make_results()
    path = directory.parent / "c.parquet"
    assert main(["campaign", "export", str(directory), "--parquet", str(path)]) == 2
    assert "pip install 'hilsat[parquet]'" in capsys.readouterr().err
    assert not path.exists()


def test_axes_that_are_called_like_a_column_do_not_hide_it(make_results: MakeResults) -> None:
    """An axis `seed` becomes axis.seed beside the run's own seed."""
    from tools.campaign.export import make_columns

    loaded = load(make_results(runs=6, edit=lambda r: replace(r, values={**r.values, "seed": 99})))
    columns = make_columns(loaded)
    assert columns["axis.seed"] == [99] * 6
    assert columns["seed"] == [result.seed for result in loaded.results]


def test_usage_errors_are_of_the_tree(make_results: MakeResults) -> None:
    """An unknown axis is a UsageError for callers in Python too."""
    with pytest.raises(UsageError, match="did you mean unit"):
        make_matrix(load(make_results()), "unt")
