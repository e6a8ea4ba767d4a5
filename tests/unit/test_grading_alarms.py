"""Alarms held against the faults of a run: detected, missed, isolated, false; on logs made for it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from bus.telemetry.link import Field, TickPacker, Topic, announce_topics
from tools.config.expect import Detects, Isolates, NoFalseAlarm
from tools.grading.judge import judge
from tools.grading.verdict import Verdict
from tools.log.completeness import Timetable, check_completeness
from tools.log.mcap_reader import Run, read_run
from tools.log.recorder import Recorder

TICK_NS = 100_000_000
HZ = 10.0
SECOND = "wheel.2"
Fault = tuple[str, str, float, float | None, float | None]  # id, unit, onset, effect, end [s]
FAULTS: tuple[Fault, ...] = (("early", SECOND, 10.0, 11.0, 20.0), ("late", SECOND, 40.0, 40.0, None))
USUAL = {1: [(12.5, 21.0), (43.0, 60.0)]}  # wheel -> when its alarm is up [s]


def write_log(
    path: Path, faults: tuple[Fault, ...], ups: dict[int, list[tuple[float, float]]], ticks: int = 600
) -> Run:
    """60 s at 10 Hz of four alarms."""
    packer = TickPacker([Topic("/truth/x", "hilsat/X", (Field("alarm", "float64", 4),))], 1)
    recorder = Recorder(path, metadata={}, sources=(1,))
    link = recorder.link(1)
    link.announce(announce_topics([packer]))
    records = sorted(
        (t_s, phase, own_id, unit)
        for own_id, unit, *times in faults
        for t_s, phase in zip(times, ("2 onset", "3 effect", "1 end"), strict=True)
        if t_s is not None
    )
    for k in range(ticks):
        while records and round(records[0][0] * HZ) <= k:
            _, phase, own_id, unit = records.pop(0)
            link.fault(k * TICK_NS, k, unit, "loss", phase[2:], 0.3, "words", id=own_id, number=0, definition="{}")
        alarms = [float(any(round(a * HZ) <= k < round(b * HZ) for a, b in ups.get(wheel, []))) for wheel in range(4)]
        link.write_tick(k, k * TICK_NS, packer.pack(k, k * TICK_NS, *alarms))
    link.close("done")
    recorder.close()
    return read_run(path)


def detects(run: Run, **values: Any) -> Verdict:
    settings = {"signal": "truth.x.alarm[1]", "fault": SECOND, "within_s": 3.0} | values
    return judge(run, Detects(name="d", check="detects", **settings))


def isolates(run: Run, **values: Any) -> Verdict:
    settings = {"signal": "truth.x.alarm", "fault": SECOND, "within_s": 3.0} | values
    return judge(run, Isolates(name="i", check="isolates", **settings))


def is_quiet(run: Run, **values: Any) -> Verdict:
    settings = {"signal": "truth.x.alarm[1]", "fault": SECOND, "margin_s": 1.0} | values
    return judge(run, NoFalseAlarm(name="q", check="no_false_alarm", **settings))


def test_the_longest_delay_counts_from_the_effect(tmp_path: Path) -> None:
    """1.5 s behind the effect of the first fault, 3 s behind the second: within 3 s, not within 2.9 s."""
    run = write_log(tmp_path / "run.mcap", FAULTS, USUAL)
    verdict = detects(run)
    assert verdict.passed
    assert verdict.value == pytest.approx(3.0)
    assert "2 faults" in verdict.bound
    late = detects(run, within_s=2.9)
    assert late.outcome == "fail"
    assert "late at 40 s" in late.detail
    assert detects(run, fault="early", within_s=1.5).passed
    assert detects(run, fault="wheel.*", within_s=3.0).passed
    assert detects(run, until_s=30.0, within_s=1.6).passed  # the second is behind the window


def test_a_missed_fault_fails_whatever_else_was_found(tmp_path: Path) -> None:
    """The second fault brings no alarm; nor does one that was up all along, or that came before the effect."""
    assert detects(write_log(tmp_path / "a.mcap", FAULTS, {1: [(12.5, 21.0)]})).outcome == "fail"
    assert detects(write_log(tmp_path / "b.mcap", FAULTS, {1: [(0.0, 60.0)]})).outcome == "fail"
    assert detects(write_log(tmp_path / "c.mcap", FAULTS, {1: [(10.5, 21.0), (43.0, 60.0)]})).outcome == "fail"


def test_an_alarm_that_is_up_for_the_fault_before_counts_at_once(tmp_path: Path) -> None:
    """The first fault is still there when the second comes and the alarm is up for it: nothing new could be said."""
    faults = (("early", SECOND, 10.0, 11.0, None), ("late", SECOND, 40.0, 40.0, None))
    run = write_log(tmp_path / "run.mcap", faults, {1: [(12.5, 60.0)]})
    assert detects(run, within_s=1.5).passed
    assert detects(run, within_s=1.4).outcome == "fail"


@pytest.mark.parametrize(
    ("faults", "words"),
    [
        ((), "no fault wheel.2 took effect"),
        ((("idle", SECOND, 10.0, None, 20.0),), "changed nothing"),
        ((("end", SECOND, 58.0, 58.0, None),), "where the samples end"),
    ],
)
def test_what_cannot_be_told_is_not_executed(tmp_path: Path, faults: tuple[Fault, ...], words: str) -> None:
    """No fault, one without effect, one so late that its alarm could still come: never a pass, never a fail."""
    run = write_log(tmp_path / "run.mcap", faults, {})
    for verdict in (detects(run), isolates(run)):
        assert verdict.outcome == "not executed"
        assert words in verdict.detail


def test_isolation_is_the_own_alarm_and_no_other(tmp_path: Path) -> None:
    """Wheel 3's alarm beside wheel 2's fails; before the fault, or for a fault of its own, it does not matter."""
    assert isolates(write_log(tmp_path / "a.mcap", FAULTS, USUAL)).passed
    verdict = isolates(write_log(tmp_path / "b.mcap", FAULTS, USUAL | {2: [(14.0, 14.2)]}))
    assert verdict.outcome == "fail"
    assert "element [2] is up at t = 14 s" in verdict.detail
    assert isolates(write_log(tmp_path / "c.mcap", FAULTS, USUAL | {2: [(2.0, 10.0)]})).passed
    own = (*FAULTS, ("third", "wheel.3", 13.0, 13.0, 16.0))
    assert isolates(write_log(tmp_path / "d.mcap", own, USUAL | {2: [(14.0, 18.9)]})).passed
    assert isolates(write_log(tmp_path / "e.mcap", own, USUAL | {2: [(14.0, 19.9)]})).outcome == "fail"
    assert isolates(write_log(tmp_path / "f.mcap", FAULTS, {2: [(12.5, 60.0)]})).outcome == "fail"
    assert isolates(write_log(tmp_path / "g.mcap", FAULTS, {})).outcome == "fail"


def test_the_alarms_of_another_family_isolate_nothing(tmp_path: Path) -> None:
    """A vector of four, its second element up behind a fault of gyro.y: wheels' alarms, which say nothing of a gyro."""
    faults: tuple[Fault, ...] = (("turn", "gyro.y", 10.0, 10.0, 20.0),)
    verdict = isolates(write_log(tmp_path / "a.mcap", faults, {1: [(11.0, 20.0)]}), fault="gyro.*")
    assert verdict.outcome == "not executed"
    assert "gyro has 3 alarms" in verdict.detail


