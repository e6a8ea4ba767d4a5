"""A bench in Python with sockets: found, asked and broken from another thread as another program would, and left clean."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from bus.errors import UsageError
from tools.cli import main
from tools.run.bench import Bench

OVERRIDES = ["duration_s=1000", "expect=[]", "faults=[]", "inject=allowed"]


@pytest.fixture
def private() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="hs") as name:
        yield Path(name)


def test_a_bench_in_python_takes_faults_from_outside(private: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """While it is stepped: set with --wait, listed, cleared; when it is closed, the sockets go."""
    bench = Bench.open("nominal", OVERRIDES, log="memory", ground_dir=private)
    ended = threading.Event()

    def step() -> None:
        while not ended.wait(0.001):
            bench.step()

    thread = threading.Thread(target=step)
    thread.start()
    try:
        where = ["--run", str(private)]
        assert main(["inject", "wheel.2", "loss", "effectiveness=0.3", "--id", "mine", "--wait", *where]) == 0
        assert main(["inject", "list", *where]) == 0
        assert main(["inject", "clear", "mine", *where]) == 0
        assert main(["inject", "clear", "mine", *where]) == 2
    finally:
        ended.set()
        thread.join()
    out = capsys.readouterr().out
    assert "mine  first changed something at tick" in out
    assert "wheel.2 loss" in out
    phases = [fault["phase"] for fault in bench.log.faults if fault["id"] == "mine"]
    assert phases[:3] == ["onset", "effect", "cleared"]
    bench.close()
    assert list(private.iterdir()) == []


def test_a_directory_that_is_too_deep_is_refused(private: Path) -> None:
    """A socket's name has 107 bytes: said with what to do, and nothing is left open."""
    deep = private / ("d" * 100)
    deep.mkdir()
    with pytest.raises(UsageError, match="TMPDIR"):
        Bench.open("nominal", OVERRIDES, ground_dir=deep)
    assert list(deep.iterdir()) == []
