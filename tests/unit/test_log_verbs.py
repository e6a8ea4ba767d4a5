"""`hilsat recover`, `export`, `diff`, and python-can's own tools on our logs."""

from __future__ import annotations

import argparse
import csv
import json
import math
import tomllib
from pathlib import Path

import can
import can.io.logger
import can.io.player
import numpy as np
import pytest
from mcap.reader import make_reader

import bus
from bus.errors import RecordError, UsageError
from bus.telemetry.link import Field, TickPacker, Topic, announce_topics, pack_frames
from bus.wire.frames import FRAME
from tools.log import diff as digest
from tools.log import export, recover
from tools.log.mcap_reader import Run, read_run
from tools.log.python_can_mcap import McapLogReader, McapLogWriter
from tools.log.recorder import Recorder

PACKER = TickPacker([Topic("/truth/x", "hilsat/X", (Field("a", "float64", 2), Field("n", "uint32")))], 2)
NOISY = TickPacker([Topic("/fsw/timing", "hilsat/Timing", (Field("us"),), deterministic=False)], 101)


def write_log(path: Path, ticks: int = 300, *, change: int = -1, us: float = 1.0, close: bool = True) -> Path:
    """A run of two frames and one record a tick; at tick `change` one value and one frame are other ones."""
    recorder = Recorder(path, metadata={"run_id": path.stem}, sources=[1])
    link = recorder.link(1)
    link.announce(announce_topics([PACKER, NOISY], {1: "bus0"}))
    for tick in range(ticks):
        odd = tick == change
        t_ns = tick * 10_000_000
        batch = FRAME.pack(0x190, 8, bytes(7) + bytes([odd])) + FRAME.pack(0x80012345, 3, b"abc" + bytes(5))
        values = PACKER.pack(tick, t_ns, 0.1 * tick, -1.0 if odd else 1.0, tick)
        link.write_tick(tick, t_ns, pack_frames(1, tick, t_ns, batch) + values + NOISY.pack(tick, t_ns, us))
        if tick == 100:
            link.fault(t_ns, tick, "rw1", "loss", "onset", 0.5)
    if close:
        link.close("done")
        recorder.close()
    else:
        recorder.flush()
    return path


def run_verb(module: object, *words: str) -> int:
    parser = argparse.ArgumentParser()
    module.add_parser(parser.add_subparsers())  # type: ignore[attr-defined]
    args = parser.parse_args(list(words))
    return int(args.func(args))


# -- recover -------------------------------------------------------------------------------------------------------


def test_recover_makes_a_cut_log_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Cut inside the only chunk: its beginning is salvaged, the summary written, and what is lost is said."""
    path = write_log(tmp_path / "run.mcap", 20_000)
    raw = path.read_bytes()
    path.write_bytes(raw[: int(len(raw) * 0.7)])
    assert run_verb(recover, "recover", str(path), "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["out"] == str(tmp_path / "run.recovered.mcap")
    with open(found["out"], "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        times = [message.log_time for _, _, message in reader.iter_messages("/truth/x")]
        names = [metadata.name for metadata in reader.iter_metadata()]
    assert times == [tick * 10_000_000 for tick in range(len(times))]
    assert len(times) > 10_000
    assert found["last_s"] == pytest.approx(times[-1] * 1e-9)
    assert names == ["run", "recovery"]
    assert found["salvaged"] > 0
    assert found["cut_bytes"] > 0
    assert run_verb(recover, "recover", str(path), "-o", str(tmp_path / "again.mcap")) == 0
    words = capsys.readouterr().out
    assert "belong to no whole record" in words
    assert "0.5 s" in words


def test_recover_of_a_log_without_an_end(tmp_path: Path) -> None:
    """What a killed recorder leaves after a flush: everything flushed is there, nothing is cut."""
    path = write_log(tmp_path / "run.mcap", 50, close=False)
    found = recover.recover(path, tmp_path / "whole.mcap")
    assert (found.complete, found.cut_bytes, found.salvaged) == (False, 0, 0)
    assert len(read_run(tmp_path / "whole.mcap").t_ns("/truth/x")) == 50
    assert read_run(tmp_path / "whole.mcap").digest() == read_run(path).digest()


def test_recover_leaves_a_whole_log_alone_and_never_overwrites_its_source(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing to do is said; the log itself as the output is a usage error; a text is no log."""
    path = write_log(tmp_path / "run.mcap")
    assert run_verb(recover, "recover", str(path)) == 0
    assert "nothing to recover" in capsys.readouterr().out
    assert not (tmp_path / "run.recovered.mcap").exists()
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(UsageError, match="this is the log that is read"):
        recover.recover(path, path)
    (tmp_path / "text").write_text("text")
    with pytest.raises(RecordError, match="not an MCAP file"):
        recover.recover(tmp_path / "text", tmp_path / "out.mcap")


