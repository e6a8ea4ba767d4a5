"""The JUnit file says what the grade says, in the form that CI systems read."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from lxml import etree

from tools.cli import main
from tools.grading.grade import Grade
from tools.grading.junit import make_junit
from tools.grading.verdict import Verdict
from tools.run.bench import Bench

PASSED = Verdict("settles", "pass", 69.1, "<= 70 s", 0.9, "s", "", "a paper, table 1")
FAILED = Verdict("stays < 1 & > 0", "fail", 1.5, "<= 1", -0.5, "deg", "at t = 3 s")
UNSEEN = Verdict("no \x1b[2J tick", "not executed", None, "0", None, "", "the log has a hole")


def test_each_outcome_has_its_element() -> None:
    """A pass has no result, a fail a failure, what was not executed an error; the counts agree with the cases."""
    root = ET.fromstring(make_junit([(Path("a.mcap"), Grade("flight", (PASSED, FAILED, UNSEEN), True, 3))]))
    assert root.tag == "testsuites"
    (suite,) = root
    assert {key: suite.get(key) for key in ("tests", "failures", "errors", "skipped")} == {
        "tests": "3", "failures": "1", "errors": "1", "skipped": "0",
    }  # fmt: skip
    results = [[child.tag for child in case if child.tag not in ("system-out",)] for case in suite]
    assert results == [[], ["failure"], ["error"]]
    assert suite[1].get("name") == "stays < 1 & > 0"
    assert "1.5" in (suite[1][0].get("message") or "")
    assert "\x1b" not in (suite[2].get("name") or "")


def test_the_file_is_what_jenkins_takes() -> None:
    """Every outcome, a run that broke off, one of which nothing was asked: sound by a schema that refuses others."""
    schema = etree.XMLSchema(etree.parse(Path(__file__).parents[1] / "data" / "junit.xsd"))
    grades = [
        (Path("a.mcap"), Grade("flight", (PASSED, FAILED, UNSEEN), True, 3)),
        (Path("b.mcap"), Grade("flight", (PASSED,), False, 1)),
        (Path("c.mcap"), Grade("flight", (PASSED,), True, 0)),
    ]
    document = etree.fromstring(make_junit(grades))
    assert schema.validate(document), schema.error_log
    document.set("skipped", "0")
    assert not schema.validate(document)
    document = etree.fromstring(make_junit(grades))
    document[0].set("failures", "none")
    assert not schema.validate(document)


@pytest.mark.parametrize(("complete", "required"), [(False, 1), (True, 0)])
def test_a_run_that_proves_nothing_is_no_green_suite(complete: bool, required: int) -> None:
    """A run that broke off, and one of which nothing was asked, count as trouble though each verdict passed."""
    root = ET.fromstring(make_junit([(Path("a.mcap"), Grade("flight", (PASSED,), complete, required))]))
    assert int(root[0].get("failures", "0")) + int(root[0].get("errors", "0")) == 1


def test_the_verb_writes_it_beside_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two logs, two suites; a second time the file is not replaced without being told; the exit code stays the grade's."""
    logs = []
    for name, bound in (("good", 1e6), ("bad", 0.0)):
        expect = f"expect=[{{name: small, check: below, signal: truth.attitude.error_deg, bound: {bound}}}]"
        with Bench.open("zhang2018", ["duration_s=3", "faults=[]", expect], log=tmp_path / f"{name}.mcap") as bench:
            bench.run_to_end()
        logs.append(str(tmp_path / f"{name}.mcap"))
    out = tmp_path / "out.xml"
    assert main(["grade", *logs, "--junit", str(out)]) == 1
    suites = ET.parse(out).getroot()
    assert [suite.get("failures") for suite in suites] == ["0", "1"]
    assert main(["grade", *logs, "--junit", str(out)]) == 2
    assert main(["grade", logs[0], "--junit", str(out), "--force"]) == 0
    assert "Traceback" not in capsys.readouterr().err
    for inputs in ((logs[0], logs[1]), (logs[0], "--against", logs[1])):
        before = Path(logs[1]).read_bytes()
        assert main(["grade", *inputs, "--junit", logs[1], "--force"]) == 2
        assert Path(logs[1]).read_bytes() == before


def test_a_log_that_ends_early_says_nothing_of_senders(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What must hold to the end of the run is not executed in a log that does not go there."""
    log = tmp_path / "short.mcap"
    with Bench.open("zhang2018", ["duration_s=3", "faults=[]", "expect=[]"], log=log) as bench:
        bench.step(10)
    assert main(["grade", str(log)]) == 1
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "two senders" in line]
    assert line.strip().startswith("NOT EXECUTED")
