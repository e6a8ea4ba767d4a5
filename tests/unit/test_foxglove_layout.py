"""The layout for Foxglove: every panel is known to it, every path is in a fresh log, every fault has a button."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from foxglove import layouts

from bus.settings import build
from plant_server.faults import KINDS, Fault
from tools.cli import main
from tools.foxglove.buttons import CLEAR, list_buttons
from tools.foxglove.layout import list_paths, make_layout, topic_of
from tools.log.mcap_reader import Run, read_run

CONFIGS = {
    "3D": layouts.ThreeDeeConfig, "Plot": layouts.PlotConfig, "StateTransitions": layouts.StateTransitionsConfig,
    "RosOut": layouts.LogConfig, "RawMessages": layouts.RawMessagesConfig, "CallService": layouts.ServiceCallConfig,
}  # fmt: skip


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A second of the published scenario, with its scene."""
    out = tmp_path_factory.mktemp("layout") / "run"
    words = ["--duration", "1", "--set", "expect=[]", "--set", "faults=[]", "--no-plot", "-q", "--out", str(out)]
    main(["run", "zhang2018", "--clock", "inprocess", *words])  # nothing is asked of it: not executed
    return out / "run.mcap"


def find_field(run: Run, path: str) -> bool:
    """Whether a log has what a path names: topic, fields one by one, index within the length of the array."""
    topic = topic_of(path)
    if topic not in run.topics:
        return False
    rest = re.sub(r"^\{\w+==\"[\w.]+\"\}", "", path[len(topic) :])
    if not rest:
        return True
    match = re.fullmatch(r"\.(\w+)(?:\[(\d+)\])?", rest)
    assert match is not None, path
    if run.topics[topic].encoding == "json":
        return match[1] in json.loads(run.topics[topic].schema)["properties"]
    layout = run.signals(topic).layout
    if match[1] not in (layout.names or ()):
        return False
    shape = layout[match[1]].shape
    return bool(shape) == (match[2] is not None) and (not shape or int(match[2] or 0) < shape[0])


def test_every_path_is_in_a_fresh_log(log: Path) -> None:
    """All that the panels show is in the log of a run of the published scenario."""
    run = read_run(log)
    paths = list_paths(make_layout())
    assert len(paths) > 30
    assert [path for path in paths if not find_field(run, path)] == []


def test_the_check_of_paths_finds_what_is_wrong(log: Path) -> None:
    """A wrong topic, field, index and a missing index are seen."""
    run = read_run(log)
    for path in ("/truth/x.y", "/truth/attitude.eror", "/truth/attitude.q_ib[4]", "/truth/attitude.q_ib", "/faults.x"):
        assert not find_field(run, path), path


def find_panels(area: Any) -> Iterator[str]:
    if isinstance(area, str):
        yield area
    else:
        assert area["direction"] in ("row", "column")
        assert 0 < area["splitPercentage"] < 100
        yield from find_panels(area["first"])
        yield from find_panels(area["second"])


def test_panels_and_places_go_together() -> None:
    """Every panel stands in exactly one place, and every place has its panel."""
    layout = make_layout()
    assert layout["layout"] == "Tab!main"
    placed = [name for tab in layout["configById"]["Tab!main"]["tabs"] for name in find_panels(tab["layout"])]
    assert len(placed) == len(set(placed))
    assert {*placed, "Tab!main"} == layout["configById"].keys()


def test_panels_are_those_that_foxglove_knows() -> None:
    """Each setting of each panel is one of those that Foxglove's own SDK writes for that kind of panel."""
    for name, config in make_layout()["configById"].items():
        kind = name.partition("!")[0]
        if kind == "Tab":
            continue
        known = CONFIGS[kind]()._to_dict().keys() | {"foxglovePanelTitle", "lichtblickPanelTitle"}
        assert config.keys() <= known, name
        if kind == "Plot":
            series = layouts.PlotSeries(value="/a.b")._to_dict().keys()
            assert all(line.keys() <= series for line in config["paths"])
        if kind == "StateTransitions":
            series = layouts.StateTransitionsSeries(value="/a.b")._to_dict().keys()
            assert all(line.keys() <= series for line in config["paths"])


def test_every_fault_has_a_button_that_works() -> None:
    """Each kind of the catalogue has one, and what it sends is a fault that the plant takes as it stands."""
    buttons = list_buttons()
    wanted = {f"/fault/{family}/{kind}" for family, kinds in KINDS.items() for kind in kinds} | {CLEAR}
    assert {button.service for button in buttons} == wanted
    for button in buttons:
        if button.service != CLEAR:
            keys = {key: value for key, value in button.request.items() if key != "for_s"}
            fault = build(Fault, keys | {"kind": button.service.rpartition("/")[2], "at_s": 1.0}, "fault")
            assert fault.kind == button.service.rpartition("/")[2]


def test_the_verb_writes_it(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With a log and without; a file that is there stays; a log in the place of the file is seen through."""
    out = tmp_path / "layout.json"
    assert main(["report", "--layout", str(out)]) == 0
    assert json.loads(out.read_text()) == make_layout()
    assert main(["report", "--layout", str(out)]) == 2
    assert main(["report", str(log), "--layout", "-o", str(tmp_path / "fitted.json")]) == 0
    assert json.loads((tmp_path / "fitted.json").read_text()) == make_layout()
    capsys.readouterr()
    assert main(["report", "--layout", str(log)]) == 2
    assert "put the log first" in capsys.readouterr().err
    assert main(["report"]) == 2
    assert "name the log" in capsys.readouterr().err


def test_a_layout_for_a_log_has_no_empty_panels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of a log without scene and observer, panels and lines that would stay empty are left out, and the scene is missed."""
    run = tmp_path / "run"
    words = ["--duration", "1", "--set", "expect=[]", "--set", "faults=[]", "--no-scene", "--no-plot", "-q"]
    main(["run", "nominal", "--clock", "inprocess", *words, "--out", str(run)])
    out = tmp_path / "layout.json"
    assert main(["report", str(run / "run.mcap"), "--layout", str(out)]) == 0
    assert "--to scene" in capsys.readouterr().err
    layout = json.loads(out.read_text())
    opened = read_run(run / "run.mcap")
    assert "3D!scene" not in layout["configById"]
    assert [path for path in list_paths(layout) if not find_field(opened, path)] == []