def test_recover_tells_of_a_chunk_damaged_inside(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A flipped byte in compressed data: zstd's checksum finds it, the rest is kept, the exit code is 3."""
    path = write_log(tmp_path / "run.mcap", 5000)
    raw = bytearray(path.read_bytes())
    with open(path, "rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) > 1
    raw[summary.chunk_indexes[0].chunk_start_offset + 2000] ^= 0xFF
    path.write_bytes(raw)
    assert run_verb(recover, "recover", str(path)) == 3
    assert "1 damaged chunk: " in capsys.readouterr().out
    assert 0 < len(read_run(tmp_path / "run.recovered.mcap").t_ns("/truth/x")) < 5000


# -- export --------------------------------------------------------------------------------------------------------


def test_csv_keeps_every_digit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Read back with float(), the values are the logged ones bit for bit; vectors have a column each."""
    path = write_log(tmp_path / "run.mcap")
    assert run_verb(export, "export", str(path), "--to", "csv", "--topic", "/truth/x") == 0
    rows = list(csv.DictReader(capsys.readouterr().out.splitlines()))
    assert list(rows[0]) == ["t_s", "a[0]", "a[1]", "n"]
    assert [float(row["a[0]"]) for row in rows] == [0.1 * tick for tick in range(300)]
    assert [int(row["n"]) for row in rows] == list(range(300))


def test_csv_of_everything_goes_into_a_directory(tmp_path: Path) -> None:
    """One file a topic, frames and faults included."""
    path = write_log(tmp_path / "run.mcap")
    assert run_verb(export, "export", str(path), "--to", "csv", "-o", str(tmp_path / "csv")) == 0
    names = {file.name for file in (tmp_path / "csv").iterdir()}
    assert names == {"truth.x.csv", "fsw.timing.csv", "can.bus0.csv", "events.csv", "faults.csv"}
    frames = list(csv.DictReader((tmp_path / "csv" / "can.bus0.csv").read_text().splitlines()))
    assert len(frames) == 600
    assert frames[1] == {"t_s": "0.0", "id": "0x80012345", "dlc": "3", "data": "616263"}
    faults = list(csv.DictReader((tmp_path / "csv" / "faults.csv").read_text().splitlines()))
    assert [(row["t_s"], row["unit"], row["value"]) for row in faults] == [("1.0", "rw1", "0.5")]


def test_npz_holds_all_signals(tmp_path: Path) -> None:
    """Keys by topic and field, times in ns."""
    path = write_log(tmp_path / "run.mcap")
    assert run_verb(export, "export", str(path), "--to", "npz", "-o", str(tmp_path / "run.npz")) == 0
    with np.load(tmp_path / "run.npz") as arrays:
        assert set(arrays) == {
            "truth.x.t_ns", "truth.x.a", "truth.x.n", "fsw.timing.t_ns", "fsw.timing.us",
        }  # fmt: skip
        assert arrays["truth.x.a"].shape == (300, 2)
        assert arrays["truth.x.t_ns"][-1] == 2_990_000_000


@pytest.mark.parametrize("form", ["log", "asc", "blf"])
def test_frames_are_read_back_by_python_can(form: str, tmp_path: Path) -> None:
    """Identifier, kind, length, data of every frame, and times to the format's resolution."""
    path = write_log(tmp_path / "run.mcap")
    out = tmp_path / f"run.{form}"
    assert run_verb(export, "export", str(path), "--to", form, "-o", str(out)) == 0
    with can.LogReader(out) as reader:
        got = [(m.arbitration_id, m.is_extended_id, bytes(m.data), m.timestamp) for m in reader]
    assert len(got) == 600
    assert got[0][:3] == (0x190, False, bytes(8))
    assert got[599][:3] == (0x12345, True, b"abc")
    assert got[599][3] - got[0][3] == pytest.approx(2.99, abs=1e-4)


def test_wrong_exports_are_answered(tmp_path: Path) -> None:
    """A topic that is not there, signals as frames, frames as npz, no file, and a place that is not there."""
    path = str(write_log(tmp_path / "run.mcap", 5))
    for words, message in (
        (("--to", "csv", "--topic", "/u"), "no topic /u; there are: /can/bus0"),
        (("--to", "csv"), "takes one --topic of"),
        (("--to", "blf"), "-o FILE.blf"),
        (("--to", "log", "--topic", "/truth/x", "-o", str(tmp_path / "x.log")), "/truth/x has no frames"),
        (("--to", "npz", "--topic", "/can/bus0", "-o", str(tmp_path / "x.npz")), "no signals"),
    ):
        with pytest.raises(UsageError, match=message):
            run_verb(export, "export", path, *words)
    with pytest.raises(RecordError, match="cannot write: No such file"):
        run_verb(export, "export", path, "--to", "npz", "-o", str(tmp_path / "none" / "x.npz"))
    with pytest.raises(RecordError, match="cannot write: No space left"):
        run_verb(export, "export", path, "--to", "csv", "--topic", "/truth/x", "-o", "/dev/full")


# -- diff ----------------------------------------------------------------------------------------------------------


def test_diff_of_equal_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is marked as not deterministic, and metadata, may differ."""
    a, b = write_log(tmp_path / "a.mcap"), write_log(tmp_path / "b.mcap", us=2.0)
    assert run_verb(digest, "diff", str(a), str(b)) == 0
    assert capsys.readouterr().out.startswith("the same: ")


def test_diff_names_topic_tick_and_field(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The frame that differs at tick 42, as candump writes it; with frames alike, the field and its values."""
    a, b = write_log(tmp_path / "a.mcap"), write_log(tmp_path / "b.mcap", change=42)
    assert run_verb(digest, "diff", str(a), str(b), "--json") == 1
    result = json.loads(capsys.readouterr().out)
    assert result["first"] == {
        "topic": "/can/bus0", "tick": 42, "t_s": pytest.approx(0.42), "field": "frame 0",
        "a": "190#0000000000000000", "b": "190#0000000000000001",
    }  # fmt: skip
    assert result["differing_topics"] == ["/can/bus0", "/truth/x"]
    assert run_verb(digest, "diff", str(a), str(b)) == 1
    assert "/can/bus0, tick 42, 0.420000 s: frame 0" in capsys.readouterr().out
    field = digest._compare_topic(read_run(a), read_run(b), "/truth/x")
    assert field is not None
    assert (field.tick, field.field, field.a[1], field.b[1]) == (42, "a", 1.0, -1.0)


def test_diff_of_a_shorter_run(tmp_path: Path) -> None:
    """Where one stops, the other's next tick is the difference."""
    runs: list[Run] = [read_run(write_log(tmp_path / f"{n}.mcap", n)) for n in (300, 200)]
    first = digest.compare_runs(*runs).first
    assert first is not None
    assert (first.tick, first.field, first.a, first.b) == (200, "number of messages", 300, 200)


UNITS = TickPacker(
    [
        Topic(
            "/fsw/y",
            "hilsat/Y",
            (Field("rate_rad_s", "float64", 2, "rad/s"), Field("tau_nm", "float64", 1, "N m"), Field("inner_rad_s")),
        )
    ],
    101,
)


def write_signals(path: Path, rate: float = 0.0, tau: float = 0.0, inner: float = 0.0, ticks: int = 100) -> str:
    """A run of signals with units; from tick 50 on each is off by so much."""
    recorder = Recorder(path, metadata={"run_id": path.stem}, sources=[2])
    link = recorder.link(2)
    link.announce(announce_topics([UNITS]))
    for tick in range(ticks):
        off = (rate, tau, inner) if tick >= 50 else (0.0, 0.0, 0.0)
        values = UNITS.pack(tick, tick * 10_000_000, 1.0, 2.0 + off[0], 0.1 + off[1], off[2])
        link.write_tick(tick, tick * 10_000_000, values)
    link.event(0, "info", "fsw", path.stem)
    link.close("done")
    recorder.close()
    return str(path)


def test_diff_within_a_tolerance_per_unit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Off by 2^-20 rad/s: the same within 1e-6 of that unit and no other, whether the log or the name says the unit."""
    size = 2.0**-20
    a = write_signals(tmp_path / "run.mcap")
    (tmp_path / "b").mkdir()
    b = write_signals(tmp_path / "b" / "run.mcap", rate=size)
    assert run_verb(digest, "diff", a, b) == 1
    words = capsys.readouterr().out
    assert "/fsw/y, tick 50, 0.500000 s: rate_rad_s" in words
    assert "fsw.y.rate_rad_s: by 9.54e-07 rad_s at most, first at 0.5 s, on 50 records" in words
    for unit in ("rad_s", "rad/s"):
        assert run_verb(digest, "diff", a, b, "--tolerance", f"{unit}=1e-6") == 0
    assert "the same within what is allowed" in capsys.readouterr().out
    assert run_verb(digest, "diff", a, b, "--tolerance", "rad_s=9e-7") == 1
    assert run_verb(digest, "diff", a, b, "--tolerance", "nm=1") == 1
    (tmp_path / "c").mkdir()
    c = write_signals(tmp_path / "c" / "run.mcap", inner=size, tau=math.nan)
    capsys.readouterr()
    assert run_verb(digest, "diff", a, c, "--tolerance", "rad_s=1e-6", "--tolerance", "nm=1e9", "--json") == 1
    result = json.loads(capsys.readouterr().out)
    assert result["first"]["field"] == "tau_nm"
    found = {signal["field"]: (signal["count"], signal["largest"]) for signal in result["signals"]}
    assert found == {"tau_nm": (50, None), "inner_rad_s": (0, size)}


def test_diff_without_what_is_ignored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A signal, a topic, a field of an event; what is left must be equal; nothing left, or a name nobody has, is told."""
    a, b = write_signals(tmp_path / "a.mcap"), write_signals(tmp_path / "b.mcap", tau=0.5)
    assert run_verb(digest, "diff", a, b, "--ignore", "fsw.y.tau_nm", "--ignore", "events.message") == 0
    assert run_verb(digest, "diff", a, b, "--ignore", "/fsw/y", "--ignore", "/events.message") == 0
    assert run_verb(digest, "diff", a, b, "--ignore", "fsw.y.tau_nm") == 1
    assert "/events" in capsys.readouterr().out
    assert run_verb(digest, "diff", a, b, "--ignore", "events") == 1
    short = write_signals(tmp_path / "short.mcap", ticks=80)
    assert run_verb(digest, "diff", a, short, "--tolerance", "nm=1", "--ignore", "events") == 1
    assert "/fsw/y, tick 80, 0.800000 s: number of messages" in capsys.readouterr().out
    with pytest.raises(UsageError, match="did you mean tau_nm"):
        run_verb(digest, "diff", a, b, "--ignore", "fsw.y.tau_mn")
    with pytest.raises(UsageError, match="no signal has the unit furlong"):
        run_verb(digest, "diff", a, b, "--tolerance", "furlong=1")
    with pytest.raises(UsageError, match="takes UNIT=NUMBER"):
        run_verb(digest, "diff", a, b, "--tolerance", "nm")
    everything = [word for name in ("fsw.y", "events", "faults") for word in ("--ignore", name)]
    with pytest.raises(RecordError, match="nothing was compared"):
        run_verb(digest, "diff", a, b, *everything)


# -- python-can ----------------------------------------------------------------------------------------------------


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(can.io.player.MESSAGE_READERS, ".mcap", McapLogReader)
    monkeypatch.setitem(can.io.logger.MESSAGE_WRITERS, ".mcap", McapLogWriter)


@pytest.mark.usefixtures("registered")
def test_python_can_writes_and_reads_mcap(tmp_path: Path) -> None:
    """Every kind of classic frame through can.Logger and can.LogReader, and the file is a log like ours."""
    path = tmp_path / "x.mcap"
    messages = [
        can.Message(timestamp=1.0, arbitration_id=0x123, data=b"\x01\x02", is_extended_id=False, channel="vcan0"),
        can.Message(timestamp=1.5, arbitration_id=0x1ABCDEFF, data=bytes(8), is_extended_id=True, channel="vcan0"),
        can.Message(
            timestamp=1.75, arbitration_id=0x7FF, is_remote_frame=True, dlc=4, is_extended_id=False, channel="b"
        ),
        can.Message(
            timestamp=2.0, arbitration_id=0x20, is_error_frame=True, data=bytes(8), is_extended_id=False, channel="b"
        ),
    ]
    with can.Logger(path) as logger:
        for message in messages:
            logger(message)
    with can.LogReader(path) as reader:
        got = list(reader)
    assert all(a.equals(b, timestamp_delta=1e-9, check_direction=False) for a, b in zip(got, messages, strict=True))
    assert next(iter(can.LogReader(path, channel="b"))).arbitration_id == 0x7FF
    with open(path, "rb") as file:
        assert len(list(make_reader(file, validate_crcs=True).iter_messages())) == 4
    with pytest.raises(RecordError, match="CAN FD"), can.Logger(tmp_path / "y.mcap") as logger:
        logger(can.Message(is_fd=True))


@pytest.mark.usefixtures("registered")
def test_python_can_plays_a_run(tmp_path: Path) -> None:
    """Frames of a recorded run, in order, with their times in seconds."""
    with can.LogReader(write_log(tmp_path / "run.mcap")) as reader:
        frames = list(reader)
    assert len(frames) == 600
    assert frames[599].timestamp == pytest.approx(2.99)
    assert frames[0].channel == "bus0"


def test_the_package_registers_the_plugins() -> None:
    """The entry points that python-can looks for name these classes."""
    project = tomllib.loads((Path(bus.__file__).resolve().parents[1] / "pyproject.toml").read_text())["project"]
    points = project["entry-points"]
    assert points["can.io.message_reader"] == {".mcap": f"{McapLogReader.__module__}:{McapLogReader.__name__}"}
    assert points["can.io.message_writer"] == {".mcap": f"{McapLogWriter.__module__}:{McapLogWriter.__name__}"}
