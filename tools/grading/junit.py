"""Grades as JUnit XML, which every CI system shows: a suite a log, a case a requirement.

What was not executed is an error there and not a skipped case: nobody should read it as passed.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from junitparser import Error, Failure, JUnitXml, TestCase, TestSuite

from tools.grading.grade import Grade
from tools.grading.verdict import Verdict


def make_junit(grades: Iterable[tuple[Path, Grade]]) -> bytes:
    """Return the XML of some logs' grades."""
    xml = JUnitXml("hilsat grade")
    for log, grade in grades:
        suite = TestSuite(_clean(f"{grade.scenario} ({log})"))
        for verdict in grade.verdicts:
            suite.add_testcase(_make_case(grade, verdict))
        if not grade.complete:
            case = TestCase("the run went to its end", _clean(grade.scenario), 0.0)
            case.result = [Failure("the run did not go to its end", "incomplete")]
            suite.add_testcase(case)
        elif not grade.required:
            case = TestCase("something was required", _clean(grade.scenario), 0.0)
            case.result = [Error("the scenario expects nothing and has no faults", "not executed")]
            suite.add_testcase(case)
        suite.update_statistics()  # type: ignore[no-untyped-call]
        xml.add_testsuite(suite)
    xml.update_statistics()  # type: ignore[no-untyped-call]
    xml._elem.attrib.pop("skipped", None)  # the root has none in the format that Jenkins checks against
    text: bytes = xml.tostring()  # type: ignore[no-untyped-call]
    return text


def _make_case(grade: Grade, verdict: Verdict) -> TestCase:
    case = TestCase(_clean(verdict.title), _clean(grade.scenario), 0.0)
    value = "nothing" if verdict.value is None else f"{verdict.value:.6g}"
    margin = "" if verdict.margin is None else f", margin {verdict.margin:+.3g} {verdict.unit}"
    words = _clean(f"{value}, must be {verdict.bound}{margin}" + (f" ({verdict.detail})" if verdict.detail else ""))
    if verdict.outcome == "fail":
        case.result = [Failure(words, "requirement not met")]
    elif verdict.outcome == "not executed":
        case.result = [Error(words, "not executed")]
    case.system_out = words + (f"\nsource: {_clean(verdict.source)}" if verdict.source else "")
    return case


def _clean(text: str) -> str:
    """The text without what XML 1.0 cannot hold."""
    return "".join(letter if letter.isprintable() or letter in "\n\t" else "?" for letter in text)
