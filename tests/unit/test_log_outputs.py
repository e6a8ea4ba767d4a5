"""What the verbs on logs write: whole or not at all, and never in the place of what was there."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path

import can
import can.io.logger
import can.io.player
import pytest

from bus.errors import RecordError, UsageError
from bus.telemetry.link import Field, TickPacker, Topic, announce_topics, pack_frames
from bus.wire.frames import FRAME
from tools.log import diff, export, outputs, recover
from tools.log.mcap_reader import read_run
from tools.log.mcap_writer import McapWriter
from tools.log.python_can_mcap import McapLogReader, McapLogWriter, RefusedFrame
from tools.log.recorder import Recorder

ERROR = bytes((0, 8, 0, 0, 0, 0, 96, 0))  # a controller with a receive warning
PACKER = TickPacker([Topic("/truth/x", "hilsat/X", (Field("a"),))], 2)


def write_log(path: Path, ticks: int = 20) -> Path:
    recorder = Recorder(path, metadata={"run_id": "x"}, sources=[1])
    link = recorder.link(1)
    link.announce(announce_topics([PACKER], {1: "bus0"}))
    for tick in range(ticks):
        frame = FRAME.pack(0x190, 8, bytes(8))
        link.write_tick(
            tick, tick * 1000, pack_frames(1, tick, tick * 1000, frame) + PACKER.pack(tick, tick * 1000, 1.0)
        )
    link.close("done")
    recorder.close()
    return path


def run_verb(module: object, *words: str) -> int:
    parser = argparse.ArgumentParser()
    module.add_parser(parser.add_subparsers())  # type: ignore[attr-defined]
    args = parser.parse_args(list(words))
    return int(args.func(args))


WRITES: dict[str, Callable[[str, str], tuple[object, list[str]]]] = {
    "csv": lambda log, out: (export, ["export", log, "--to", "csv", "--topic", "/truth/x", "-o", out]),
    "npz": lambda log, out: (export, ["export", log, "--to", "npz", "-o", out]),
    "log": lambda log, out: (export, ["export", log, "--to", "log", "-o", out]),
    "blf": lambda log, out: (export, ["export", log, "--to", "blf", "-o", out]),
    "recover": lambda log, out: (recover, ["recover", log, "-o", out]),
}


@pytest.mark.parametrize("kind", WRITES)
def test_nothing_that_is_there_is_replaced_unasked(kind: str, tmp_path: Path) -> None:
    """A file, a dangling link and the log itself stay as they are; --force replaces the file, and never the log."""
    log = write_log(tmp_path / "run.mcap")
    if kind == "recover":
        log.write_bytes(log.read_bytes()[:-20])
    before = log.read_bytes()
    other, link = tmp_path / "precious", tmp_path / "link"
    other.write_text("precious")
    link.symlink_to(tmp_path / "nowhere")
    for out in (other, link, log):
        module, words = WRITES[kind](str(log), str(out))
        with pytest.raises(UsageError):
            run_verb(module, *words)
    module, words = WRITES[kind](str(log), str(log))
    with pytest.raises(UsageError, match="this is the log that is read"):
        run_verb(module, *words, "--force")
    assert (other.read_text(), log.read_bytes(), link.is_symlink()) == ("precious", before, True)
    assert not (tmp_path / "nowhere").exists()
    module, words = WRITES[kind](str(log), str(other))
    assert run_verb(module, *words, "--force") == 0
    assert other.read_bytes() != b"precious"
    assert sorted(os.listdir(tmp_path)) == ["link", "precious", "run.mcap"]


def test_csv_goes_into_a_directory_that_is_there_but_over_no_file(tmp_path: Path) -> None:
    """One file in the way stops the export; it stays, and so does everything else."""
    log = write_log(tmp_path / "run.mcap")
    (tmp_path / "csv").mkdir()
    (tmp_path / "csv" / "truth.x.csv").write_text("precious")
    with pytest.raises(UsageError, match=r"truth\.x\.csv is there already"):
        run_verb(export, "export", str(log), "--to", "csv", "-o", str(tmp_path / "csv"))
    assert (tmp_path / "csv" / "truth.x.csv").read_text() == "precious"


def test_a_file_that_fails_half_way_is_not_there(tmp_path: Path) -> None:
    """Neither the name nor the unfinished one is left; a name that was taken meanwhile stays whose it is."""
    source, out = write_log(tmp_path / "run.mcap"), tmp_path / "out"

    def write(path: Path, then: Callable[[], object]) -> None:
        with outputs.create(path, source) as part:
            part.write_text("mine")
            then()

    def fill_the_disk() -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(RecordError, match="No space"):
        write(out, fill_the_disk)
    assert os.listdir(tmp_path) == ["run.mcap"]
    with pytest.raises(UsageError, match="there already"):
        write(out, lambda: out.write_text("theirs"))
    assert out.read_text() == "theirs"
    assert len(os.listdir(tmp_path)) == 2
    with pytest.raises(UsageError, match="null"):
        write(Path("a\0b"), lambda: None)


def test_a_log_is_made_where_none_is(tmp_path: Path) -> None:
    """A writer on the name of a file is refused, and the file stays."""
    path = tmp_path / "old.mcap"
    path.write_text("precious")
    with pytest.raises(RecordError, match="there is a file of that name"):
        McapWriter(path)
    with pytest.raises(RecordError, match="there is a file of that name"):
        McapLogWriter(path)
    assert path.read_text() == "precious"


def test_a_log_that_its_recorder_did_not_finish_is_not_called_complete(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What a full disk leaves: closed, without a tick and without the recording's last word. And a whole one is whole."""
    writer = McapWriter(tmp_path / "stub.mcap")
    writer.add_metadata("run", {"run_id": "x"})
    writer.abandon()
    assert run_verb(recover, "recover", str(tmp_path / "stub.mcap")) == 3
    words = capsys.readouterr().out
    assert "not complete" in words
    assert "disk was full" in words
    log = write_log(tmp_path / "run.mcap")
    assert run_verb(recover, "recover", str(log)) == 0
    words = capsys.readouterr().out
    assert "complete (" in words
    assert "unwritten" not in words


