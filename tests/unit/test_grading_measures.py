"""Checks that come to one figure, conditions and ends of windows, on a log whose right grades are known in closed form."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.errors import ConfigError
from bus.telemetry.link import Field, TickPacker, Topic, announce_topics
from tools.config.expect import (
    Below,
    Count,
    EventCount,
    Expectation,
    Integral,
    Matches,
    Mean,
    Monotonic,
    Percentile,
    Settles,
    Variation,
    Within,
)
from tools.config.loader import load_scenario
from tools.config.scenario_files import find_scenario
from tools.grading.expressions import evaluate
from tools.grading.judge import judge
from tools.grading.verdict import Verdict
from tools.log.completeness import Timetable, check_completeness
from tools.log.mcap_reader import Run, read_run
from tools.log.recorder import Recorder

TICK_NS = 100_000_000
HZ = 10.0
TICKS = 1001


def write_log(path: Path, hole: range = range(0), offset: float = 0.0, ticks: int = TICKS) -> Run:
    """100 s at 10 Hz of /truth/attitude: ramp = t, wave = sin(t), square = 1 on every second full 10 s, flag = NaN at 70 s;
    /fsw/slow at 1 Hz: mode = 0, 2 from 40 s, 4 from 60 s. A line "mode 2" at 40 s, three lines "frame lost" at 10, 20, 30 s.
    """
    fields = tuple(Field(name, "float64") for name in ("ramp", "wave", "square", "flag"))
    fast = TickPacker([Topic("/truth/attitude", "hilsat/Fast", fields)], 1)
    slow = TickPacker([Topic("/fsw/slow", "hilsat/Slow", (Field("mode", "float64"),), every="second")], 101)
    recorder = Recorder(path, metadata={}, sources=(1,))
    link = recorder.link(1)
    link.announce(announce_topics([fast, slow]))
    for k in range(ticks):
        t_s, t_ns = k / HZ, k * TICK_NS
        records = fast.pack(k, t_ns, t_s + offset, math.sin(t_s), float(k // 100 % 2), math.nan if k == 700 else 1.0)
        if k % 10 == 0:
            records += slow.pack(k, t_ns, 0.0 if k < 400 else 2.0 if k < 600 else 4.0)
        if k in (100, 200, 300):
            link.event(t_ns, "warning", "plant", "frame lost on the way")
        if k == 400:
            link.event(t_ns, "info", "fsw", "mode 2: asked for")
        if k not in hole:
            link.write_tick(k, t_ns, records)
    link.close("done")
    recorder.close()
    return read_run(path)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return write_log(tmp_path_factory.mktemp("measures") / "run.mcap")


def make(cls: Any, **values: Any) -> Any:
    """An expectation with what it must have; its check is the first word of the Literal."""
    check = cls.__dataclass_fields__["check"].type.removeprefix('Literal["').removesuffix('"]')
    return cls(check=check, **({"name": "n"} | values))


def grade(run: Run, cls: Any, signal: str, **values: Any) -> Verdict:
    return judge(run, make(cls, signal=signal, **values))


RAMP, WAVE, SQUARE = "truth.attitude.ramp", "truth.attitude.wave", "truth.attitude.square"


@pytest.mark.parametrize("share", [1.0, 50.0, 99.0, 99.95, 100.0])
def test_percentile_is_a_sample_that_was_measured(log: Run, share: float) -> None:
    """Of the 1001 samples 0, 0.1, ... 100 the nearest rank is numpy's inverted distribution function."""
    values = np.arange(TICKS) / HZ
    expected = float(np.percentile(values, share, method="inverted_cdf"))
    verdict = grade(log, Percentile, RAMP, share=share, bound=expected)
    assert verdict.passed
    assert verdict.value == pytest.approx(expected, abs=1e-12)
    assert grade(log, Percentile, RAMP, share=share, bound=expected - 0.05).outcome == "fail"


def test_percentile_of_few_samples_is_the_largest(log: Run) -> None:
    """Ten samples say nothing of 99 % but what the largest of them says."""
    assert grade(log, Percentile, RAMP, share=99.0, bound=0.85, until_s=0.9).outcome == "fail"
    assert grade(log, Percentile, RAMP, share=90.0, bound=0.85, until_s=0.9).passed


