"""python-can's own commands on logs of ours: can_logconvert and can_player take .mcap as they take .asc and .blf."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
from pathlib import Path

import can
import pytest

from bus.icd.messages import dbc_path
from bus.wire.address import open_transport
from bus.wire.frames import FRAME
from tools.log.mcap_reader import read_run
from tools.run.bench import Bench

BIN = Path(sys.executable).parent
Row = tuple[int, int, bytes]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds at 10 Hz."""
    path = tmp_path_factory.mktemp("logs") / "run.mcap"
    with Bench.open("zhang2018", ["duration_s=2", "expect=[]", "faults=[]"], log=path) as bench:
        bench.run_to_end()
    return path


def run_tool(*command: str) -> str:
    """What a tool prints; it must end well."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def list_rows(log: Path) -> list[Row]:
    """Time [us], id and data of every frame, by our own reader."""
    frames = read_run(log).frames()
    columns = zip(frames["t_ns"].tolist(), frames["id"].tolist(), frames["dlc"].tolist(), frames["data"], strict=True)
    return [(round(t_ns / 1000), can_id, bytes(data[:dlc])) for t_ns, can_id, dlc, data in columns]


@pytest.mark.parametrize(
    "suffix",
    [".asc", ".log", *(pytest.param(suffix, marks=pytest.mark.slow) for suffix in (".blf", ".csv", ".trc", ".db"))],
)
def test_can_logconvert_there_and_back(log: Path, tmp_path: Path, suffix: str) -> None:
    """Every frame comes back through each format of python-can's, with its time to the microsecond where that keeps it."""
    there, back = tmp_path / f"run{suffix}", tmp_path / "back.mcap"
    run_tool(str(BIN / "can_logconvert"), str(log), str(there))
    with can.LogReader(there) as reader:
        foreign = list(reader)
    rows = list_rows(log)
    assert [(m.arbitration_id, bytes(m.data)) for m in foreign] == [row[1:] for row in rows]
    run_tool(str(BIN / "can_logconvert"), str(there), str(back))
    again = list_rows(back)
    assert [row[1:] for row in again] == [row[1:] for row in rows]
    since = [(row[0] - again[0][0]) - (before[0] - rows[0][0]) for row, before in zip(again, rows, strict=True)]
    assert max(map(abs, since)) <= (100 if suffix == ".trc" else 1)


def test_a_converted_log_is_a_log(log: Path, tmp_path: Path) -> None:
    """cantools decodes it by way of a candump log; our reader names its bus and its frames."""
    there, back = tmp_path / "run.log", tmp_path / "back.mcap"
    run_tool(str(BIN / "can_logconvert"), str(log), str(there))
    run_tool(str(BIN / "can_logconvert"), str(there), str(back))
    assert read_run(back).buses() == read_run(log).buses()
    decoded = subprocess.run(
        [str(BIN / "cantools"), "decode", "--single-line", dbc_path()],
        input=there.read_text(), capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    assert decoded.stdout.count(":: SYNC(") == 20


def test_can_player_plays_a_log_of_ours(log: Path, short_tmpdir: str) -> None:
    """Onto an embedded bus through python-can's interface plugin: every frame, in its order."""
    address, heard, done = f"hub:{short_tmpdir}/bus", [], threading.Event()
    with contextlib.closing(open_transport(address, node="listener", host=True, queue_frames=100_000)) as host:

        def hear() -> None:
            while not done.is_set():
                heard.append(host.recv(0.05))

        listener = threading.Thread(target=hear)
        listener.start()
        try:
            run_tool(str(BIN / "can_player"), "-i", "hilsat", "-c", address, str(log))
        finally:
            done.set()
            listener.join()
        heard.append(host.recv(0.2))
    frames = [(can_id, data[:dlc]) for can_id, dlc, data in FRAME.iter_unpack(b"".join(heard))]
    assert frames == [row[1:] for row in list_rows(log)]
