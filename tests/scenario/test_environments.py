"""A run in the surroundings that daemons, cron, containers and odd accounts give it: the verdict is the same in all."""

from __future__ import annotations

import itertools
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest

HILSAT = [sys.executable, "-P", "-m", "tools.cli"]
STREAMS = ["", "<&-", ">&-", "2>&-", "<&- >&-", "<&- 2>&-", ">&- 2>&-", "<&- >&- 2>&-", ">/dev/full", "2>/dev/full"]
ENCODINGS: list[dict[str, str]] = [
    {},
    {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    {"PYTHONIOENCODING": "ascii"},
    {"PYTHONIOENCODING": "latin-1:strict"},
    {"LC_ALL": "no_SUCH.locale"},
]
UMASKS = ["022", "077", "000"]
PLACES = ["unset", "empty", "missing", "long"]
CLOCKS = ["inprocess", "lockstep", "realtime"]
# Every value of each kind at least once, in combinations that a fixed seed drew.
COMBINATIONS = random.Random(20180).sample(list(itertools.product(STREAMS, ENCODINGS, UMASKS, PLACES, CLOCKS)), 30)
SCENARIO = """
extends: {shipped}
name: environments
title: Lageregelung mit Störung → λ
duration_s: 4
faults: []
expect:
  - {{name: "Zeigefehler ≤ 180°", check: below, signal: truth.attitude.error_deg, bound: {bound}, unit: deg}}
"""


def make_environment(place: str, tmp_path: Path, encoding: dict[str, str]) -> dict[str, str]:
    """The process's environment with a TMPDIR of that kind."""
    environment = {key: value for key, value in os.environ.items() if key not in ("TMPDIR", "TEMP", "TMP")} | encoding
    if place == "empty":
        environment["TMPDIR"] = ""
    elif place == "missing":
        environment["TMPDIR"] = str(tmp_path / "nowhere")
    elif place == "long":  # longer than the address of a socket may be
        long = tmp_path / ("d" * 120)
        long.mkdir()
        environment["TMPDIR"] = str(long)
    return environment


def write_scenario(tmp_path: Path, bound: float) -> Path:
    """A noisy scenario with letters beyond ASCII whose one requirement is met for a bound of 180 and not for 1."""
    shipped = Path(__file__).resolve().parents[2] / "scenarios" / "zhang2018-flight.yaml"
    path = tmp_path / "environments.yaml"
    path.write_text(SCENARIO.format(shipped=shipped, bound=bound), encoding="utf-8")
    return path


@pytest.mark.slow
@pytest.mark.parametrize(("streams", "encoding", "umask", "place", "clock"), COMBINATIONS)
def test_a_verdict_does_not_depend_on_the_surroundings(
    streams: str, encoding: dict[str, str], umask: str, place: str, clock: str, tmp_path: Path
) -> None:
    """A scenario that passes ends with 0, one that fails with 1, in every combination; never a traceback, a log each."""
    environment = make_environment(place, tmp_path, encoding)
    for bound, expected in ((180.0, 0), (1.0, 1)):
        out = tmp_path / f"out-{expected}"
        words = [*HILSAT, "run", str(write_scenario(tmp_path, bound)), "--clock", clock, "--no-plot", "--out", str(out)]
        shell = ["sh", "-c", f'umask {umask}; exec "$@" {streams}', "sh", *words]
        done = subprocess.run(shell, capture_output=True, timeout=60, check=False, env=environment)
        assert done.returncode == expected, done.stderr
        assert b"Traceback" not in done.stderr
        assert b"Exception ignored" not in done.stderr
        assert (out / "run.mcap").read_bytes().endswith(b"\x89MCAP0\r\n")
        assert [path.name for path in out.iterdir()] == ["run.mcap"]


def test_without_a_temporary_directory_a_run_says_so(tmp_path: Path) -> None:
    """No directory that can be written: exit code 3, one line and what to do, nothing started."""
    code = "import tempfile; tempfile._candidate_tempdir_list = lambda: ['/proc/nowhere']; from tools.cli import main; "
    words = ["run", "zhang2018", "--no-plot", "-q", "--out", str(tmp_path / "out")]
    done = subprocess.run(
        [sys.executable, "-P", "-c", f"{code} raise SystemExit(main({words!r}))"],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 3
    assert done.stderr.startswith("hilsat: cannot make a temporary directory: ")
    assert "set TMPDIR" in done.stderr
    assert done.stderr.count("\n") == 1
