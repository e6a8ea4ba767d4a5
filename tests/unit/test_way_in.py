"""The `hilsat` command before its verbs: whose packages they are, what was not foreseen, where output cannot go."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import hilsat
from tools import cli

ENTRY = "import sys; from hilsat import main; sys.exit(main())"


def start_hilsat(*words: str, shell: str = "", **environment: str) -> subprocess.CompletedProcess[str]:
    """As the console script does, which has nothing but the packages' place on its path."""
    command = ["sh", "-c", f'exec "$@" {shell}', "sh", sys.executable, "-P", "-c", ENTRY, *words]
    environment = {**os.environ, "PYTHONPATH": hilsat.HOME} | environment
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, env=environment)


@pytest.mark.parametrize("name", ["bus", "fsw", "plant_server", "tools"])
@pytest.mark.parametrize("kind", ["package", "module"])
def test_another_package_of_one_of_our_names_is_told_apart(name: str, kind: str, tmp_path: Path) -> None:
    """Each of the four hidden by a package or a module: exit code 2, its name and its place, no traceback."""
    place = tmp_path / name / "__init__.py" if kind == "package" else tmp_path / f"{name}.py"
    place.parent.mkdir(exist_ok=True)
    place.write_text("")
    done = start_hilsat("--version", PYTHONPATH=f"{tmp_path}:{hilsat.HOME}")
    assert done.returncode == 2
    assert done.stderr == f"hilsat: the package '{name}' that Python finds is not ours but {place}; run in a venv\n"


def test_our_own_packages_are_not_told_apart() -> None:
    """The command says its version, also from a directory that has a plain folder called tools."""
    done = start_hilsat("--version")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("hilsat ")


def test_the_entry_point_is_the_way_in() -> None:
    """What the wheel's console script calls, and ships."""
    text = (Path(hilsat.HOME) / "pyproject.toml").read_text()
    assert 'hilsat = "hilsat:main"' in text
    assert '"hilsat"' in text[text.index("[tool.hatch.build.targets.wheel]") :].split("\n")[1]


def test_what_was_not_foreseen_in_a_verb_is_3_and_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """1 means graded a fail: a crash must not look like it. The traceback is in a file, or shown with --debug."""
    broken = tmp_path / "broken.py"
    broken.write_text(
        "def add_parser(subparsers):\n    subparsers.add_parser('grade').set_defaults(func=lambda args: 1 / 0)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setitem(cli.VERBS, "grade", ("broken", "fails"))
    monkeypatch.setenv("HILSAT_TRACES", str(tmp_path))
    assert cli.main(["grade"]) == 3
    told = capsys.readouterr().err
    trace = next(tmp_path.glob("hilsat-traceback-*.txt"))
    assert told == (
        f"hilsat: unforeseen ZeroDivisionError: division by zero; the traceback is in {trace}; please report it\n"
    )
    assert "broken.py" in trace.read_text()
    assert cli.main(["--debug", "grade"]) == 3
    assert "Traceback" in capsys.readouterr().err


CLOSED = ">&- 2>&- <&-"
NOWHERE = [
    ">/dev/full 2>&1",
    *(pytest.param(s, marks=pytest.mark.slow) for s in (">/dev/full", ">&-", "2>/dev/full", CLOSED)),
]


@pytest.mark.parametrize("shell", NOWHERE)
def test_output_that_goes_nowhere_does_not_change_the_verdict(shell: str, tmp_path: Path) -> None:
    """A check that passes and one that fails, with streams that are full or closed: 0 and 2, and no traceback."""
    bad = tmp_path / "bad.yaml"
    bad.write_text("name: 3\n")
    for words, code in ((["check", "zhang2018"], 0), (["check", str(bad)], 2)):
        done = start_hilsat(*words, shell=shell)
        assert done.returncode == code, done.stderr
        assert "Traceback" not in done.stderr
        assert "Exception ignored" not in done.stderr
    if shell == ">/dev/full":
        assert (
            "stdout cannot be written: No space left on device"
            in start_hilsat("check", "zhang2018", shell=shell).stderr
        )
