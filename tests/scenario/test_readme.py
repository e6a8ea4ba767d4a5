"""Every command of the README, as written: a quick start that does not start is worse than none."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()
BIN = Path(sys.executable).parent
ELSEWHERE = {  # commands that other tests run, because they need a partner, a kernel or a fresh machine
    "make": "run by the CI script itself",
    "hilsat plant": "test_cli.py::test_the_two_sides_meet_in_two_terminals",
    "hilsat fsw": "test_cli.py::test_the_two_sides_meet_in_two_terminals",
    "hilsat vcan": "test_vcan_runs.py",
    "hilsat inject": "test_break_it.py",
    "hilsat live": "test_live.py: five minutes at the pace of the clock",
    "hilsat campaign": "test_campaign_shipped.py, test_campaign_verb.py",
    "hilsat run zhang2018 --clock realtime": "test_break_it.py: five minutes each",
}


def commands() -> list[str]:
    """Indented lines of the README that are commands, without prompts and remarks."""
    lines = re.findall(r"^    ((?:\$ )?(?:make|hilsat|\.venv/bin/hilsat|cp) .*)$", README, re.MULTILINE)
    return [line.removeprefix("$ ").split("   #")[0].split("  #")[0].strip() for line in lines]


def is_elsewhere(command: str) -> bool:
    return any(command.startswith(start) for start in ELSEWHERE) or "socketcan" in command


@pytest.mark.slow
def test_the_readme_runs_as_written(tmp_path: Path) -> None:
    """In order, in a copy of the scenarios, with the log of the last run where the README writes runs/..."""
    (tmp_path / "scenarios").symlink_to(ROOT / "scenarios", target_is_directory=True)
    os.makedirs(tmp_path / ".venv")
    (tmp_path / ".venv" / "bin").symlink_to(BIN, target_is_directory=True)
    environment = {**os.environ, "PATH": f"{BIN}:{os.environ['PATH']}"}
    here = [command for command in commands() if not is_elsewhere(command)]
    assert len(here) >= 6
    own = tmp_path / "scenarios" / "mine.yaml"
    try:
        for command in here:
            logs = sorted(tmp_path.glob("runs/*/run.mcap"), key=lambda path: path.stat().st_mtime)
            text = command.replace("runs/.../run.mcap", str(logs[-1]) if logs else "")
            done = subprocess.run(
                shlex.split(text), cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    finally:
        own.unlink(missing_ok=True)


def test_the_readme_names_only_what_is_there() -> None:
    """Every relative link leads to a file of the project."""
    for target in re.findall(r"\]\(((?!http)[^)#]+)\)", README):
        assert (ROOT / target).exists(), target