def test_counts_of_rises_and_samples(log: Run) -> None:
    """The square is up on 10-20, 30-40, 50-60, 70-80, 90-100 s: five rises and 500 samples; sin rises over 0.5 16 times."""
    assert grade(log, Count, SQUARE, at_most=5, at_least=5).value == 5
    assert grade(log, Count, SQUARE, at_most=4).outcome == "fail"
    assert grade(log, Count, SQUARE, at_least=6).outcome == "fail"
    assert grade(log, Count, SQUARE, of="samples", at_most=500, at_least=500).passed
    rises = sum(1 for k in range(20) if math.asin(0.5) + 2 * math.pi * k < 100)
    assert grade(log, Count, WAVE, bound=0.5, at_most=99).value == rises
    inside = grade(log, Count, SQUARE, at_most=1, from_s=12.0, until_s=25.0)  # up when the window starts: counts
    assert inside.value == 1
    assert inside.passed


def test_monotony_is_how_far_back_it_goes(log: Run) -> None:
    """The ramp only rises; sin goes back from 1 to -1, which is 2; downwards it goes back as far."""
    assert grade(log, Monotonic, RAMP, direction="rising").margin == 0.0
    assert grade(log, Monotonic, f"-{RAMP}", direction="falling").passed
    assert grade(log, Monotonic, RAMP, direction="falling").value == pytest.approx(100.0)
    for direction in ("rising", "falling"):
        verdict = grade(log, Monotonic, WAVE, direction=direction, tolerance=1.9)
        assert verdict.outcome == "fail"
        assert verdict.value == pytest.approx(2.0, abs=5e-3)
    assert grade(log, Monotonic, WAVE, direction="rising", until_s=1.5).passed


def test_integral_mean_and_variation(log: Run) -> None:
    """Of t to 100 s: 5000; of |sin| over 10 pi s: 20; mean 50; 3 t varies by 3 a second, sin by 4 a turn."""
    assert grade(log, Integral, RAMP, bound=5000.01).value == pytest.approx(5000.0)
    assert grade(log, Integral, RAMP, bound=4999.0).outcome == "fail"
    effort = grade(log, Integral, f"abs({WAVE})", bound=20.1, until_s=10 * math.pi)
    assert effort.passed
    assert effort.value == pytest.approx(20.0, abs=0.05)
    assert grade(log, Mean, RAMP, lower=49.9, upper=50.1).margin == pytest.approx(0.1)
    assert grade(log, Mean, RAMP, lower=50.1).outcome == "fail"
    assert grade(log, Mean, RAMP, upper=49.9).outcome == "fail"
    assert grade(log, Variation, f"3 * {RAMP}", bound=3.01).value == pytest.approx(3.0)
    verdict = grade(log, Variation, WAVE, bound=0.6, until_s=20 * math.pi)
    assert verdict.outcome == "fail"
    assert verdict.value == pytest.approx(2 / math.pi, rel=5e-3)


def test_a_condition_is_a_signal_too(log: Run) -> None:
    """The square is up on 500 of 1001 samples; chained, joined and turned comparisons say what Python's do."""
    share = grade(log, Mean, f"{SQUARE} == 1", lower=0.4)
    assert share.value == pytest.approx(500 / 1001)
    t = np.arange(TICKS) / HZ
    for expression, expected in (
        (f"10 < {RAMP} <= 20", (t > 10) & (t <= 20)),
        (f"{RAMP} < 10 or not {WAVE} >= 0.5", (t < 10) | ~(np.sin(t) >= 0.5)),
        (
            f"{RAMP} != 10 and {WAVE} <= 0 and {SQUARE} == 1",
            (t != 10) & (np.sin(t) <= 0) & (np.arange(TICKS) // 100 % 2 == 1),
        ),
    ):
        assert np.array_equal(evaluate(log, expression).values == 1.0, expected), expression
    assert np.isnan(evaluate(log, "truth.attitude.flag > 0").values[700])
    assert np.isnan(evaluate(log, f"not (truth.attitude.flag > 0 or {RAMP} >= 0)").values[700])


def test_when_keeps_the_samples_on_which_it_holds(log: Run) -> None:
    """mode 2 from 40 to 60 s, at 1 Hz: 200 samples of t, of mean 49.95, up to 59.9; no other counts."""
    assert grade(log, Within, RAMP, lower=40.0, upper=59.9, when="fsw.slow.mode == 2").passed
    assert grade(log, Mean, RAMP, lower=0, when="fsw.slow.mode == 2").value == pytest.approx(49.95)
    # sums and counts stop at what is left out: each 10 s give 9.9 s of t, around 14.95, 34.95, 54.95, 74.95, 94.95 s
    assert grade(log, Integral, RAMP, bound=1e6, when=f"{SQUARE} == 1").value == pytest.approx(9.9 * (275 - 5 * 0.05))
    assert grade(log, Variation, RAMP, bound=1.01, when=f"{SQUARE} == 1").value == pytest.approx(1.0)
    assert grade(log, Count, RAMP, at_most=9, when=f"{SQUARE} == 1").value == 5
    held = grade(log, Below, RAMP, bound=1e6, for_s=9.9, when=f"{SQUARE} == 1")
    assert held.passed
    assert grade(log, Below, RAMP, bound=1e6, for_s=10.0, when=f"{SQUARE} == 1").outcome == "fail"


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"when": "fsw.slow.mode == 7"}, "no sample"),
        ({"when": "truth.attitude.flag > 0"}, "not a number at t = 70"),
        ({"when": "fsw.slow.mod == 7"}, "did you mean mode"),
        ({"until": "event nobody said this"}, "the window has no end"),
        ({"until": "fault wheel.2"}, "the window has no end"),
        ({"until": "fsw.slow.mode == 7"}, "the window has no end"),
        ({"until": "truth.attitude.flag < 0"}, "not a number at t = 70"),
        ({"until": f"{RAMP} >= 0"}, "no sample"),
        ({"until": "event mode 2", "from_s": 50.0}, "the window has no end"),
    ],
)
def test_what_a_condition_leaves_nothing_of_is_not_executed(log: Run, values: dict[str, Any], words: str) -> None:
    """Neither an empty window nor one without the end that it should have is a pass, of any check."""
    for cls, own in ((Below, {"bound": 1e6}), (Mean, {"upper": 1e6}), (Settles, {"bound": 1e6, "by_s": 90.0})):
        verdict = grade(log, cls, RAMP, **own, **values)
        assert verdict.outcome == "not executed"
        assert words in verdict.detail