def test_logs_without_a_message_are_not_the_same(tmp_path: Path) -> None:
    """Nothing was compared: that is no agreement."""
    a, b = write_log(tmp_path / "a.mcap", 0), write_log(tmp_path / "b.mcap", 0)
    with pytest.raises(RecordError, match="nothing was compared"):
        run_verb(diff, "diff", str(a), str(b))


def test_holes_are_told_on_stderr(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By export and diff, in front of what they do."""
    log = write_log(tmp_path / "run.mcap")
    (tmp_path / "cut.mcap").write_bytes(log.read_bytes()[:-20])
    run_verb(export, "export", str(tmp_path / "cut.mcap"), "--to", "csv", "--topic", "/truth/x")
    assert "has no end" in capsys.readouterr().err
    run_verb(diff, "diff", str(log), str(tmp_path / "cut.mcap"))
    assert "cut.mcap: the log has no end" in capsys.readouterr().err


# -- frames --------------------------------------------------------------------------------------------------------


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(can.io.player.MESSAGE_READERS, ".mcap", McapLogReader)
    monkeypatch.setitem(can.io.logger.MESSAGE_WRITERS, ".mcap", McapLogWriter)


def test_candump_keeps_error_classes_and_remote_lengths(tmp_path: Path) -> None:
    """As Linux's candump -L writes them: class and data of an error frame, length of a remote one."""
    with McapLogWriter(tmp_path / "x.mcap") as logger:
        for message in (
            can.Message(arbitration_id=4, is_extended_id=False, is_error_frame=True, data=ERROR, timestamp=1.0),
            can.Message(arbitration_id=0x191, is_extended_id=False, is_remote_frame=True, dlc=8, timestamp=1.1),
            can.Message(arbitration_id=0x12345, is_extended_id=True, is_remote_frame=True, dlc=0, timestamp=1.2),
            can.Message(arbitration_id=0x191, is_extended_id=False, data=b"\x01", timestamp=1.3),
        ):  # fmt: skip
            logger(message)
    assert run_verb(export, "export", str(tmp_path / "x.mcap"), "--to", "log", "-o", str(tmp_path / "x.log")) == 0
    lines = [line.removesuffix(" R") for line in (tmp_path / "x.log").read_text().splitlines()]
    assert lines == [
        "(1.000000) bus0 20000004#0008000000006000", "(1.100000) bus0 191#R8", "(1.200000) bus0 00012345#R",
        "(1.300000) bus0 191#01",
    ]  # fmt: skip


@pytest.mark.usefixtures("registered")
def test_stamps_beyond_2038_are_written_and_before_1970_refused(tmp_path: Path) -> None:
    """The log time has room; a negative or endless one is refused in words, and the log says so when it is read."""
    path = tmp_path / "x.mcap"
    with can.Logger(path) as logger:
        for stamp_s in (1.0, 2.0**31 + 0.5, 5e9):
            logger(can.Message(arbitration_id=1, timestamp=stamp_s, is_extended_id=False))
        for stamp_s in (-1.5, float("nan"), float("inf"), 1e12):
            with pytest.raises(RefusedFrame, match="takes times from 1970 to 2262"):
                logger(can.Message(arbitration_id=1, timestamp=stamp_s, is_extended_id=False))
        logger(can.Message(arbitration_id=1, timestamp=3.0, is_extended_id=False))
    assert [message.timestamp for message in can.LogReader(path)] == [1.0, 2.0**31 + 0.5, 5e9, 3.0]
    assert issubclass(RefusedFrame, can.CanError)
    assert "stamped -1.5 s" in read_run(path).metadata["recording"]["refused"]
