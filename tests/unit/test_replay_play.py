"""`hilsat replay LOG --to BUS`: every frame, in order, at its time, onto whatever bus it is."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import can
import numpy as np
import pytest

from bus.errors import BusLostError, RecordError
from bus.wire.address import open_transport
from bus.wire.frames import FRAME_SIZE
from bus.wire.transport import TransportCounters
from tools.cli import main
from tools.log.mcap_reader import WIRE_DTYPE, read_run
from tools.log.python_can_mcap import McapLogWriter
from tools.replay.play import Played, Selection, play
from tools.run.bench import Bench

FSW_IDS = {0x081, 0x110, 0x111, 0x112, 0x113, 0x702}


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds at 10 Hz."""
    path = tmp_path_factory.mktemp("play") / "run.mcap"
    with Bench.open("zhang2018", ["duration_s=2", "expect=[]", "faults=[]"], log=path) as bench:
        bench.run_to_end()
    return path


def wire_frames(log: Path) -> bytes:
    """All frames of a log as they go onto a bus."""
    frames = read_run(log).frames("bus0")
    wire = np.zeros(len(frames), WIRE_DTYPE)
    for name in ("id", "dlc", "data"):
        wire[name] = frames[name]
    return wire.tobytes()


class Tape:
    """A bus that keeps what it is given, and when; it takes `room` frames at a time and is gone after `last` frames."""

    def __init__(self, room: int = 1 << 30, last: int = 1 << 30) -> None:
        self.address, self.node = "tape:", "tape"
        self.counters = TransportCounters()
        self.batches: list[tuple[float, bytes]] = []
        self._room, self._last = room, last

    @property
    def data(self) -> bytes:
        return b"".join(batch for _, batch in self.batches)

    def send(self, batch: bytes) -> None:
        if self.counters.tx >= self._last:
            raise BusLostError("tape: it is gone")
        count = min(len(batch) // FRAME_SIZE, self._room)
        self.counters.tx += count
        self.counters.tx_failed += len(batch) // FRAME_SIZE - count
        self.batches.append((time.monotonic(), batch[: count * FRAME_SIZE]))


def record(log: Path, selection: Selection, tape: Tape | None = None) -> tuple[Tape, Played]:
    tape, played = tape or Tape(), Played()
    play(read_run(log), tape, selection, played)  # type: ignore[arg-type]
    return tape, played


def test_every_frame_is_played_in_its_order(log: Path) -> None:
    """The very bytes of the log, and the count of them."""
    tape, played = record(log, Selection(speed=0.0))
    assert tape.data == wire_frames(log)
    assert (played.frames, played.passes, played.left_out) == (len(tape.data) // FRAME_SIZE, 1, 0)


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_frames_come_at_their_time(log: Path, speed: float) -> None:
    """Never before it, against the log's own times; the whole takes as long as it took, by the factor."""
    tape, played = record(log, Selection(speed=speed))
    frames = read_run(log).frames("bus0")
    due_s = (np.unique(frames["t_ns"]) - frames["t_ns"][0]) * 1e-9 / speed
    came_s = np.array([t_s for t_s, _ in tape.batches]) - tape.batches[0][0]
    assert len(came_s) == len(due_s)
    assert (came_s - due_s).min() > -2e-3  # the first itself was a little late
    assert np.median(came_s - due_s) < 0.2
    assert played.wall_s >= due_s[-1]


def test_a_part_of_it_is_played(log: Path) -> None:
    """From one second to another, and one side alone: by the times and ids of the log."""
    frames = read_run(log).frames("bus0")
    tape, _ = record(log, Selection(speed=0.0, from_s=0.5, until_s=1.0))
    inside = (frames["t_ns"] >= 500_000_000) & (frames["t_ns"] < 1_000_000_000)
    assert tape.data == np.frombuffer(wire_frames(log), WIRE_DTYPE)[inside].tobytes()
    ours = np.isin(frames["id"], list(FSW_IDS))
    for side, chosen in (("fsw", ours), ("plant", ~ours)):
        tape, played = record(log, Selection(speed=0.0, only=side))  # type: ignore[arg-type]
        assert tape.data == np.frombuffer(wire_frames(log), WIRE_DTYPE)[chosen].tobytes()
        assert played.left_out == np.count_nonzero(~chosen)
    with pytest.raises(RecordError, match="no frame of bus0 is to be played from 9 s on that fsw sends"):
        record(log, Selection(speed=0.0, from_s=9.0, only="fsw"))


def test_it_is_played_again_and_again(log: Path) -> None:
    """Three times the same, the end of one a tick before the beginning of the next."""
    tape, played = record(log, Selection(speed=20.0, passes=3, from_s=1.0))
    whole = np.frombuffer(wire_frames(log), WIRE_DTYPE)[read_run(log).frames("bus0")["t_ns"] >= 1_000_000_000].tobytes()
    assert tape.data == 3 * whole
    assert played.passes == 3
    moments = np.array([t_s for t_s, _ in tape.batches])
    assert len(moments) == 30
    assert moments[-1] - moments[0] >= 29 * 0.1 / 20.0 - 2e-3


def test_a_full_bus_is_waited_for(log: Path) -> None:
    """It takes five frames at a time: none is lost, and none comes twice."""
    tape, played = record(log, Selection(speed=0.0), Tape(room=5))
    assert tape.data == wire_frames(log)
    assert played.frames * FRAME_SIZE == len(tape.data)


def test_a_bus_that_takes_nothing_any_more_is_given_up(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the count of what went out."""
    monkeypatch.setattr("tools.replay.play.FULL_S", 0.05)
    with pytest.raises(BusLostError, match=r"took no frame for 0.05 s"):
        record(log, Selection(speed=0.0), Tape(room=0))


def test_python_can_hears_it(log: Path) -> None:
    """A bus of python-can's own in this process, through the command line."""
    with can.Bus(interface="virtual", channel="replay-test", ignore_config=True) as bus:
        assert main(["replay", str(log), "--to", "virtual:replay-test", "--speed", "max"]) == 0
        heard = []
        while (message := bus.recv(0.0)) is not None:
            heard.append(message)
    wire = np.frombuffer(wire_frames(log), WIRE_DTYPE)
    assert [m.arbitration_id for m in heard] == wire["id"].tolist()
    assert b"".join(bytes(m.data).ljust(8, b"\0") for m in heard) == wire["data"].tobytes()


@contextlib.contextmanager
def listen(address: str) -> Iterator[list[bytes]]:
    """What the host of a hub hears while the body runs."""
    heard: list[bytes] = []
    done = threading.Event()
    with contextlib.closing(open_transport(address, node="listener", host=True, queue_frames=100_000)) as host:

        def hear() -> None:
            while not done.is_set():
                heard.append(host.recv(0.05))

        thread = threading.Thread(target=hear)
        thread.start()
        try:
            yield heard
        finally:
            done.set()
            thread.join()


def test_a_hub_hears_it(log: Path, short_tmpdir: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Every frame in its order, and what was sent as JSON."""
    with listen(f"hub:{short_tmpdir}/bus") as heard:
        assert main(["replay", str(log), "--to", f"hub:{short_tmpdir}/bus", "--speed", "max", "--json"]) == 0
        until = time.monotonic() + 10
        while time.monotonic() < until and sum(map(len, heard)) < len(wire_frames(log)):
            time.sleep(0.02)
    assert b"".join(heard) == wire_frames(log)
    words = json.loads(capsys.readouterr().out)
    assert (words["frames"], words["passes"]) == (len(wire_frames(log)) // FRAME_SIZE, 1)


def test_ctrl_c_stops_it_and_it_says_how_many_were_sent(log: Path, short_tmpdir: str) -> None:
    """An endless one on a hub that it carries: 130, the count, no traceback."""
    command = [sys.executable, "-P", "-m", "tools.cli", "replay", str(log), "--to", f"hub:{short_tmpdir}/bus", "--host"]
    with subprocess.Popen([*command, "--loop", "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as player:
        with contextlib.closing(open_transport(f"hub:{short_tmpdir}/bus", node="x", patience_s=30)) as node:
            assert node.recv(20.0)
        player.send_signal(signal.SIGINT)
        out, err = player.communicate(timeout=20)
    assert (player.returncode, err) == (130, b"")
    assert json.loads(out)["frames"] > 0


def test_a_bus_that_goes_away_ends_it(log: Path, short_tmpdir: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 3 with the bus named, in the middle and from the start."""
    address = f"hub:{short_tmpdir}/bus"
    ending = threading.Event()

    def carry() -> None:
        with listen(address) as heard:
            while not heard or not any(heard):
                time.sleep(0.02)
        ending.set()

    carrier = threading.Thread(target=carry)
    carrier.start()
    try:
        assert main(["replay", str(log), "--to", address, "--loop"]) == 3
    finally:
        carrier.join()
    assert ending.is_set()
    said = capsys.readouterr()
    assert "hub:" in said.err
    assert "frames sent" in said.out
    with pytest.raises(BusLostError):
        record(log, Selection(speed=0.0), Tape(last=50))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--to", "nonsense"], "names no transport"),
        (["--to", "memory:x"], "inside this process"),
        (["--to", "virtual:x", "--set", "fsw.controller.k1=1"], "--set and --to do not go together"),
        (["--to", "virtual:x", "--until", "1", "--from", "2"], "nothing is left to play"),
        (["--speed", "2"], "--speed belongs to --to BUS"),
        (["--until", "2"], "--until belongs to --to BUS"),
    ],
)
def test_what_cannot_be_asked_for_is_refused(
    log: Path, words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2, in one line."""
    assert main(["replay", str(log), *words]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--speed", "-1"], ["--speed", "nan"], ["--loop", "0"], ["--from", "-1"]])
def test_numbers_that_are_none_are_refused(log: Path, words: list[str]) -> None:
    """By the parser, with exit code 2."""
    with pytest.raises(SystemExit) as caught:
        main(["replay", str(log), "--to", "virtual:x", *words])
    assert caught.value.code == 2


def test_of_several_buses_one_is_to_be_named(tmp_path: Path) -> None:
    """And a log of frames alone, with times of the calendar, plays from its first frame on."""
    path = tmp_path / "two.mcap"
    with McapLogWriter(str(path)) as writer:
        for i in range(6):
            writer.on_message_received(
                can.Message(
                    timestamp=1.7e9 + i, arbitration_id=i, data=[i], is_extended_id=False, channel=f"can{i % 2}"
                )
            )
    with pytest.raises(RecordError, match=r"several buses in it; there are: can0, can1 \(--channel\)"):
        record(path, Selection(speed=0.0))
    tape, _ = record(path, Selection(speed=1000.0, channel="can1", from_s=2.0))
    assert np.frombuffer(tape.data, WIRE_DTYPE)["id"].tolist() == [3, 5]
    with pytest.raises(RecordError, match="no bus can7 in it"):
        record(path, Selection(channel="can7"))


@pytest.mark.vcan
def test_a_kernel_interface_hears_it(vcan: None, log: Path) -> None:
    """On vcan0, every frame in its order."""
    with contextlib.closing(open_transport("socketcan:vcan0", node="listener", queue_frames=100_000)) as node:
        assert main(["replay", str(log), "--to", "socketcan:vcan0", "--speed", "50"]) == 0
        heard = b""
        while len(heard) < len(wire_frames(log)) and (batch := node.recv(5.0)):
            heard += batch
    assert heard == wire_frames(log)


def test_nothing_is_left_behind(log: Path, short_tmpdir: str) -> None:
    """A hub that it carried is gone with it."""
    assert main(["replay", str(log), "--to", f"hub:{short_tmpdir}/bus", "--host", "--speed", "max"]) == 0
    assert os.listdir(short_tmpdir) == []
