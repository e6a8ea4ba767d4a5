"""Replays in a process of its own, and of another version of the flight software: a copy of its packages with something
changed in it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

import fsw
from bus.errors import ConfigError, PeerLostError, RecordError
from bus.settings import build, plain
from fsw.config import FswConfig
from tools.cli import main
from tools.log.mcap_reader import read_run
from tools.replay.picture import Series, choose_signals
from tools.replay.process import leave_out_defaults
from tools.run.bench import Bench
from tools.verbs.replay import replay, replay_open_loop

ROOT = Path(fsw.__file__).resolve().parents[1]
TUMBLING = ["fsw.modes.damping_nm_s=0.5", "fsw.modes.detumble_above_deg_s=1", "plant.body.rate_deg_s=[3,2,1]"]
START = "        flight, clock, counters = "  # of FswNode.tick
SHORT = ["duration_s=4", "expect=[]", "faults=[]", "clock.mode=inprocess"]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A body that tumbles, so that its rate is damped."""
    path = tmp_path_factory.mktemp("elsewhere") / "run.mcap"
    with Bench.open("zhang2018", [*SHORT, *TUMBLING], log=path) as bench:
        bench.run_to_end()
    return path


def copy_version(place: Path, **edits: tuple[str, str]) -> Path:
    """The packages of the flight software as another checkout would have them; a__b: text in a/b.py, and the text now."""
    for name in ("bus", "fsw"):
        shutil.copytree(ROOT / name, place / name, ignore=shutil.ignore_patterns("*.so", "compiled.json"))
    for name, (before, after) in edits.items():
        path = place / (name.replace("__", "/") + ".py")
        text = path.read_text(encoding="utf-8")
        assert before in text
        path.write_text(text.replace(before, after), encoding="utf-8")
    return place


def test_another_process_says_the_same(log: Path) -> None:
    """Every count and no divergence, as in this process."""
    assert asdict(replay(log, process=True)) == asdict(replay(log))
    assert replay(log).same


def test_a_version_that_damps_twice_as_much_says_what_twice_the_damping_says(log: Path, tmp_path: Path) -> None:
    """A change of the source and the same change of a setting: signal by signal the same open loop."""
    home = copy_version(tmp_path / "other", fsw__flight=("k = -self.damping_nm_s", "k = -2.0 * self.damping_nm_s"))
    by_source, by_setting = replay_open_loop(log, home=home), replay_open_loop(log, ["fsw.modes.damping_nm_s=1.0"])
    assert by_source.as_dict() == by_setting.as_dict()
    assert "fsw.control.tau_cmd_b_nm" in [change.signal for change in by_source.changes]
    assert by_source.frames_differing > 0
    both = replay_open_loop(log, ["fsw.modes.damping_nm_s=0.25"], home=home)
    assert both.same  # twice a half