def test_false_alarms_are_those_outside_of_faults(tmp_path: Path) -> None:
    """The alarm stays 1 s behind the first fault, which is its margin; one at 30 s is false, with two samples."""
    run = write_log(tmp_path / "run.mcap", FAULTS, USUAL)
    assert is_quiet(run).passed
    assert is_quiet(run, margin_s=0.5).outcome == "fail"
    bad = write_log(tmp_path / "bad.mcap", FAULTS, {1: [*USUAL[1], (30.0, 30.2)]})
    verdict = is_quiet(bad)
    assert (verdict.outcome, verdict.value) == ("fail", 2)
    assert "30 s" in verdict.detail
    assert is_quiet(bad, until_s=29.0).passed
    assert is_quiet(bad, fault=None).outcome == "fail"
    assert is_quiet(bad, fault="early").outcome == "fail"


def test_silence_without_the_fault_that_is_named_is_no_pass(tmp_path: Path) -> None:
    """A named fault that never was is not executed; without a name silence is enough; an alarm is false either way."""
    quiet = write_log(tmp_path / "quiet.mcap", (), {})
    assert is_quiet(quiet).outcome == "not executed"
    assert is_quiet(quiet, fault=None).passed
    loud = write_log(tmp_path / "loud.mcap", (), {1: [(30.0, 30.2)]})
    assert is_quiet(loud).outcome == "fail"
    assert is_quiet(loud, fault=None).outcome == "fail"


def test_a_log_that_ends_early_says_nothing_of_alarms(tmp_path: Path) -> None:
    """Of a run of 60 s the log has 50 s: the faults in it were found in time, and yet none of it is a pass."""
    run = write_log(tmp_path / "short.mcap", FAULTS, USUAL, 500)
    timetable = Timetable(600, HZ)
    completeness = check_completeness(run, timetable)
    items = (
        Detects(name="d", check="detects", signal="truth.x.alarm[1]", fault=SECOND, within_s=3.0),
        NoFalseAlarm(name="q", check="no_false_alarm", signal="truth.x.alarm[1]", margin_s=1.0),
    )
    for item in items:
        assert judge(run, item, completeness, timetable).outcome == "not executed"
