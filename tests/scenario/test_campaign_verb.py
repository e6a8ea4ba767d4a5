"""`hilsat campaign FILE`: exit codes, words, what is left behind, and stopping it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tools.campaign.pool import Solo
from tools.campaign.results import read_info, read_results
from tools.cli import main

CAMPAIGN = """\
name: two-laws
title: Two laws, two bounds
base: zhang2018-flight
seed: 3
set:
  duration_s: {duration_s}
  faults: []
  fsw.controller.kind: $controller
  expect:
    - {{name: rate, check: below, signal: norm(fsw.attitude.omega_bi_b_hat_rad_s), unit: rad/s, bound: $bound}}
axes:
  controller: [smc, pid]
  bound: {bounds}
repeats: {repeats}
metrics:
  effort: {{integral: norm(fsw.control.tau_cmd_b_nm), unit: N m s}}
"""


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs are flown in this process: for what has nothing to do with workers, whose start takes a second."""
    monkeypatch.setattr(
        "tools.campaign.launch.Pool", lambda job, directory, jobs, limit_s, halt: Solo(job, directory, halt)
    )


def write_file(
    place: Path, bounds: str = "[1.0, 0.001]", duration_s: float = 0.5, repeats: int = 1, name: str = "two.yaml"
) -> Path:
    path = place / name
    path.write_text(CAMPAIGN.format(bounds=bounds, duration_s=duration_s, repeats=repeats))
    return path


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(("bounds", "code"), [("[1.0, 2.0]", 0), ("[1.0, 0.001]", 1)])
def test_exit_code_says_how_it_ended(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], bounds: str, code: int
) -> None:
    """0 when every run passed, 1 when one did not; the JSON object says the same, and stderr is empty with -q."""
    out = tmp_path / "out"
    assert main(["campaign", str(write_file(tmp_path, bounds)), "--out", str(out), "--json", "-q"]) == code
    said = capsys.readouterr()
    summary: dict[str, Any] = json.loads(said.out)
    results = read_results(out)
    assert summary["exit_code"] == code
    assert summary["runs"] == summary["flown"] == len(results) == 4
    assert summary["counts"] == ({"pass": 4} if code == 0 else {"pass": 2, "fail": 2})
    assert said.err == ""
    assert {tuple(result.labels.values()) for result in results} >= {("smc", "1"), ("pid", "1")}
    assert all(result.metrics["effort"] for result in results)
    assert read_info(out).metrics == {"effort": "N m s"}


@pytest.mark.usefixtures("here")
def test_a_run_that_cannot_be_flown_is_exit_code_3(tmp_path: Path) -> None:
    """A log that has no room makes its run INFRA, and the campaign's exit code 3."""
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, before[1]))
    try:
        words = ["campaign", str(write_file(tmp_path)), "--out", str(tmp_path / "out"), "-q", "--keep-logs", "all"]
        assert main(words) == 3
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.usefixtures("here")
def test_tables_for_people(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Progress goes to stderr; cells, worst runs with the command that repeats each and the directory to stdout."""
    out = tmp_path / "out"
    assert main(["campaign", str(write_file(tmp_path)), "--out", str(out)]) == 1
    said = capsys.readouterr()
    assert "4 of 4 runs" in said.err
    assert f"hilsat run {out}#" in said.out
    assert f"results  {out}" in said.out
    assert "4 of 4 runs" not in said.out


def test_dry_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The runs, how many and how long; nothing is written."""
    path = write_file(tmp_path, repeats=2)
    assert main(["campaign", str(path), "--dry-run", "--out", str(tmp_path / "out")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + 8 + 1
    assert lines[-1].startswith("8 runs, ")
    assert main(["campaign", str(path), "--dry-run", "--json"]) == 0
    plan = json.loads(capsys.readouterr().out)
    assert [run["number"] for run in plan["runs"]] == list(range(8))
    assert len({run["seed"] for run in plan["runs"]}) == 8
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nosuch.yaml"], "nosuch.yaml"),
        (["two.yaml", "-j", "0"], "-j 0"),
        (["two.yaml", "--limit", "-1"], "--limit"),
        (["two.yaml", "--keep-logs", "some"], "failures"),
        (["two.yaml", "--bus", "hub:"], "--clock"),
        (["two.yaml", "--clock", "lockstep", "--dask", "local"], "--dask"),
        (["two.yaml", "--retry-infra"], "--resume"),
        (["two.yaml", "--set", "seeed=1"], "seed"),
        (["two.yaml", "--resume", "nosuch"], "nosuch"),
        ([], "--resume"),
    ],
)
def test_what_cannot_be_used_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: list[str], said: str
) -> None:
    """Exit code 2 (3 where something cannot be read), the culprit named, and no directory made."""
    monkeypatch.chdir(tmp_path)
    write_file(tmp_path)
    assert main(["campaign", *words]) in (2, 3)
    heard = capsys.readouterr()
    assert said in heard.err
    assert "Traceback" not in heard.err
    assert heard.out == ""
    assert [path.name for path in tmp_path.iterdir()] == ["two.yaml"]


