"""`hilsat info` says what is in a log: held against what was done to make it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tools.cli import main
from tools.log.mcap_reader import read_run
from tools.report.info import collect_info, format_info
from tools.run.bench import Bench


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten seconds with a fault that bites, one that is refused and one that comes and goes."""
    path = tmp_path_factory.mktemp("info") / "run.mcap"
    with Bench.open("zhang2018-flight", ["duration_s=10", "expect=[]", "faults=[]"], log=path) as bench:
        bench.inject(at_tick=50, unit="wheel.2", kind="dead", until_s=1.5, id="gone")
        bench.inject(at_tick=60, unit="gyro.x", kind="dead", id="deaf")
        bench.inject(at_tick=90, unit="gyro.x", kind="dead", id="deaf")
        bench.run_to_end()
    return path


def test_it_tells_what_was_done(log: Path) -> None:
    """Length, end, topics and each fault with its times, as the bench was told."""
    info = collect_info(read_run(log))
    assert (info.scenario, info.simulated_s, info.finished, info.missing) == ("zhang2018-flight", 10.0, True, ())
    assert info.outcome is None
    gone, deaf, refused = info.faults
    assert (gone.id, gone.unit, gone.kind, gone.onset_s, gone.end_s) == ("gone", "wheel.2", "dead", 0.5, 1.5)
    assert (deaf.onset_s, deaf.effect_s, deaf.end_s) == (0.6, 0.6, None)
    assert refused.id == "deaf refused at tick 90"
    assert refused.onset_s is None
    assert info.topics["/truth/attitude"] == 1000
    text = format_info(info)
    assert "gone: wheel.2 dead: onset 0.5 s" in text
    assert len(text.splitlines()) < 50


def test_it_says_how_a_killed_run_ended(log: Path, tmp_path: Path) -> None:
    """Of a file that was cut it says so, what is missing, and what mends it."""
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[: int(log.stat().st_size * 0.5)])
    info = collect_info(read_run(cut))
    assert not info.finished
    assert "hilsat recover" in info.ended
    assert 0.0 < info.simulated_s < 10.0
    assert any("log ends early" in line for line in info.missing)


def test_the_verb_answers_for_each_log(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """JSON on stdout for what can be read; what cannot be is named on stderr, with the exit code of a trouble."""
    rubbish = tmp_path / "rubbish.mcap"
    rubbish.write_bytes(b"no log at all")
    assert main(["info", "--json", str(log), str(rubbish), str(tmp_path / "none.mcap")]) == 3
    said = capsys.readouterr()
    assert json.loads(said.out)["scenario"] == "zhang2018-flight"
    assert len(said.err.splitlines()) == 2
    assert "Traceback" not in said.err