def test_until_ends_the_window_before_what_it_names(log: Run) -> None:
    """The event at 40 s, the condition at 60 s: the last samples are 39.9 and 59.9; until_s may end it sooner."""
    for until, last in (("event mode 2", 39.9), ("fsw.slow.mode == 4", 59.9), (f"{RAMP} > 5", 5.0)):
        assert grade(log, Below, RAMP, bound=last + 0.01, until=until).value == pytest.approx(last)
        assert grade(log, Below, RAMP, bound=last - 0.01, until=until).outcome == "fail"
    assert grade(log, Below, RAMP, bound=2.0, until="event mode 2", until_s=2.0).passed
    after = grade(log, Below, RAMP, bound=59.91, after="event mode 2", until="fsw.slow.mode == 4")
    assert after.passed
    assert "20 s" in after.detail


def test_a_hole_counts_where_a_condition_needs_it(tmp_path: Path) -> None:
    """Ticks missing in the window spoil it through the condition's topic alone; behind its end they do not."""
    run = write_log(tmp_path / "hole.mcap", range(500, 550))
    timetable = Timetable(TICKS, HZ)
    completeness = check_completeness(run, timetable)

    def outcome(item: Expectation) -> str:
        return judge(run, item, completeness, timetable).outcome

    mode = "fsw.slow.mode"
    assert outcome(make(Below, signal=mode, bound=9.0, until_s=45.0)) == "pass"
    assert outcome(make(Below, signal=mode, bound=9.0, until_s=45.0, when=f"{RAMP} < 70")) == "pass"
    assert outcome(make(Below, signal=mode, bound=9.0, until_s=58.0, when=f"{RAMP} < 70")) == "not executed"
    assert outcome(make(Below, signal=mode, bound=9.0, until=f"{RAMP} > 30")) == "pass"
    assert outcome(make(Below, signal=mode, bound=9.0, until=f"{RAMP} > 52")) == "not executed"
    assert outcome(make(EventCount, event="frame lost", at_most=3, until_s=45.0)) == "pass"
    assert outcome(make(EventCount, event="frame lost", at_most=3)) == "not executed"


def test_event_lines_are_counted_in_their_window(log: Run) -> None:
    """Three lines at 10, 20 and 30 s; two up to 20 s; none behind 30.1 s, which is a count and no empty window."""
    for values, number in (({}, 3), ({"until_s": 20.0}, 2), ({"from_s": 30.1}, 0), ({"until": "event mode 2"}, 3)):
        verdict = judge(log, make(EventCount, event="frame lost", at_most=number, at_least=number, **values))
        assert (verdict.outcome, verdict.value) == ("pass", number)
        assert judge(log, make(EventCount, event="frame lost", at_least=number + 1, **values)).outcome == "fail"
    assert judge(log, make(EventCount, event="frame lost", at_most=2)).outcome == "fail"


