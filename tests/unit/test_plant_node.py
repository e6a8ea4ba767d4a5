"""One tick of the plant, commands at its boundary, and what the log has of both."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, ClassVar

import pytest

from bus.commands import Command
from bus.icd.codec import encode_CYCLE_DONE, encode_rw_cmds
from bus.settings import build
from bus.telemetry.link import Link, Row, TelemetryLink
from bus.telemetry.packing import PREFIX
from plant_server.config import PlantConfig
from plant_server.faults import Fault, make_fault
from plant_server.node import PlantNode
from plant_server.pacing import Accept
from plant_server.plant import Plant
from plant_server.plant_log import COUNTERS_CHANNEL, STAMPS_CHANNEL
from tools.log.mcap_reader import Run, read_run
from tools.log.recorder import Recorder

TICK_NS = 100_000_000
DATA = {
    "body": {"inertia_kgm2": [[45, 3, 2], [3, 38, -1.5], [2, -1.5, 50]]},
    "wheels": [{"mount": mount} for mount in ("x", "y", "z", "skew")],
}


def answer(tick: int) -> bytes:
    batch = encode_rw_cmds(tick % 15, (1,) * 4, (0.01, -0.02, 0.03, 0.01), tick & 0xFF)
    return batch + encode_CYCLE_DONE(tick % 15, 2, tick, 0)


def make_node(link: Link, faults: tuple[Fault, ...] = (), stamped: bool = False) -> PlantNode:
    return PlantNode(Plant(build(PlantConfig, DATA, "test"), faults, 0.1, 1), link, TICK_NS, 42, stamped=stamped)


def fly(node: PlantNode, ticks: int, junk: bytes = b"") -> None:
    def exchange(frames: bytes, accept: Accept) -> bytes:
        batch = junk + answer(node.tick_number)
        assert accept(batch)
        return batch

    for _ in range(ticks):
        node.tick(exchange)


def fly_logged(
    path: Path, commands: list[Command], ticks: int = 40, faults: tuple[Fault, ...] = (), junk: bytes = b""
) -> Run:
    recorder = Recorder(path, metadata={}, sources=(1,))
    link = recorder.link(1)
    node = make_node(link, faults)
    for command in commands:
        node.commands.add(command)
    fly(node, ticks, junk)
    link.close("done")
    recorder.close()
    return read_run(path)


def seen(run: Run, *keys: str) -> list[tuple[Any, ...]]:
    return [tuple(record[key] for key in keys) for record in run.faults]


def test_a_commanded_fault_is_applied_at_its_tick_and_in_the_log(tmp_path: Path) -> None:
    """Truth differs from that tick on, and from no other; the log has command, onset, effect and the whole fault."""
    arguments = {"unit": "wheel.1", "kind": "stuck_torque", "torque_nm": 0.05, "at_s": 0.0}
    run = fly_logged(tmp_path / "a.mcap", [Command(12, "fault.add", arguments, "test")])
    torque = run.signals("/truth/wheels")["tau_rw_true_nm"][:, 0]
    assert torque[:13].tolist() == pytest.approx([0.0] + [0.01] * 12)  # the mean over the tick that ended
    assert torque[13:].tolist() == pytest.approx([0.05] * 27)
    assert seen(run, "tick", "id", "number", "unit", "fault", "phase", "value") == [
        (12, "command[0]", 0, "wheel.1", "stuck_torque", "onset", 0.05),
        (12, "command[0]", 0, "wheel.1", "stuck_torque", "effect", 0.05),
    ]
    assert build(Fault, json.loads(run.faults[0]["definition"]), "x") == make_fault(**arguments)
    messages = [event["message"] for event in run.events]
    assert "fault.add by test at tick 12: command[0]: wheel.1 stuck_torque torque_nm 0.05" in messages


def test_faults_are_cleared_by_command(tmp_path: Path) -> None:
    """The fault of the scenario ends at the tick of the command, and the log says that it was cleared."""
    faults = (make_fault(unit="wheel.1", kind="dead", at_s=1.0, id="mine"),)
    run = fly_logged(tmp_path / "a.mcap", [Command(20, "fault.clear", {"id": "mine"})], faults=faults)
    torque = run.signals("/truth/wheels")["tau_rw_true_nm"][:, 0]
    assert torque[11:21].tolist() == [0.0] * 10
    assert torque[21:].tolist() == pytest.approx([0.01] * 19)
    assert seen(run, "tick", "phase") == [(10, "onset"), (10, "effect"), (20, "cleared")]
    assert any(event["message"] == "fault.clear by scenario at tick 20: cleared mine" for event in run.events)


@pytest.mark.parametrize(
    ("command", "word"),
    [
        (Command(5, "fault.add", {"unit": "wheel.9", "kind": "dead", "at_s": 0}), "wheel.9"),
        (Command(5, "fault.add", {"unit": "wheel.1", "kind": "dead", "at_s": 0, "until_s": 0.2}), "has passed"),
        (Command(5, "fault.add", {"unit": "gyro.x", "kind": "noise", "factor": 3, "at_s": 0}), "no angle random walk"),
        (Command(5, "fault.clear", {"id": "nobody"}), 'no fault with id "nobody"'),
        (Command(5, "fault.clear", {"kind": "dead"}), "takes one of id and unit"),
        (Command(5, "fault.clear", {"id": 3}), "takes one of id and unit"),
        (Command(5, "target.slew", {}), "is not a command of the plant; there are: fault.add, fault.clear"),
    ],
)
def test_a_command_that_cannot_be_carried_out_is_refused_and_changes_nothing(
    tmp_path: Path, command: Command, word: str
) -> None:
    """The reason is in the log, on /faults and for people; frames and truth are those of a run without it."""
    run = fly_logged(tmp_path / "a.mcap", [command], 20)
    ((tick, phase, message),) = seen(run, "tick", "phase", "message")
    assert (tick, phase) == (5, "refused")
    assert word in message
    assert any(word in event["message"] and "refused" in event["message"] for event in run.events)
    plain = fly_logged(tmp_path / "b.mcap", [], 20)
    assert run.frames().tobytes() == plain.frames().tobytes()
    for topic in ("/truth/attitude", "/truth/wheels", "/truth/gyro"):
        for name, values in run.signals(topic).items():
            assert values.tobytes() == plain.signals(topic)[name].tobytes()


def test_the_channels_counters_are_logged_with_every_heartbeat(tmp_path: Path) -> None:
    """Once a second: five good frames a tick, and two foreign ones put between them."""
    junk = bytes.fromhex("55050000 08000000 0000000000000000") * 2
    run = fly_logged(tmp_path / "a.mcap", [], 25, junk=junk)
    counts = run.signals("/plant/channel")
    assert (run.t_ns("/plant/channel") // TICK_NS).tolist() == [0, 10, 20]
    assert counts["accepted"].tolist() == [5, 55, 105]
    assert counts["foreign"].tolist() == [2, 22, 42]
    assert counts["refused"].tolist() == counts["too_old"].tolist() == counts["timeouts"].tolist() == [0, 0, 0]


class PackedLink(Link):
    """Keeps the records of each tick."""

    def __init__(self) -> None:
        super().__init__(1)
        self.records: list[bytes] = []

    def _write_ticks(self, rows: list[Row], records: list[bytes]) -> None:
        self.records += records

    def write_json(self, topic: str, t_ns: int, payload: bytes) -> None:
        pass


class StampedBus:
    """As much of a transport as a log asks for stamps."""

    kernel_stamps_ns: ClassVar = [7, 8, 9]

    class counters:
        dropped = 0


def channels_of(data: bytes) -> list[int]:
    found, at = [], 0
    while at < len(data):
        _, length, channel = PREFIX.unpack_from(data, at)
        found.append(channel)
        at += 9 + length
    return found


def test_truth_stands_at_the_end_of_a_ticks_records() -> None:
    """Whatever else a tick has, stamps of frames or counters, its last bytes are the truth, always as many."""
    link = PackedLink()
    node = make_node(link, stamped=True)

    def exchange(frames: bytes, accept: Accept) -> bytes:
        batch = answer(node.tick_number)
        accept(batch)
        node.log.note_arrival(batch[: 48 if node.tick_number % 2 else 16], StampedBus())  # type: ignore[arg-type]
        return batch

    for _ in range(12):
        node.tick(exchange)
    shapes = [channels_of(data) for data in link.records]
    assert shapes[0] == [1, STAMPS_CHANNEL, COUNTERS_CHANNEL, 2, 3, 4]
    assert shapes[1] == [1, *[STAMPS_CHANNEL] * 3, 2, 3, 4]


def test_a_tick_without_a_log_runs_all_the_same() -> None:
    """Commands are carried out and the truth moves on, whether somebody listens or not."""
    node = make_node(TelemetryLink(None, 1, False))
    node.commands.add(Command(3, "fault.add", {"unit": "wheel.2", "kind": "dead", "at_s": 0.0}))
    fly(node, 6)
    assert node.plant.truth().tau_rw_true_nm[1] == 0.0
    assert [(item.id, item.state, item.had_effect) for item in node.plant.list_faults()] == [
        ("command[0]", "active", True)
    ]
