"""Expectations whose times count from a fault or an event, on a log whose right grades are known in closed form."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from bus.errors import ConfigError
from bus.telemetry.link import Field, TickPacker, Topic, announce_topics
from tools.config.expect import Above, Below, EventCount, Settles
from tools.config.loader import load_scenario
from tools.config.scenario_files import find_scenario
from tools.grading.judge import judge
from tools.log.completeness import Timetable, check_completeness
from tools.log.mcap_reader import Run, read_run
from tools.log.recorder import Recorder

TICK_NS = 100_000_000
BITES_S, ALARM_S = 20.0, 23.0


def write_log(path: Path, hole: range = range(0)) -> Run:
    """60 s at 10 Hz: 10 exp(-(t - 20) / 5) from the fault's effect at 20 s on, 0 before; the alarm is up from 23 s on."""
    packer = TickPacker([Topic("/truth/x", "hilsat/X", (Field("error", "float64"), Field("alarm", "float64")))], 1)
    recorder = Recorder(path, metadata={}, sources=(1,))
    link = recorder.link(1)
    link.announce(announce_topics([packer]))
    for k in range(600):
        t_s = k / 10
        error = 10 * math.exp(-(t_s - BITES_S) / 5) if t_s >= BITES_S else 0.0
        if k == 195:
            link.fault(
                k * TICK_NS,
                k,
                "wheel.2",
                "loss",
                "onset",
                0.3,
                "wheel.2 loss",
                id="faults[0]",
                number=0,
                definition="{}",
            )
        if k == 200:
            link.fault(
                k * TICK_NS,
                k,
                "wheel.2",
                "loss",
                "effect",
                0.3,
                "wheel.2 loss",
                id="faults[0]",
                number=0,
                definition="{}",
            )
        if k == 230:
            link.event(k * TICK_NS, "warning", "fsw", "wheel 2 is alarmed")
        if k not in hole:
            link.write_tick(k, k * TICK_NS, packer.pack(k, k * TICK_NS, error, float(t_s >= ALARM_S)))
    link.close("done")
    recorder.close()
    return read_run(path)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return write_log(tmp_path_factory.mktemp("after") / "run.mcap")


@pytest.mark.parametrize("after", ["fault wheel.2", "fault faults[0]", "fault loss"])
def test_settling_counts_from_the_effect(log: Run, after: str) -> None:
    """10 exp(-t/5) > 1 until t = 5 ln 10 = 11.51 s behind the effect: the last such sample is 11.5 s behind it."""
    verdict = judge(log, Settles(name="s", check="settles", signal="truth.x.error", bound=1.0, by_s=12.0, after=after))
    assert verdict.passed
    assert verdict.value == pytest.approx(11.5)
    assert "20 s" in verdict.detail


def test_a_detection_delay_is_a_time_after_a_fault(log: Run) -> None:
    """The alarm comes 3 s behind the effect: in time for 3 s, too late for 2.9 s; and at once behind its own event."""

    def detected(by_s: float, after: str) -> bool:
        return judge(
            log, Above(name="d", check="above", signal="truth.x.alarm", bound=0.5, by_s=by_s, for_s=1.0, after=after)
        ).passed  # fmt: skip

    assert detected(3.0, "fault wheel.2")
    assert not detected(2.9, "fault wheel.2")
    assert detected(0.0, "event is alarmed")


@pytest.mark.parametrize("after", ["fault wheel.3", "event nobody said this"])
def test_what_did_not_happen_is_not_executed(log: Run, after: str) -> None:
    """Without the fault or the event nothing is known of what follows it, and that is no pass."""
    verdict = judge(log, Below(name="b", check="below", signal="truth.x.error", bound=1e6, after=after))
    assert verdict.outcome == "not executed"


def test_a_hole_counts_where_the_shifted_window_is(tmp_path: Path) -> None:
    """Ticks missing 2 to 3 s behind the effect spoil a window that ends 5 s behind it, not one that ends before them."""
    run = write_log(tmp_path / "hole.mcap", range(220, 230))
    timetable = Timetable(600, 10.0)
    completeness = check_completeness(run, timetable)

    def outcome(until_s: float) -> str:
        item = Below(name="b", check="below", signal="truth.x.error", bound=1e6, until_s=until_s, after="fault loss")
        return judge(run, item, completeness, timetable).outcome

    assert outcome(5.0) == "not executed"
    assert outcome(1.5) == "pass"


@pytest.mark.parametrize(
    ("after", "words"),
    [("fault wheel.9", "did you mean wheel."), ("wheel.1", "neither"), ("fault", "neither"), ("event ", "neither")],
)
def test_a_moment_that_cannot_come_is_named_at_check_time(after: str, words: str) -> None:
    """A misspelt fault or form is found before anything runs, with its place."""
    with pytest.raises(ConfigError, match=r"expect\[0\]\.after") as error:
        load_scenario(find_scenario("zhang2018"), [f"expect[0].after='{after}'"])
    assert words in str(error.value)


def test_with_faults_by_command_the_name_may_come_later() -> None:
    """Where faults may be injected, a fault that the scenario does not have is no mistake."""
    load_scenario(find_scenario("zhang2018"), ["expect[0].after='fault mine'", "inject=allowed"])


@pytest.mark.parametrize(
    ("item", "words"),
    [
        (
            Below(check="below", name="x", signal="truth.x.error", bound=99, until_s=45, after="fault wheel.2"),
            "ends at 65 s",
        ),
        (
            EventCount(check="event_count", name="x", event="zzz", at_most=0, from_s=41, after="fault wheel.2"),
            "starts at 61 s",
        ),
        (
            Settles(check="settles", name="x", signal="truth.x.error", bound=5, by_s=45, after="fault wheel.2"),
            "goes at least to its by_s at 65 s",
        ),
    ],
)
def test_what_lies_behind_the_end_of_the_run_is_no_pass(tmp_path: Path, item: Any, words: str) -> None:
    """The fault bites at 20 s of a run of 60 s: 40 s and no more can be judged from there, whatever the values are."""
    run = write_log(tmp_path / "x.mcap")
    timetable = Timetable(600, 10.0)
    verdict = judge(run, item, check_completeness(run, timetable), timetable)
    assert verdict.outcome == "not executed"
    assert words in verdict.detail
    assert "the run ends at 60 s" in verdict.detail