def test_a_short_log_says_nothing_of_events_to_come(tmp_path: Path) -> None:
    """A run of 100 s whose log ends at 50 s has no fourth line, and that is no pass of "at most three"."""
    run = write_log(tmp_path / "short.mcap", ticks=500)
    timetable = Timetable(TICKS, HZ)
    completeness = check_completeness(run, timetable)
    item = make(EventCount, event="frame lost", at_most=3)
    assert judge(run, item, completeness, timetable).outcome == "not executed"


def test_matching_a_reference_log(log: Run, tmp_path: Path) -> None:
    """The same log but for 0.25: within 0.25 and not within 0.24; other stamps, or no reference, are not executed."""
    other = write_log(tmp_path / "other.mcap", offset=0.25)

    def grade_against(reference: Run | None, tolerance: float, **values: Any) -> Verdict:
        return judge(log, make(Matches, signal=RAMP, tolerance=tolerance, **values), reference=reference)

    assert grade_against(other, 0.2501).passed
    assert grade_against(other, 0.24).outcome == "fail"
    assert grade_against(log, 0.0).passed
    assert grade_against(other, 0.2501, when=f"{SQUARE} == 1", from_s=5.0).passed
    assert grade_against(other, 0.24, when=f"{SQUARE} == 1", from_s=5.0).outcome == "fail"
    assert "--against" in grade_against(None, 1.0).detail
    for name, hole, ticks in (("hole", range(500, 501), TICKS), ("short", range(0), 900)):
        reference = write_log(tmp_path / f"{name}.mcap", hole, ticks=ticks)
        verdict = grade_against(reference, 1.0)
        assert (verdict.outcome, "other stamps" in verdict.detail) == ("not executed", True)
        assert grade_against(reference, 1.0, until_s=40.0).passed
    assert (
        judge(log, make(Matches, signal="truth.attitude.flag", tolerance=1.0), reference=log).outcome == "not executed"
    )


def test_the_page_says_nothing_that_is_refused() -> None:
    """Every way of writing a requirement in docs/grading.md is taken by a scenario as it stands there."""
    page = (Path(__file__).parents[2] / "docs" / "grading.md").read_text()
    items = re.findall(r"^\| .* \| `(check: .*?)`", page, re.MULTILINE)
    assert len(items) >= 15
    text = ", ".join(f"{{name: n{number}, {item}}}" for number, item in enumerate(items))
    scenario = load_scenario(find_scenario("zhang2018-flight"), [f"expect=[{text}]", "inject=allowed"]).scenario
    assert len(scenario.expect) == len(items)


@pytest.mark.parametrize(
    ("item", "words"),
    [
        ("check: count, signal: truth.attitude.error_deg", "count needs at_most or at_least"),
        ("check: count, signal: truth.attitude.error_deg, at_most: 1, at_least: 2", "2 is above at_most, 1"),
        ("check: event_count, event: lost", "event_count needs at_most or at_least"),
        ("check: mean, signal: truth.attitude.error_deg", "mean needs lower or upper"),
        ("check: percentile, signal: truth.attitude.error_deg, share: 101, bound: 1", "share"),
        ("check: below, signal: truth.attitude.error_deg, bound: 1, when: fsw.executive.mode", "is no condition"),
        ("check: below, signal: truth.attitude.error_deg, bound: 1, when: fsw.executiv.mode == 2", "fsw.executive"),
        ("check: below, signal: truth.attitude.error_deg, bound: 1, when: fsw.executive.mod == 2", "mode"),
        ("check: below, signal: truth.attitude.error_deg, bound: 1, until: fsw.executive.mod == 2", "mode"),
        ("check: below, signal: truth.attitude.error_deg, bound: 1, until: wheel.1", "is neither `fault NAME`"),
        ("check: below, signal: truth.attitude.error_deg, bound: 1, until: fault wheel.9", "did you mean wheel."),
        ("check: below, signal: truth.attitude.error_deg, bound: 1, when: fsw.law.nothing > 1", "nothing"),
        ("check: detects, signal: 'fsw.fdi.wheel_alarm[1]', fault: wheel.9, within_s: 1", "did you mean wheel."),
        ("check: isolates, signal: 'fsw.fdi.wheel_alarm[1]', fault: wheel.2, within_s: 1", "a vector with an element"),
        ("check: detects, signal: fsw.fdi.wheel_alarm, fault: wheel.2, within_s: 1", "is a vector of 4"),
    ],
)  # fmt: skip
def test_mistakes_are_named_before_anything_runs(item: str, words: str) -> None:
    """Conditions get the near misses that signals get; what a check lacks is named at its key."""
    with pytest.raises(ConfigError, match=r"expect\[0\]") as error:
        load_scenario(find_scenario("zhang2018"), [f"expect=[{{name: n, {item}}}]"])
    assert words in str(error.value)
