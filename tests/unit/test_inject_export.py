"""`hilsat inject export`: a run with commanded faults, and a run of the list that it makes of them, are the same run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tools.cli import main
from tools.inject.export import export_faults, format_export
from tools.log.mcap_reader import Run, read_run
from tools.run.bench import Bench

SCENARIO = "zhang2018-flight"
SHORT = ["duration_s=9", "expect=[]", "faults=[{unit: gyro.x, kind: ramp, slope_rad_s2: 1e-6, at_s: 1}]"]


def fly(tmp_path: Path, act: Any, name: str = "a", overrides: list[str] | None = None) -> Path:
    """Fly with what `act` commands on the way; return the log."""
    log = tmp_path / f"{name}.mcap"
    with Bench.open(SCENARIO, SHORT if overrides is None else overrides, log=log) as bench:
        act(bench)
        bench.run_to_end()
    return log


def fly_list(tmp_path: Path, text: str) -> Run:
    """Fly the same scenario with an exported list, read from a file as people would write it."""
    file = tmp_path / "again.yaml"
    file.write_text(f"extends: {SCENARIO}\nduration_s: 9\nexpect: []\n{text}")
    log = tmp_path / "b.mcap"
    Bench.open(file, [], log=log).run_to_end()
    return read_run(log)


def compare(a: Run, b: Run) -> list[str]:
    """The topics in which two runs differ. Of /faults what happened counts, not by whom.

    Heartbeats carry the number that stands for the scenario, faults and all, so they are left out of the frames, and with
    them /fsw/input, which repeats the frames. The wire's counts begin with the first bus fault that is known; lost frames
    are compared.
    """
    apart = ("/faults", "/events", "/fsw/input", "/can/bus0", "/plant/bus")
    names = [name for name, info in (a.topics | b.topics).items() if info.deterministic and name not in apart]
    assert len(names) > 10
    differ = [name for name in names if a.payloads(name) != b.payloads(name)]
    frames = [run.frames() for run in (a, b)]
    sent = [table[table["id"] < 0x700].tobytes() for table in frames]
    if a.has("/plant/bus"):
        lost = [run.signals("/plant/bus")["lost_loss"][-a.count("/plant/bus") :] for run in (a, b)]
        assert lost[0][-1].sum() > 10
        differ += ["/plant/bus"] if (lost[0] != lost[1]).any() else []
    differ += ["/can/bus0"] if sent[0] != sent[1] or not sent[0] else []
    happened = [
        [
            (f["tick"], f["unit"], f["fault"], f["phase"].replace("cleared", "end"), f["value"])
            for f in run.faults
            if f["phase"] != "refused"
        ]
        for run in (a, b)
    ]
    return differ + (["/faults"] if happened[0] != happened[1] else [])


def test_commanded_faults_fly_again_bit_for_bit(tmp_path: Path) -> None:
    """At once, in the past, in the future between two ticks, with chance, cleared by id and by unit, refused between."""

    def act(bench: Bench) -> None:
        bench.step(150)
        bench.inject(unit="wheel.2", kind="loss", effectiveness=0.3)
        bench.inject(unit="gyro", kind="spikes", rate_rad_s=1e-3, probability=0.1, id="noisy")
        bench.inject(unit="wheel.3", kind="bias", torque_nm=0.004, at_s=3.0049)
        bench.inject(unit="wheel.3", kind="bias", torque_nm=0.002, at_s=0.5, rise_s=3.0)
        bench.inject(unit="bus", kind="loss", probability=0.05, id="lossy")
        bench.step(333)
        bench.clear(id="noisy")
        bench.clear(id="no such")
        bench.inject(unit="gyro", kind="spikes", rate_rad_s=2e-3, probability=0.1, until_s=8.0)
        bench.inject(unit="wheel.1", kind="loss", effectiveness=0.9, period_s=0.3, duty=0.5, jitter=0.2)
        bench.step(200)
        bench.clear(unit="wheel.3")
        bench.clear(id="faults[0]")
        bench.clear(unit="bus")

    log = fly(tmp_path, act)
    exported = export_faults(log)
    assert exported.inexact == exported.notes == []
    ids = [fault.get("id") for fault in exported.faults]
    assert ids == [None, "command[0]", "noisy", "command[2]", "command[3]", "lossy", "command[5]", "command[6]"]
    again = fly_list(tmp_path, format_export(exported, log))
    assert compare(read_run(log), again) == []
    assert len([f for f in again.faults if f["phase"] == "effect"]) >= 6
    # The comparison can fail: without the faults of the list it is another run.
    assert "/truth/attitude" in compare(read_run(fly(tmp_path, lambda bench: None, "c")), again)


def test_what_cannot_be_said_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A latched fault that was cleared by command: exit code 2, the rest is written all the same."""

    def act(bench: Bench) -> None:
        bench.step(10)
        bench.inject(unit="wheel.2", kind="loss", effectiveness=0.3, id="held", latch=True)
        bench.step(90)
        bench.clear(id="held")

    log = fly(tmp_path, act)
    out = tmp_path / "faults.yaml"
    assert main(["inject", "export", str(log), "-o", str(out)]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert "held: it is latched and was cleared by command at tick 100" in said.err
    assert "held" in out.read_text()
    assert main(["inject", "export", str(log), "-o", str(out)]) == 2
    assert "--force" in capsys.readouterr().err


def test_what_never_acted_is_left_out(tmp_path: Path) -> None:
    """Cleared on its own tick, cleared while it waited, waiting at the end: each noted, and the others fly as they did."""

    def act(bench: Bench) -> None:
        bench.step(100)
        bench.inject(unit="wheel.2", kind="loss", effectiveness=0.3, id="short")
        bench.clear(id="short")
        bench.inject(unit="wheel.3", kind="loss", effectiveness=0.3, id="early", at_s=9.0)
        bench.inject(unit="wheel.4", kind="loss", effectiveness=0.3, id="late", at_s=900.0)
        bench.inject(unit="wheel.1", kind="loss", effectiveness=0.3, id="real")
        bench.step(100)
        bench.clear(id="early")

    log = fly(tmp_path, act)
    exported = export_faults(log)
    assert [fault["id"] for fault in exported.faults] == ["faults[0]", "real"]
    assert exported.inexact == []
    assert sorted(note.split(":")[0] for note in exported.notes) == ["early", "late", "short"]
    again = fly_list(tmp_path, format_export(exported, log))
    attitude = "/truth/attitude"
    assert read_run(log).payloads(attitude) == again.payloads(attitude)


def test_chance_after_one_that_is_left_out_is_named(tmp_path: Path) -> None:
    """Streams are counted by unit and kind: without the first, the second would draw the first's numbers."""

    def act(bench: Bench) -> None:
        bench.inject(unit="gyro.z", kind="intermittent", probability=0.5, id="first", at_s=5.0)
        bench.step(100)
        bench.clear(id="first")
        bench.inject(unit="gyro.z", kind="intermittent", probability=0.5, id="second")

    exported = export_faults(fly(tmp_path, act))
    assert len(exported.inexact) == 1
    assert exported.inexact[0].startswith("second: it draws other random numbers")


def test_a_log_without_commands_gives_its_own_list(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The scenario's faults as they are; a file that is no log is code 3."""
    log = fly(tmp_path, lambda bench: None)
    assert main(["inject", "export", str(log)]) == 0
    assert "slope_rad_s2: 1.0e-06" in capsys.readouterr().out
    assert main(["inject", "export", str(log), "--extends", SCENARIO]) == 0
    assert f"extends: {SCENARIO}\nfaults:\n" in capsys.readouterr().out
    (tmp_path / "none.mcap").write_text(json.dumps({}))
    assert main(["inject", "export", str(tmp_path / "none.mcap")]) == 3