@pytest.mark.usefixtures("here")
def test_resume_refuses_a_file_that_has_changed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Going on takes file and overrides from what was noted; a file that is another one now is refused by name."""
    out, path = tmp_path / "out", write_file(tmp_path)
    main(["campaign", str(path), "--out", str(out), "-q", "--set", "set.duration_s=0.4"])
    before = (out / "results.jsonl").read_bytes()
    assert main(["campaign", "--resume", str(out), "-q"]) == 1
    assert (out / "results.jsonl").read_bytes() == before
    assert '"duration_s=0.4"' in before.decode()
    write_file(tmp_path, repeats=2)
    capsys.readouterr()
    assert main(["campaign", "--resume", str(out), "-q"]) == 2
    assert "text of its file" in capsys.readouterr().err
    path.unlink()
    assert main(["campaign", "--resume", str(out), "-q"]) == 2
    assert "not there any more" in capsys.readouterr().err


def test_dask_that_is_missing_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without Dask: how to install it."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["campaign", str(write_file(tmp_path)), "--dask", "local", "--out", str(tmp_path / "out")]) == 2
    assert "pip install 'hilsat[cluster]'" in capsys.readouterr().err


@pytest.fixture
def flying(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """A campaign of many runs in a session of its own, some runs of which are done."""
    out = tmp_path / "out"
    path = write_file(tmp_path, "[1.0, 2.0]", duration_s=2, repeats=25)
    words = [sys.executable, "-P", "-m", "tools.cli", "campaign", str(path), "--out", str(out), "-j", "2"]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        until = time.monotonic() + 60.0
        while time.monotonic() < until and not ((out / "timings.jsonl").is_file() and read_lines(out) > 2):
            time.sleep(0.02)
        yield process, out
        process.kill()


def read_lines(out: Path) -> int:
    return (out / "results.jsonl").read_bytes().count(b"\n")


def list_children(pid: int) -> list[int]:
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def wait_for_end(pids: list[int]) -> list[int]:
    """Those of the processes that are still there after some seconds."""
    until = time.monotonic() + 10.0
    while time.monotonic() < until and any(Path(f"/proc/{pid}").exists() for pid in pids):
        time.sleep(0.05)
    return [pid for pid in pids if Path(f"/proc/{pid}").exists()]


def test_ctrl_c(flying: tuple[subprocess.Popen[str], Path]) -> None:
    """Ctrl-C in the terminal: exit code 130, how to go on, whole results in order, and no process left."""
    process, out = flying
    workers = list_children(process.pid)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=30)
    assert process.returncode == 130
    assert f"hilsat campaign --resume {out}" in said
    assert "Traceback" not in said
    results = read_results(out)
    assert 2 < len(results) < 100
    assert [result.number for result in results] == sorted(result.number for result in results)
    assert all(result.outcome == "pass" for result in results)
    assert workers
    assert wait_for_end(workers) == []


@pytest.mark.slow
def test_killed(flying: tuple[subprocess.Popen[str], Path]) -> None:
    """SIGKILL of the campaign itself: its workers end too, and it can be gone on with without flying a run again."""
    process, out = flying
    workers = list_children(process.pid)
    process.kill()
    process.communicate(timeout=30)
    assert workers
    assert wait_for_end(workers) == []
    done = read_lines(out)
    info = read_info(out)
    path = Path(info.provenance["path"])
    path.write_text(info.file)
    words = [sys.executable, "-P", "-m", "tools.cli", "campaign", "--resume", str(out), "-q", "--json", "-j", "2"]
    ended = subprocess.run(words, capture_output=True, text=True, check=False, timeout=200)
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout)["flown"] == 100 - done
    assert [result.number for result in read_results(out)] == list(range(100))


@pytest.mark.slow
def test_nobody_reads_the_table(tmp_path: Path) -> None:
    """`| head` ends it quietly."""
    path = write_file(tmp_path, duration_s=0.1, repeats=10)
    words = f"{sys.executable} -P -m tools.cli campaign {path} --dry-run | head -1"
    ended = subprocess.run(["bash", "-c", words], capture_output=True, text=True, check=False, timeout=60)
    assert "Traceback" not in ended.stderr
    assert ended.stdout.startswith("run")


def test_the_word_run_may_be_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`hilsat campaign run FILE` is `hilsat campaign FILE`."""
    path = str(write_file(tmp_path))
    assert main(["campaign", "run", path, "--dry-run"]) == main(["campaign", path, "--dry-run"]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("0 ")]
    assert len(lines) == 2
    assert lines[0] == lines[1]


def test_a_campaign_flown_as_a_scenario_says_how_to_fly_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Not the keys of a scenario that it lacks: both commands that it is for."""
    path = str(write_file(tmp_path))
    assert main(["run", path]) == 2
    err = capsys.readouterr().err
    assert f"`hilsat campaign {path}`" in err
    assert f"`hilsat run {path}#N`" in err


@pytest.mark.usefixtures("here")
def test_nothing_required_is_said(tmp_path: Path) -> None:
    """A run of which nothing is required is not executed, and its reason says that."""
    path = tmp_path / "bare.yaml"
    path.write_text("name: bare\nbase: zhang2018-flight\nseed: 1\nset: {duration_s: 0.5, faults: [], expect: []}\n")
    assert main(["campaign", str(path), "-q", "--out", str(tmp_path / "out")]) == 1
    (result,) = read_results(tmp_path / "out")
    assert result.outcome == "not executed"
    assert result.reason.startswith("nothing is required of it")


def test_a_refusal_has_no_progress(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A directory that is there already: one line, and none that says that no run has been flown."""
    path = str(write_file(tmp_path))
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "file").touch()
    assert main(["campaign", path, "--out", str(tmp_path / "there")]) == 2
    assert "runs," not in capsys.readouterr().err
