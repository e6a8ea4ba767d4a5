"""docs/judge.md: what turns each shipped requirement to FAIL, and the command that finds out."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.design.judge_study import PAGE, Row, format_page, list_cases, list_mutations, read_page, study
from tools.design.repeat_log import repeat
from tools.log.completeness import check_completeness
from tools.log.mcap_reader import read_run
from tools.run.bench import Bench


def test_the_page_names_every_requirement_that_ships() -> None:
    """Each has its line, or stands among those not flown yet; none is there that no longer ships; all pass as they are."""
    text = PAGE.read_text(encoding="utf-8")
    page = read_page(text)
    shipped = {name: [item.name for item in expect] for name, (_, expect, _) in list_cases().items() if expect}
    for name, names in shipped.items():
        flown = [row.name for row in page.pop(name, [])]
        assert flown == names or f"- {name}: {'; '.join(names)}\n" in text, name
    assert not page
    assert {row.sound for rows in read_page(text).values() for row in rows} == {"pass"}


def test_the_page_says_what_nothing_turns() -> None:
    """The sum at its head is that of its tables, and each requirement that nothing turned is named there."""
    text = PAGE.read_text(encoding="utf-8")
    rows = [(name, row) for name, rows in read_page(text).items() for row in rows]
    blind = [(name, row.name) for name, row in rows if not row.catch]
    assert f"**{len(rows) - len(blind)} of {len(rows)} requirements" in text
    for name, wanted in blind:
        assert f"- {name}: {wanted}\n" in text


def test_a_page_reads_back_as_what_it_was_made_of() -> None:
    """Bars and signs in names do not break the table; what nothing turned, and what was not flown, is in the lists."""
    rows = [
        Row("a |b| < 1", "pass", "not executed", "faults do not come", "2; <= 1"),
        Row("blind", "pass", "pass"),
    ]
    page = format_page({"one": rows, "two": []}, ["three: x; y"])
    assert "- one: blind\n" in page
    assert "- three: x; y\n" in page
    assert "**1 of 2 requirements" in page
    assert "## two" not in page
    assert read_page(page) == {"one": rows}


@pytest.mark.slow
def test_three_requirements_are_turned_by_what_they_are_about() -> None:
    """Gyro faults found and estimated: the detector switched off turns both; a fault too many is a false alarm."""
    path, expect, overrides = list_cases()["wang2010-constant"]
    wanted = [item for item in expect if item.name != "keeps pointing on the corrected rate"]
    rows = {row.name: row for row in study(Path(path), tuple(wanted), overrides)}
    assert {row.sound for row in rows.values()} == {"pass"}
    assert rows["alarm on all three axes within two samples"].cut == "not executed"
    assert rows["alarm on all three axes within two samples"].catch == "gyro fault detection off"
    assert rows["estimate error of observer B"].catch == "gyro fault detection off"
    assert rows["no alarm before the fault"].catch


def test_fault_handling_is_tried_first() -> None:
    """The first mutations of a scenario with observer, wheel health and detector switch these off, one at a time."""
    from tools.config.loader import load_scenario

    path, _, overrides = list_cases()["gyro-drift-flight"]
    names = [mutation.name for mutation in list_mutations(load_scenario(path, overrides).scenario)]
    assert names[:3] == ["observer off", "wheel health off", "gyro fault detection off"]
    assert len(set(names)) == len(names) > 15


def test_a_repeated_log_is_whole_and_as_long(tmp_path: Path) -> None:
    """2 s three times over: 6 s without a hole, the same signal in each third, faults and events once."""
    own = ["duration_s=2", "expect=[]", "faults=[{unit: wheel.1, kind: dead, at_s: 0.5}]"]
    with Bench.open("zhang2018", own, log=tmp_path / "run.mcap") as bench:
        bench.run_to_end()
    repeat(tmp_path / "run.mcap", tmp_path / "long.mcap", 3)
    long = read_run(tmp_path / "long.mcap")
    assert check_completeness(long).whole
    assert long.sequences("/truth/attitude") == list(range(60))
    error_deg = long.signals("/truth/attitude")["error_deg"].reshape(3, 20)
    assert (error_deg == error_deg[0]).all()
    assert len(long.faults) == len(read_run(tmp_path / "run.mcap").faults) == 2
