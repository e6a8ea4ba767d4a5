"""`hilsat plot --signals`: what is drawn are the signals of the log, peaks and holes included, over one log or several."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from tools.cli import main
from tools.log.mcap_reader import read_run
from tools.report.signal_plot import find_unit, split_signals
from tools.report.thinning import thin
from tools.run.bench import Bench

FAULT = "faults=[{unit: wheel.1, kind: dead, at_s: 1, until_s: 2}]"


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Three seconds with a fault, and three with another."""
    folder = tmp_path_factory.mktemp("plot")
    paths = (folder / "one.mcap", folder / "two.mcap")
    for path, fault in zip(paths, (FAULT, FAULT.replace("wheel.1", "wheel.3")), strict=True):
        with Bench.open("zhang2018-flight", ["duration_s=3", "expect=[]", fault], log=path) as bench:
            bench.run_to_end()
    return paths


# -- fewer points --------------------------------------------------------------------------------------------------


def test_thinning_keeps_every_peak_and_both_ends() -> None:
    """Of a million samples a few thousand are left; one high and one low sample anywhere among them stay."""
    generator = np.random.default_rng(5)
    for _ in range(20):
        values = generator.normal(size=100_003)
        high, low = generator.integers(0, values.size, 2)
        values[high], values[low] = 99.0, -99.0
        pick = thin(values, 1000)
        assert pick.size <= 1100
        assert (np.diff(pick) > 0).all()
        assert {0, values.size - 1, int(high), int(low)} <= set(pick.tolist())


def test_thinning_keeps_holes_and_short_lines() -> None:
    """A sample that is no number breaks the line there; what is short is left as it is, and all holes is no error."""
    values = np.zeros(10_000)
    values[7777] = np.nan
    assert 7777 in thin(values, 100)
    assert thin(np.arange(10.0), 100).tolist() == list(range(10))
    assert not np.isfinite(np.full(999, np.nan)[thin(np.full(999, np.nan), 10)]).any()


# -- what is asked for ---------------------------------------------------------------------------------------------


def test_lists_are_split_and_units_follow_functions(logs: tuple[Path, Path]) -> None:
    """A list is split at commas, each signal once; deg() turns rad/s into deg/s, rate() divides by seconds."""
    assert split_signals(["a.b.c, norm(a.b.d)", "a.b.c"]) == ["a.b.c", "norm(a.b.d)"]
    run = read_run(logs[0])
    assert find_unit(run, "deg(norm(truth.attitude.omega_bi_b_rad_s))") == "deg/s"
    assert find_unit(run, "rate(truth.attitude.error_deg)") == "deg/s"
    assert find_unit(run, "truth.attitude.error_deg * 2") == ""


@pytest.mark.parametrize("form", ["png", "svg", "pdf"])
def test_each_form_is_what_its_name_says(logs: tuple[Path, Path], tmp_path: Path, form: str) -> None:
    """The file starts as files of its kind do, and holds a panel for every signal."""
    out = tmp_path / f"picture.{form}"
    assert main(["plot", str(logs[0]), "-s", "truth.attitude.error_deg,fsw.control.tau_cmd_b_nm", "-o", str(out)]) == 0
    start = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}[form]
    assert out.read_bytes().startswith(start)
    if form == "svg":
        assert len(re.findall(r'id="axes_\d+"', out.read_text())) == 2


def test_another_log_is_drawn_into_the_same_panels(
    logs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two logs, a vector of three: six lines in one panel, the faults of both, and neither log can be written over."""
    out = tmp_path / "both.svg"
    words = ["plot", str(logs[0]), "--compare", str(logs[1]), "-s", "fsw.control.tau_cmd_b_nm", "--until", "2.5"]
    assert main([*words, "-o", str(out)]) == 0
    text = out.read_text()
    for label in ("[0] one", "[1] one", "[2] one", "[0] two", "[1] two", "[2] two", "wheel.1 dead", "wheel.3 dead"):
        assert f"<!-- {label}" in text, label
    picture = tmp_path / "link.svg"
    picture.symlink_to(logs[1])
    before = logs[1].read_bytes()
    assert main([*words, "-o", str(picture), "--force"]) == 2
    assert "the log that is read" in capsys.readouterr().err
    assert logs[1].read_bytes() == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["-s", "truth.attitude.eror_deg"], "did you mean error_deg?"),
        (["-s", "truth.atitude.error_deg"], "did you mean truth.attitude?"),
        (["-s", "truth.attitude.error_deg +"], "is not an expression"),
        (["-s", "1 + 1"], "names no logged signal"),
        (["-s", " , "], "names none"),
        (["--from", "3", "--until", "2"], "nothing lies between"),
        (["-s", "truth.attitude.error_deg", "-o", "x.gif"], "one of png, svg, pdf"),
    ],
)
def test_mistakes_are_named(
    logs: tuple[Path, Path], words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2 with the near miss or what is wrong, and no picture."""
    before = sorted(logs[0].parent.iterdir())
    assert main(["plot", str(logs[0]), *words]) == 2
    assert said in capsys.readouterr().err
    assert sorted(logs[0].parent.iterdir()) == before


def test_an_empty_window_is_said(logs: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    """Where the log has no sample there is no picture: exit code 3."""
    assert main(["plot", str(logs[0]), "--from", "100"]) == 3
    assert "no sample" in capsys.readouterr().err
