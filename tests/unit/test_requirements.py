"""Requirement files: shared by scenarios, filtered by their names, graded under their ids, refused where they are wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from bus.errors import ConfigError
from tools.cli import main
from tools.config.loader import load_scenario
from tools.config.requirements import load_requirements
from tools.config.scenario_files import SHIPPED
from tools.grading.grade import grade_file
from tools.log.mcap_reader import read_run
from tools.run.bench import Bench

GOOD = """
requirements:
  - {id: R-1, name: points, text: It shall point., severity: high, check: below,
     signal: truth.attitude.error_deg, bound: 500}
  - {id: R-2, name: others, applies_to: [other*], check: below, signal: truth.attitude.error_deg, bound: 0}
  - {id: R-3, name: mine, applies_to: [mine, zhang*], check: below, signal: truth.attitude.error_deg, bound: 0}
"""
SCENARIO = "extends: {shipped}\nname: mine\nduration_s: 2\nfaults: []\nexpect: []\nrequirements: [{names}]\n"


def write(folder: Path, text: str, names: str = "shared") -> Path:
    (folder / "requirements").mkdir(exist_ok=True)
    (folder / "requirements" / "shared.yaml").write_text(text)
    path = folder / "mine.yaml"
    path.write_text(SCENARIO.format(shipped=SHIPPED / "zhang2018.yaml", names=names))
    return path


def test_a_scenario_takes_in_what_applies_to_it(tmp_path: Path) -> None:
    """Of three requirements the two that apply by name stand among its expectations, also when written and read back."""
    resolved = load_scenario(write(tmp_path, GOOD))
    assert [item.id for item in resolved.scenario.expect] == ["R-1", "R-3"]
    (tmp_path / "again.yaml").write_text(resolved.to_yaml())
    assert load_scenario(tmp_path / "again.yaml").scenario.expect == resolved.scenario.expect


def test_the_log_carries_them_and_the_grade_names_them(tmp_path: Path) -> None:
    """Graded from the log alone, with the files gone: one passes, one fails, each under its id with its text."""
    path = write(tmp_path, GOOD)
    with Bench(load_scenario(path), log=tmp_path / "run.mcap") as bench:
        bench.run_to_end()
    (tmp_path / "requirements" / "shared.yaml").unlink()
    grade = grade_file(tmp_path / "run.mcap")
    by_id = {verdict.id: verdict for verdict in grade.verdicts}
    assert by_id["R-1"].outcome == "pass"
    assert by_id["R-1"].text == "It shall point."
    assert by_id["R-3"].outcome == "fail"
    assert by_id["R-3"].title == "R-3 mine"
    assert "R-2" not in by_id


def test_a_log_is_held_against_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What ships for any run is met by a sound one; a file of one's own turns the verdict; a mistake in it is named."""
    with Bench.open("zhang2018", ["duration_s=5", "faults=[]", "expect=[]"], log=tmp_path / "run.mcap") as bench:
        bench.run_to_end()
    log = str(tmp_path / "run.mcap")
    assert main(["grade", log]) == 1  # nothing was asked
    assert main(["grade", log, "-r", str(SHIPPED / "requirements" / "bench.yaml")]) == 0
    assert "BENCH-003 the flight software refuses no frame" in capsys.readouterr().out
    own = tmp_path / "own.yaml"
    own.write_text(GOOD)
    assert main(["grade", log, "-r", str(own)]) == 1
    own.write_text(GOOD.replace("[mine, zhang*]", "[mine]").replace("high, check", "high, applies_to: [mine], check"))
    capsys.readouterr()
    assert main(["grade", log, "-r", str(own)]) == 1
    assert "no requirement of" in capsys.readouterr().err
    own.write_text(GOOD.replace("error_deg, bound: 500", "eror_deg, bound: 500"))
    assert main(["grade", log, "-r", str(own)]) == 2
    assert "error_deg" in capsys.readouterr().err
    assert read_run(log).has("/truth/attitude")


LIKE = """
requirements:
  - {id: L-1, name: points alike, check: matches, signal: truth.attitude.error_deg, tolerance: 1e-3, unit: deg}
"""


def test_a_log_is_held_against_a_file_and_another_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The file stands behind the log; the same flight matches, another does not, without one nobody knows."""
    for name, rate in (("a", 0.0), ("b", 0.0), ("c", 0.2)):
        own = ["duration_s=3", "faults=[]", "expect=[]", f"plant.body.rate_deg_s=[{rate},0,0]"]
        with Bench.open("zhang2018", own, log=tmp_path / f"{name}.mcap") as bench:
            bench.run_to_end()
    (tmp_path / "like.yaml").write_text(LIKE)
    log, other, third, like = (str(tmp_path / name) for name in ("a.mcap", "b.mcap", "c.mcap", "like.yaml"))
    assert main(["grade", log, like, "--against", other]) == 0
    assert "PASS  L-1 points alike" in capsys.readouterr().out
    assert main(["grade", log, other, like, "--against", third]) == 1
    assert capsys.readouterr().out.count("FAIL  L-1 points alike") == 2
    assert main(["grade", log, like]) == 1
    assert "NOT EXECUTED  L-1 points alike" in capsys.readouterr().out
    assert main(["grade", like]) == 2
    assert "there is no log among" in capsys.readouterr().err
    assert main(["grade", log, like, "--against", like]) == 3
    words = capsys.readouterr().err
    assert "like.yaml" in words
    assert "Traceback" not in words


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (GOOD.replace("id: R-2, ", ""), "needs an id"),
        (GOOD.replace("R-2", "R-1"), "line 3 too"),
        (GOOD.replace("[other*]", "other"), "applies_to"),
        (GOOD.replace("check: below", "check: belwo", 1), "belwo"),
        ("# words\nrequirement: []\n", "one key, requirements"),
        ("requirements: [just words]", "is no requirement"),
        ("requirements: []", "nothing would be required"),
        ("requirements: [", "shared.yaml:1"),
    ],
)  # fmt: skip
def test_mistakes_are_named_with_their_place(tmp_path: Path, text: str, words: str) -> None:
    """Each mistake names the requirement file, its line and what is wrong, from a scenario and from a file alone."""
    path = write(tmp_path, text)
    with pytest.raises(ConfigError, match=r"shared\.yaml:\d+:\d+") as error:
        load_scenario(path)
    assert words in str(error.value)
    with pytest.raises(ConfigError, match=r"shared\.yaml:\d+:\d+"):
        load_requirements(tmp_path / "requirements" / "shared.yaml", "mine", 2.0)


@pytest.mark.parametrize(
    ("names", "words"),
    [("shard", "did you mean shared"), ("../shared", "without a folder"), ("{a: 1}", "takes a list")],
)
def test_a_file_that_is_not_there_is_named(tmp_path: Path, names: str, words: str) -> None:
    """A misspelt name gets the near miss; a path is refused."""
    with pytest.raises(ConfigError, match="requirements") as error:
        load_scenario(write(tmp_path, GOOD, names))
    assert words in str(error.value)
