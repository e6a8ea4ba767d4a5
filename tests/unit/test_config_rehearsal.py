"""What `check` finds by building what `run` builds, and by knowing what law and detector log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from bus.errors import ConfigError
from tools import cli
from tools.config import rehearsal
from tools.config.check import check
from tools.config.expect_checks import check_signal
from tools.config.loader import examine, examine_text, load_text

ROOT = Path(__file__).resolve().parents[2]
ZHANG = ROOT / "scenarios" / "zhang2018.yaml"
OTHER_BODY = "[[30, 0, 0], [0, 31, 0], [0, 0, 32]]"


def keys_of(*overrides: str, path: Path = ZHANG) -> list[tuple[str, str]]:
    return [(finding.key, finding.message) for finding in examine(path, ["expect=[]", *overrides]).findings]


REFUSED = [
    ("no design for this body", ["fsw.detector={kind: wang2010, observer: ts_b}", f"fsw.model.inertia_kgm2={OTHER_BODY}"],
     "fsw.detector", "inertia"),
    ("an observer that would not be stable",
     ["fsw.detector={kind: wang2010, observer: static, static_gain_rad_s: 1000}"], "fsw.detector", "1000"),
    ("a fault that can do nothing",
     ["faults=[{unit: gyro.x, kind: noise, factor: 3, at_s: 1}]"], "faults[0].kind", "effect"),
]  # fmt: skip


@pytest.mark.parametrize(("settings", "key", "word"), [pytest.param(s, k, w, id=i) for i, s, k, w in REFUSED])
def test_check_refuses_what_run_refuses(
    settings: list[str], key: str, word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each value is sound; only building it tells. `run` says the same and starts nothing: its directory is not made."""
    ((got, message),) = keys_of(*settings)
    assert got == key
    assert word in message
    out = tmp_path / "out"
    sets = [part for setting in ["expect=[]", *settings] for part in ("--set", setting)]
    assert cli.main(["run", str(ZHANG), "--out", str(out), *sets]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("error", [OverflowError("too large"), ZeroDivisionError("by zero"), ValueError("nan")])
def test_what_cannot_be_computed_with_is_a_finding(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    """An arithmetic error out of a constructor is said of the settings, not shown as a traceback."""

    def fail(*_: Any) -> None:
        raise error

    monkeypatch.setattr(rehearsal, "_build_plant", fail)
    assert keys_of() == [("plant", f"these settings cannot be computed with: {error}")]


# -- signals -------------------------------------------------------------------------------------------------------

FIELDS = {"fsw.law": {"beta": 1, "s_b_rad_s": 3}}

SIGNALS = [
    ("fsw.law.bta", 'fsw.law has no field bta; did you mean "beta"?'),
    ("fsw.detector.fault_kind[0]", "there is no topic fsw.detector: what is chosen there logs nothing of its inside"),
    ("norm(fsw.law.beta)", "norm needs a vector; there is a single number"),
    ("truth.attitude.q_ib", "is a vector of 4, where one number is needed; take an element, [0], or norm(...)"),
    ("abs(truth.attitude.q_ib)", "is a vector of 4"),
    ("truth.attitude.q_ib[4]", "[4] is out of range; the vector has 4 elements, [0] to [3]"),
    ("truth.attitude.error_deg[0]", "[0] needs a vector; there is a single number"),
    ("norm(truth.attitude.q_ib - fsw.law.s_b_rad_s)", "a vector of 4 and a vector of 3 do not combine"),
    ("norm(truth.attitude.q_ib)[0]", "[0] needs a vector"),
    ("max(2) * fsw.law.beta", "max needs a vector"),
    ("rate(2) * fsw.law.beta", "rate needs a signal; there is a constant"),
    ("truth + fsw.law.beta", "truth is not a signal"),
    ("(fsw.law.beta + 1).x", "(...).x is not a signal"),
    ("fsw.law.beta * 1e300", "a number in a signal can be at most 1e+12"),
]


@pytest.mark.parametrize(("signal", "said"), SIGNALS)
def test_a_signal_that_no_run_can_grade_is_found(signal: str, said: str) -> None:
    """Names, indices and shapes are checked against what the chosen law and detector log; one problem each."""
    ((key, message),) = check_signal(signal, FIELDS)
    assert key == "signal"
    assert message.startswith(said)


@pytest.mark.parametrize(
    "signal",
    ["fsw.law.beta", "fsw.law.s_b_rad_s[2]", "norm(rate(truth.attitude.q_ib))", "max(abs(2 * fsw.law.s_b_rad_s - 1))"],
)
def test_a_signal_that_a_run_can_grade_is_taken(signal: str) -> None:
    """The other side of the cases above."""
    assert check_signal(signal, FIELDS) == []


def test_an_expectation_is_held_against_the_law_that_flies() -> None:
    """zhang2018 expects the slope of its own law; another law has none, which is told at the expectation's place."""
    (finding,) = examine(ZHANG, ["fsw.controller.kind=braking_profile"]).findings
    assert finding.key == "expect[4].signal"
    assert finding.message.startswith("fsw.law has no field beta; there are: ")
    assert str(finding).split(":")[1] == str(ZHANG.read_text().split("signal: fsw.law.beta")[0].count("\n") + 1)


# -- one wrong key does not hide the others --------------------------------------------------------------------------


def test_one_wrong_key_of_an_expectation_hides_no_other() -> None:
    """A bound out of range, a signal misspelt, and times that cannot be: all three of one item are told."""
    item = "{name: x, check: below, signal: truth.atitude.q, bound: 1e99, from_s: 400, by_s: 20, for_s: -1}"
    keys = [finding.key for finding in examine(ZHANG, [f"expect=[{item}]"]).findings]
    assert sorted(keys) == [
        "expect[0].bound", "expect[0].by_s", "expect[0].for_s", "expect[0].from_s", "expect[0].signal"
    ]  # fmt: skip


def test_a_wrong_bus_hides_nothing_of_the_clock() -> None:
    """The mode is unknown and the rate does not divide: both are told."""
    keys = [
        finding.key for finding in examine(ZHANG, ["clock={mode: x, tick_hz: 30}", "bus={bitrate_bps: 1}"]).findings
    ]
    assert {"clock.mode", "clock.tick_hz", "bus.bitrate_bps"} <= set(keys)


# -- extends, logs, summary ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["zhang2018", "zhang2018.yaml"])
def test_a_shipped_scenario_is_found_by_name_from_anywhere(name: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(f"extends: {name}\nname: mine\nseed: 5\n")
    resolved = examine(file).resolved
    assert resolved is not None
    assert (resolved.scenario.name, resolved.scenario.seed, resolved.scenario.duration_s) == ("mine", 5, 300.0)


def test_a_file_beside_the_scenario_comes_before_the_shipped_one(tmp_path: Path) -> None:
    """`extends: zhang2018` means the neighbour where there is one."""
    (tmp_path / "zhang2018.yaml").write_text(ZHANG.read_text().replace("duration_s: 300", "duration_s: 290"))
    for name in ("zhang2018", "zhang2018.yaml"):
        file = tmp_path / "mine.yaml"
        file.write_text(f"extends: {name}\nname: mine\nexpect: []\n")
        resolved = examine(file).resolved
        assert resolved is not None
        assert resolved.scenario.duration_s == 290.0


@pytest.mark.parametrize("parent", ["zhang2018", "/etc/passwd", "/dev/zero", "zhang2018.yaml"])
def test_a_text_from_a_log_reads_no_file(parent: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The scenario of a log is whole: what it names is not opened, whatever it is."""

    def fail(*_: Any) -> None:
        raise AssertionError("a file was asked for")

    monkeypatch.setattr("tools.config.merge.read_text_file", fail)
    monkeypatch.setattr("tools.config.merge._find_parent", fail)
    with pytest.raises(ConfigError, match=r"extends: is not read here: a log carries its resolved scenario"):
        load_text(f"extends: {parent}\n", "run.mcap:scenario.yaml", files=False)


def test_a_whole_text_from_a_log_is_read() -> None:
    """The counterpart: what a run attaches loads, and builds nothing (its bus need not be here either)."""
    resolved = examine(ZHANG).resolved
    assert resolved is not None
    text = resolved.to_yaml().replace("address: 'hub:'", "address: nowhere")
    assert "address: nowhere" in text
    assert load_text(text, "x", files=False).scenario.name == "zhang2018"
    assert [finding.key for finding in examine_text(text, "x").findings] == ["bus.address"]


def test_check_says_when_nothing_will_be_graded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Neither an expectation nor a fault: it loads, and is told so; with either of them nothing is said."""
    assert check(ZHANG, ["expect=[]", "faults=[]"]) == 0
    assert "nothing will be graded" in capsys.readouterr().out
    assert check(ZHANG, ["expect=[]"]) == 0
    assert "nothing will be graded" not in capsys.readouterr().out
