"""The command line as people mistype it: a clear word on stderr, nothing on stdout, the right exit code."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

QUICK = ["--clock", "inprocess", "--no-plot", "-q"]


def hilsat(*words: str, timeout: float = 60) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P", "-m", "tools.cli", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["run", "zhang2081"], 2, "did you mean zhang2018?"),
        (["run", "no/such/file.yaml"], 2, "no/such/file.yaml"),
        (["rum"], 2, "invalid choice"),
        (["run", "zhang2018", "--bus", "hubb:/tmp/x"], 2, "hub"),
        (["run", "zhang2018", "--bus", "socketcan:nosuchcan0"], 2, "nosuchcan0"),
        (["run", "zhang2018", "--set", "fsw.controler.k1=2"], 2, "controller"),
        (["run", "zhang2018", "--seed", "-1"], 2, "seed"),
        (["run", "zhang2018", "--set", "bus.bitrate_bps=10000"], 2, "bit"),
        (["check", "scenarios"], 2, "scenarios"),
        (["grade", "nothing.mcap"], 3, "nothing.mcap"),
        (["plant", "zhang2018"], 2, "--bus"),
        (["recover", "nothing.mcap"], 3, "nothing.mcap"),
    ],
)
def test_mistakes_are_named(words: list[str], code: int, message: str, tmp_path: Path) -> None:
    """Each mistake ends with its exit code, says what is wrong, and shows no traceback."""
    out = ["--out", str(tmp_path / "out")] if words[0] == "run" else []
    done = hilsat(*words, *out)
    assert done.returncode == code, done.stderr
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert not done.stdout


def test_a_run_that_never_begins_says_why_and_no_more(tmp_path: Path) -> None:
    """Both sides miss the bus: said once, without a grade of what was never flown."""
    words = ["run", "zhang2018", "--bus", "socketcan:nosuchcan0", "--out", str(tmp_path / "out")]
    done = hilsat(*words)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("nosuchcan0 is not there") == 1
    told = json.loads(hilsat(*words[:-1], str(tmp_path / "again"), "--json").stdout)
    assert (told["exit_code"], told["grade"], told["figures"], len(told["run"]["problems"])) == (2, None, {}, 1)


def test_a_run_grades_and_regrades(tmp_path: Path) -> None:
    """The grade on the run's JSON, the grade from the log alone, and the one attached to the log agree."""
    run = hilsat("run", "zhang2018", *QUICK, "--json", "--out", str(tmp_path))
    assert run.returncode == 0, run.stderr
    graded = json.loads(run.stdout)["grade"]
    again = hilsat("grade", str(tmp_path / "run.mcap"), "--json")
    assert again.returncode == 0
    assert json.loads(again.stdout) == graded


def test_a_failed_expectation_is_exit_code_1(tmp_path: Path) -> None:
    """With the observer switched off the reproduction must fail, or its grade would be worth nothing."""
    run = hilsat("run", "zhang2018", *QUICK, "--set", "fsw.observer={kind: none}", "--out", str(tmp_path))
    assert run.returncode == 1, run.stderr
    assert "FAIL  settles to 1 deg" in run.stdout


def test_an_output_directory_is_not_written_twice(tmp_path: Path) -> None:
    """What is recorded is never overwritten."""
    assert hilsat("run", "zhang2018", *QUICK, "--out", str(tmp_path)).returncode == 0
    before = (tmp_path / "run.mcap").read_bytes()
    again = hilsat("run", "zhang2018", *QUICK, "--out", str(tmp_path))
    assert again.returncode == 2
    assert "run.mcap" in again.stderr
    assert (tmp_path / "run.mcap").read_bytes() == before


def test_the_two_sides_meet_in_two_terminals(tmp_path: Path) -> None:
    """`hilsat plant` and `hilsat fsw` by themselves, started in either order, end with 0; a second plant is refused."""
    bus = f"hub:{tmp_path / 'bus'}"
    side = [sys.executable, "-P", "-m", "tools.cli"]
    fsw = subprocess.Popen([*side, "fsw", "zhang2018", "--bus", bus], stderr=subprocess.PIPE, text=True)
    log = tmp_path / "plant.mcap"
    plant = subprocess.Popen(
        [*side, "plant", "zhang2018", "--bus", bus, "--log", str(log)], stderr=subprocess.PIPE, text=True
    )
    try:
        assert plant.wait(60) == 0, plant.communicate()
        assert fsw.wait(10) == 0, fsw.communicate()
    finally:
        plant.kill()
        fsw.kill()
    assert log.stat().st_size > 100_000


def test_a_second_bench_on_one_bus_is_refused(tmp_path: Path) -> None:
    """The bus directory is locked by its host; the second run ends with 3 and names it, the first goes on."""
    bus = f"hub:{tmp_path / 'bus'}"
    words = ["--bus", bus, "--set", "duration_s=3000", "--set", "expect=[]", "--no-plot", "-q"]
    first = subprocess.Popen(
        [sys.executable, "-P", "-m", "tools.cli", "run", "zhang2018", *words, "--out", str(tmp_path / "a")],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        until = time.monotonic() + 20
        while time.monotonic() < until and not (tmp_path / "bus").exists():
            time.sleep(0.05)
        time.sleep(0.5)
        second = hilsat("run", "zhang2018", *words, "--out", str(tmp_path / "b"))
        assert second.returncode == 3
        assert str(tmp_path / "bus") in second.stderr
        assert first.poll() is None
    finally:
        first.terminate()
        assert first.wait(20) == 143


def test_a_directory_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    """A file in the way: said before anything is started."""
    (tmp_path / "file").write_text("")
    done = hilsat("run", "zhang2018", *QUICK, "--out", str(tmp_path / "file" / "out"))
    assert done.returncode == 2
    assert "out" in done.stderr
