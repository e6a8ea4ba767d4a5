"""docs/ground-station.md: its tables are those of the code, and its commands run."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from fsw import tuning
from fsw.ground import can_forward, downlink
from fsw.modes import MODE_VERBS, Mode

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "ground-station.md").read_text(encoding="utf-8")


def test_the_rates_of_the_page_are_those_of_the_streams() -> None:
    """Every stream is on the page with its number and rate, and no other."""
    rows = re.findall(r"^\| [A-Z_]+ (\d+)[^|]*\| ([\d.]+) Hz", PAGE, re.MULTILINE)
    assert {int(number): float(rate) for number, rate in rows} == downlink.RATES_HZ | {0: 1.0}


def test_the_modes_of_the_page_are_those_of_the_flight() -> None:
    """Numbers, names, and which can be commanded."""
    rows = re.findall(r"^\| (\d) \| (\w+)[^|]*\|[^|]*\| (yes|no)", PAGE, re.MULTILINE)
    assert [(int(number), name) for number, name, _ in rows] == [(int(mode), mode.name.lower()) for mode in Mode]
    assert {name for _, name, can in rows if can == "yes"} == {mode.name.lower() for mode in MODE_VERBS.values()}
    assert all(f"`{verb}`" in PAGE for verb in MODE_VERBS)


def test_the_parameters_of_the_page_are_those_that_can_be_changed() -> None:
    """In their order, with their words."""
    rows = re.findall(r"^\| ([A-Z_0-9]+) \| [^|]+ \| ([^|]+) \|$", PAGE, re.MULTILINE)
    assert rows == [(number.name, number.text) for number in tuning.NUMBERS]


def test_the_limits_of_the_page_are_those_of_the_code() -> None:
    """Of the frames that are forwarded."""
    assert f"At most {can_forward.FRAMES_A_TICK} frames a tick and {can_forward.FRAMES_A_S} a second" in PAGE


def test_the_lines_for_mavproxy_are_those_that_are_tested() -> None:
    """Each line of the page is typed in by tests/ground/test_programs.py."""
    tested = (ROOT / "tests" / "ground" / "test_programs.py").read_text(encoding="utf-8")
    lines = [line for line in re.findall(r"^    (.*)$", PAGE, re.MULTILINE) if line.startswith(("param ", "long "))]
    assert len(lines) == 3
    for line in lines:
        assert f'"{line}"' in tested


@pytest.mark.slow
def test_the_commands_of_the_page_run(tmp_path: Path, short_tmpdir: str) -> None:
    """Every `hilsat run` line as it stands, two seconds of it, and the line that makes the key."""
    (making,) = re.findall(r"^    (head .*)$", PAGE, re.MULTILINE)
    subprocess.run(["sh", "-c", making], cwd=tmp_path, check=True)
    lines = [line.split("  #")[0].strip() for line in re.findall(r"^    (hilsat run .*)$", PAGE, re.MULTILINE)]
    lines += re.findall(r"`(hilsat run [^`]*)`", PAGE)
    assert len(lines) >= 6
    short = ["--set", "duration_s=2", "--set", "expect=[]", "--set", "faults=[]", "--no-plot", "-q"]
    for line in lines:
        words = [sys.executable, "-P", "-m", "tools.cli", *shlex.split(line)[1:], *short]
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": short_tmpdir}
        done = subprocess.run(
            words, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=60, check=False
        )
        # nothing is expected of so short a run: it ended well, and nothing was graded
        assert "nothing was graded" in done.stdout, f"{line}\n{done.stdout}\n{done.stderr}"
