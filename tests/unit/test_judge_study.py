"""docs/judge.md: what turns each shipped requirement to FAIL, and the command that finds out."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tools.design.judge_study import PAGE, Row, format_case, format_page, list_cases, list_mutations, study

ROW = re.compile(r"^\| (.*) \| (PASS|FAIL|NOT EXECUTED) \| (PASS|FAIL|NOT EXECUTED) \| (.*?) \| (.*) \|$")


def read_page(text: str) -> dict[str, dict[str, tuple[str, str, str]]]:
    """Scenario -> requirement -> as it is, with the log cut, what turned it."""
    found: dict[str, dict[str, tuple[str, str, str]]] = {}
    name = ""
    for line in text.splitlines():
        if line.startswith("## "):
            name = line.removeprefix("## ")
        elif match := ROW.match(line):
            requirement = match[1].replace("\\|", "|").replace("&lt;", "<")
            found.setdefault(name, {})[requirement] = (match[2], match[3], match[4])
    return found


def test_the_page_names_every_requirement_that_ships() -> None:
    """No requirement is without its line, none is there that no longer ships; all pass as they are."""
    page = read_page(PAGE.read_text(encoding="utf-8"))
    shipped = {name: [item.name for item in expect] for name, (_, expect, _) in list_cases().items() if expect}
    assert {name: list(rows) for name, rows in page.items()} == shipped
    assert {row[0] for rows in page.values() for row in rows.values()} == {"PASS"}


def test_the_page_says_what_nothing_turns() -> None:
    """The sum at its head is that of its tables, and each requirement that nothing turned is named there."""
    text = PAGE.read_text(encoding="utf-8")
    rows = [(name, wanted, row) for name, rows in read_page(text).items() for wanted, row in rows.items()]
    blind = [(name, wanted) for name, wanted, row in rows if row[2] == "**nothing that was tried**"]
    assert f"**{len(rows) - len(blind)} of {len(rows)} requirements" in text
    for name, wanted in blind:
        assert f"- {name}: {wanted}" in text


def test_a_page_is_made_of_its_rows() -> None:
    """Bars in names do not break the table; what nothing turned is in the list; scenarios without requirements are not."""
    rows = [
        Row("a |b| < 1", "pass", "not executed", "faults do not come", "2; <= 1"),
        Row("blind", "pass", "pass"),
    ]
    page = format_page({"one": rows, "two": []})
    assert "- one: blind" in page
    assert "**1 of 2 requirements" in page
    assert read_page(page) == {
        "one": {
            "a |b| < 1": ("PASS", "NOT EXECUTED", "faults do not come"),
            "blind": ("PASS", "PASS", "**nothing that was tried**"),
        }
    }
    assert format_case("one", rows) in page


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
