"""The command line as people mistype it: a clear word on stderr, nothing on stdout, the right exit code."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from subprocess import PIPE

import pytest

HILSAT = [sys.executable, "-P", "-m", "tools.cli"]
QUICK = ["--clock", "inprocess", "--no-plot", "-q"]


def hilsat(*words: str, timeout: float = 60) -> subprocess.CompletedProcess[str]:
    command = [*HILSAT, *words]
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_an_output_directory_is_not_written_twice(tmp_path: Path) -> None:
    """What is recorded is never overwritten."""
    assert hilsat("run", "zhang2018", *QUICK, "--out", str(tmp_path)).returncode == 0
    before = (tmp_path / "run.mcap").read_bytes()
    again = hilsat("run", "zhang2018", *QUICK, "--out", str(tmp_path))
    assert again.returncode == 2
    assert "run.mcap" in again.stderr
    assert (tmp_path / "run.mcap").read_bytes() == before


@pytest.mark.slow
def test_two_runs_never_share_a_directory(tmp_path: Path) -> None:
    """Started together with one --out: one flies and its log is that of its seed alone, the other is refused."""
    words = [*HILSAT, "run", "zhang2018-flight", *QUICK, "--json", "--set", "duration_s=20", "--set", "expect=[]"]
    words += ["--set", "faults=[]", "--out"]
    runs = [
        subprocess.Popen([*words, str(tmp_path / "x"), "--seed", seed], stdout=PIPE, stderr=PIPE, text=True)
        for seed in ("1", "2")
    ]
    told = [run.communicate(timeout=60) for run in runs]
    assert 2 in [run.returncode for run in runs]
    flown = next(index for index, run in enumerate(runs) if run.returncode != 2)
    assert "name another directory with --out" in told[1 - flown][1]
    alone = hilsat(*words[len(HILSAT) :], str(tmp_path / "alone"), "--seed", "12"[flown])
    digest = "digest of the run"
    assert json.loads(told[flown][0])["figures"][digest] == json.loads(alone.stdout)["figures"][digest]


@pytest.mark.slow
def test_what_is_in_a_directory_stays(tmp_path: Path) -> None:
    """--out onto a directory with files of the names that a run once used: each stays, and the run passes beside them."""
    mine = {
        name: f"mine {name}" for name in ("plant.json", "fsw.json", "meta.json", "plant.err", "fsw.err", "recorder.err")
    }
    for name, text in mine.items():
        (tmp_path / name).write_text(text)
    words = [
        "--clock",
        "lockstep",
        "--no-plot",
        "-q",
        "--set",
        "duration_s=2",
        "--set",
        "expect=[]",
        "--set",
        "faults=[]",
    ]
    hilsat("run", "zhang2018", *words, "--out", str(tmp_path))
    assert {path.name: path.read_text() for path in tmp_path.iterdir() if path.name != "run.mcap"} == mine
    assert (tmp_path / "run.mcap").stat().st_size > 1000


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["plant", "fsw"])
def test_a_log_that_is_there_is_never_written_over(verb: str, tmp_path: Path) -> None:
    """--log onto a file, or a dangling link: refused at once, and as it was."""
    (tmp_path / "old.mcap").write_text("mine")
    (tmp_path / "link.mcap").symlink_to(tmp_path / "nowhere")
    for name in ("old.mcap", "link.mcap"):
        done = hilsat(verb, "zhang2018", "--bus", f"hub:{tmp_path / 'bus'}", "--log", str(tmp_path / name))
        assert (done.returncode, done.stdout) == (2, "")
        assert f"{name}: there is a file of that name already" in done.stderr
    assert (tmp_path / "old.mcap").read_text() == "mine"
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.slow
def test_a_failed_recorder_of_one_side_is_infrastructure(tmp_path: Path) -> None:
    """`hilsat plant --log` onto a full disk: exit code 3 and the recorder's words."""
    done = hilsat("plant", "zhang2018", "--bus", f"hub:{tmp_path / 'bus'}", "--log", "/dev/full")
    assert done.returncode == 3
    assert "recorder: /dev/full: cannot write the log: No space left on device" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_the_flight_software_alone_ends_in_words(tmp_path: Path) -> None:
    """`hilsat fsw --log` that no plant answers: exit code 3, no traceback, a log that is closed properly."""
    log = tmp_path / "fsw.mcap"
    done = hilsat("fsw", "zhang2018", "--bus", f"hub:{tmp_path / 'bus'}", "--log", str(log))
    assert done.returncode == 3
    assert "has no host" in done.stderr
    assert "Traceback" not in done.stderr
    assert log.read_bytes().endswith(b"\x89MCAP0\r\n")


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["plant", "fsw"])
def test_a_side_that_is_told_twice_to_end_ends_once(verb: str, tmp_path: Path) -> None:
    """SIGTERM again and again while it waits for the other and cleans up: 143, no traceback, nothing left behind."""
    side = subprocess.Popen(
        [*HILSAT, verb, "zhang2018", "--bus", f"hub:{tmp_path / 'bus'}"],
        stderr=PIPE, text=True, env={**os.environ, "TMPDIR": str(tmp_path)},
    )  # fmt: skip
    until = time.monotonic() + 20
    while time.monotonic() < until and not list(tmp_path.glob("hilsat-*")):
        time.sleep(0.05)
    time.sleep(0.3)
    while side.poll() is None and time.monotonic() < until:
        side.send_signal(signal.SIGTERM)
        time.sleep(0.001)
    assert side.communicate()[1] == ""
    assert side.returncode in (143, -signal.SIGTERM)  # the latter when one comes after all is done
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_file_called_like_the_socket_of_a_bus_stays(tmp_path: Path) -> None:
    """hub:DIR with somebody's own file hub.sock in it: refused in words, and the file is as it was."""
    bus = tmp_path / "bus"
    bus.mkdir(mode=0o700)
    (bus / "hub.sock").write_text("mine")
    done = hilsat("run", "zhang2018", "--bus", f"hub:{bus}", "--no-plot", "-q", "--out", str(tmp_path / "out"))
    assert done.returncode == 2
    assert "no socket of a bus" in done.stderr
    assert (bus / "hub.sock").read_text() == "mine"


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


@pytest.mark.slow
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