def test_the_same_version_in_a_directory_differs_in_nothing(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 0, and it says that it is an open loop and of what."""
    assert main(["replay", str(log), "--fsw", str(ROOT)]) == 0
    assert f"open loop with the flight software of {ROOT}: 0 of" in capsys.readouterr().out


def test_a_version_that_dies_is_named_with_its_tick(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 3, no traceback, and the next log is not concerned."""
    edit = (
        START,
        "        if tick == 20: import os; os._exit(7)\n" + START,
    )
    home = copy_version(tmp_path / "other", fsw__node=edit)
    assert main(["replay", str(log), "--fsw", str(home), "--json"]) == 3
    said = capsys.readouterr()
    assert f"the flight software of {home} ended with exit code 7, tick 20" in said.err
    assert json.loads(said.out)["error"] in said.err
    with pytest.raises(PeerLostError):
        replay_open_loop(log, home=home)


@pytest.mark.slow
def test_a_version_that_raises_is_named_with_its_tick(log: Path, tmp_path: Path) -> None:
    """What it raised, in one line."""
    edit = (
        START,
        "        if tick == 9: raise ValueError('odd')\n" + START,
    )
    with pytest.raises(RecordError, match=r"tick 9: ValueError: odd"):
        replay_open_loop(log, home=copy_version(tmp_path / "other", fsw__node=edit))


def test_a_version_without_what_it_is_fed_by_is_named(log: Path, tmp_path: Path) -> None:
    """The name that is missing, and where it was looked for."""
    home = copy_version(tmp_path / "other", fsw__node=("class FswNode", "class FlightNode"))
    with pytest.raises(RecordError, match=r"cannot import name 'FswNode' from 'fsw.node'.*cannot be flown here"):
        replay_open_loop(log, home=home)


def test_a_version_that_lacks_a_setting_flies_where_it_is_at_its_default(log: Path, tmp_path: Path) -> None:
    """Left out, it is what that version always does; set to something else, it is refused by its name."""
    home = copy_version(
        tmp_path / "other",
        fsw__settings=("    feed_forward: bool = True", "    # feed_forward: bool = True"),
        fsw__flight=("config.guidance.feed_forward", "True"),
    )
    assert replay_open_loop(log, home=home).same
    with pytest.raises(ConfigError, match="feed_forward"):
        replay_open_loop(log, ["fsw.guidance.feed_forward=false"], home=home)


def test_settings_without_their_defaults_mean_the_same() -> None:
    """For every shipped kind: built from what is left, the settings are those that they were."""
    from tools.config.loader import load_scenario
    from tools.config.scenario_files import find_scenario, list_shipped

    for name in list_shipped()[::4]:
        settings = load_scenario(find_scenario(name)).scenario.fsw
        sparse = leave_out_defaults(settings)
        assert build(FswConfig, sparse, name) == settings
        assert len(json.dumps(sparse)) < len(json.dumps(plain(settings)))


@pytest.mark.parametrize("missing", ["bus", "fsw"])
def test_a_directory_without_flight_software_is_refused(
    log: Path, tmp_path: Path, missing: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2, with what is missing."""
    home = copy_version(tmp_path / "other")
    shutil.rmtree(home / missing)
    assert main(["replay", str(log), "--fsw", str(home)]) == 2
    assert f"there is no package {missing} in it" in capsys.readouterr().err


# -- logs of another version ---------------------------------------------------------------------------------------


def rewrite(source: Path, target: Path, edit: Callable[[str, str, bytes], bytes]) -> Path:
    """The same log by an outside library, with other files and schemas: edit(what, name, data)."""
    with source.open("rb") as reading, target.open("wb") as writing:
        reader, writer = make_reader(reading), Writer(writing)
        writer.start()
        summary = reader.get_summary()
        assert summary is not None
        schemas = {
            key: writer.register_schema(s.name, s.encoding, edit("schema", s.name, s.data))
            for key, s in summary.schemas.items()
        }
        channels = {
            key: writer.register_channel(c.topic, c.message_encoding, schemas.get(c.schema_id, 0), dict(c.metadata))
            for key, c in summary.channels.items()
        }
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, dict(record.metadata))
        for file in reader.iter_attachments():
            data = edit("file", file.name, file.data)
            writer.add_attachment(file.create_time, file.log_time, file.name, file.media_type, data)
        for _, channel, message in reader.iter_messages(log_time_order=False):
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
        writer.finish()
    return target


def replace_in(what: str, name: str, before: bytes, after: bytes) -> Callable[[str, str, bytes], bytes]:
    def edit(kind: str, called: str, data: bytes) -> bytes:
        if (kind, called) != (what, name):
            return data
        assert before in data
        return data.replace(before, after)

    return edit


def test_a_log_with_another_icd_is_refused_with_its_lines(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The line of either side; another comment is none of a difference."""
    edit = replace_in("file", "icd.dbc", b"16|32@1- (1E-07,0)", b"16|32@1- (1E-06,0)")
    assert main(["replay", str(rewrite(log, tmp_path / "a.mcap", edit))]) == 3
    words = capsys.readouterr().err
    assert "the log: SG_ TORQUE : 16|32@1- (1E-06,0)" in words
    assert "here: SG_ TORQUE : 16|32@1- (1E-07,0)" in words
    assert "and 4 more" in words  # of four wheels, on both sides
    assert "the log is of hilsat" in words
    comment = replace_in("file", "icd.dbc", b'"Flight software."', b'"Software\nof flight."')
    assert replay(rewrite(log, tmp_path / "b.mcap", comment)).same


def test_a_version_with_another_icd_is_refused_with_its_lines(log: Path, tmp_path: Path) -> None:
    """What counts is the ICD of what flies."""
    home = copy_version(tmp_path / "other")
    dbc = home / "bus/icd/icd.dbc"
    dbc.write_text(dbc.read_text().replace("16|32@1- (1E-07,0)", "16|32@1- (1E-05,0)"))
    with pytest.raises(RecordError, match=r"here: SG_ TORQUE : 16\|32@1- \(1E-05,0\)"):
        replay_open_loop(log, home=home)


def test_a_log_with_other_fields_is_refused_with_all_of_them(log: Path, tmp_path: Path) -> None:
    """By topic and field, before anything is flown."""
    edit = replace_in("schema", "hilsat/msg/FswExecutive", b"rivals", b"doubles")
    words = (
        r"/fsw/executive: the log has float64 doubles; here it has float64 rivals; the log is of hilsat .*, this is h"
    )
    with pytest.raises(RecordError, match=words):
        replay(rewrite(log, tmp_path / "a.mcap", edit))


def test_a_log_whose_scenario_is_of_another_version_says_so(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 3 with the key; the version that knows the key can be flown on it all the same."""
    edit = replace_in("file", "scenario.yaml", b"feed_forward", b"feed_ahead")
    old = rewrite(log, tmp_path / "old.mcap", edit)
    assert main(["replay", str(old)]) == 3
    words = capsys.readouterr().err
    assert "its scenario cannot be flown by this version" in words
    assert "feed_ahead" in words
    assert "the log is of hilsat" in words
    home = copy_version(
        tmp_path / "other",
        fsw__settings=("    feed_forward: bool", "    feed_ahead: bool"),
        fsw__flight=("config.guidance.feed_forward", "config.guidance.feed_ahead"),
    )
    assert replay_open_loop(old, home=home).same


@pytest.mark.parametrize("share", [0.0, 0.1, 0.6])
def test_garbage_ends_in_one_line(log: Path, tmp_path: Path, share: float, capsys: pytest.CaptureFixture[str]) -> None:
    """No log at all, the beginning of one, and one with a flipped bit: a word each, and no traceback."""
    data = bytearray(log.read_bytes())
    path = tmp_path / "x.mcap"
    if share < 0.5:
        path.write_bytes(data[: int(len(data) * share)])
    else:
        data[int(len(data) * share)] ^= 16
        path.write_bytes(data)
    assert main(["replay", str(path)]) in (1, 3)
    said = capsys.readouterr()
    assert "Traceback" not in said.err
    assert len(said.err.splitlines()) <= 1
    assert said.err or "differences" in said.out


def test_a_directory_stands_for_its_runs(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A line each and one exit code; one without a run is named."""
    for name in ("a", "b"):
        (tmp_path / "runs" / name).mkdir(parents=True)
        shutil.copy(log, tmp_path / "runs" / name / "run.mcap")
    assert main(["replay", str(tmp_path / "runs")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(" (")[0] for line in lines] == [
        f"{tmp_path}/runs/{name}/run.mcap: 0 differences in 40 ticks" for name in ("a", "b")
    ]
    (tmp_path / "none").mkdir()
    assert main(["replay", str(tmp_path / "none")]) == 3


# -- the picture ---------------------------------------------------------------------------------------------------


def test_the_picture_has_what_differs_most(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The samples drawn are those of the log; the file is of the kind its name says, and one that is there stays."""
    from tools.replay.opening import Choice, open_log
    from tools.replay.picture import read_series

    opened = open_log(log, Choice(("fsw.modes.damping_nm_s=1.0",)))
    with opened.fly() as again:
        changes = replay_open_loop(log, ["fsw.modes.damping_nm_s=1.0"])
        rows = read_series(opened.run, again, opened.tick_ns, choose_signals(changes))
    series = next(row for row in rows if row.change.signal == "fsw.control.tau_cmd_b_nm")
    assert np.array_equal(series.recorded, read_run(log).signals("/fsw/control")["tau_cmd_b_nm"])
    assert np.allclose(np.array(series.replayed)[1], 2.0 * np.array(series.recorded)[1])
    words = ["replay", str(log), "--set", "fsw.modes.damping_nm_s=1.0", "--plot"]
    picture = tmp_path / "p.svg"
    assert main([*words, str(picture)]) == 1
    assert "fsw.control.tau_cmd_b_nm" in capsys.readouterr().out
    assert picture.read_bytes().startswith(b"<?xml")
    before = picture.read_bytes()
    assert main([*words, str(picture)]) == 2
    assert picture.read_bytes() == before


def test_a_picture_that_cannot_be_is_refused_beforehand(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of no open loop, of several logs, in no format."""
    other = ["--set", "fsw.modes.damping_nm_s=1.0"]
    assert main(["replay", str(log), "--plot", "p.png"]) == 2
    assert main(["replay", str(log), str(log), *other, "--plot", "p.png"]) == 2
    assert main(["replay", str(log), *other, "--plot", "p.gif"]) == 2
    assert "a picture is one of png, svg, pdf" in capsys.readouterr().err


def test_the_signals_that_differ_most_come_first() -> None:
    """Against their own size, six at most."""
    from tools.replay.open_loop import OpenLoop, SignalChange

    changes = [SignalChange(f"s{i}", "", largest=float(i), peak=10.0, first_s=1.0) for i in range(9)]
    changes.append(SignalChange("small", "", largest=1e-6, peak=1e-6))
    assert [change.signal for change in choose_signals(OpenLoop(changes=changes))] == [
        "small",
        "s8",
        "s7",
        "s6",
        "s5",
        "s4",
    ]
    series = Series(SignalChange("x", "", samples=12_000))
    for i in range(12_000):
        series.add(i, i, i)
    assert len(series.t_s) == 4000
