"""Faults by command from the ground: requests to a running plant, each on an exact tick, and every refusal."""

from __future__ import annotations

import itertools
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.clock import SystemClock
from bus.mavlink import words
from bus.mavlink.dialect import MAVLink_heartbeat_message
from bus.mavlink.endpoint import Endpoint
from bus.mavlink.json_parts import Assembler, cut_request
from bus.mavlink.packets import text_of
from bus.run import GroundConfig
from bus.settings import plain
from plant_server.faults import KINDS, UNITS, family_of
from plant_server.ground import open_ground
from plant_server.ground.catalogue import make_sample
from plant_server.ground.desk import MOST_FAULTS, NOT_ALLOWED
from plant_server.injector import LOGGED_REFUSALS
from tools.log.mcap_reader import Run
from tools.run.bench import Bench

BARE = ["duration_s=20", "faults=[]", "expect=[]"]
TOKENS = itertools.count(1)
LOSS = {"unit": "wheel.2", "kind": "loss", "effectiveness": 0.3}
TRUTH = ("/truth/attitude", "/truth/wheels", "/truth/gyro")


class GroundEnd:
    """A ground program's socket beside the plant's."""

    def __init__(self, directory: Path, bench: Bench, name: str = "g") -> None:
        self.endpoint = Endpoint(directory / f"{name}.sock", words.GROUND_SYSTEM_ID, words.GROUND_COMPONENT)
        self.directory, self.bench = directory, bench
        self._to = str(directory / "plant.sock")
        self._assembler = Assembler()

    def send(self, message: Any) -> None:
        assert self.endpoint.try_send(message, self._to)

    def ask(self, what: dict[str, Any], token: int | None = None) -> None:
        """Send a request."""
        for message in cut_request(what, next(TOKENS) if token is None else token, 1, words.PLANT_COMPONENT):
            self.send(message)

    def hear(self) -> list[Any]:
        """Everything that has come."""
        return [message for message, _ in self.endpoint.poll(1000)]

    def replies(self) -> list[dict[str, Any]]:
        """The replies that have come, in their order."""
        found = [self._assembler.add(m) for m in self.hear() if m.get_type() == "HILSAT_REPLY"]
        return [what for what in found if what is not None]

    def call(self, what: dict[str, Any], ticks: int = 1) -> dict[str, Any]:
        """Ask, run the bench on, and return the one reply."""
        self.ask(what)
        (reply,) = self.run(ticks)
        return reply

    def run(self, ticks: int) -> list[dict[str, Any]]:
        """Run the bench on; return the replies of that time."""
        found = []
        for _ in range(ticks):
            self.bench.step()
            found += self.replies()
        return found


@contextmanager
def link(
    overrides: list[str] | None = None, *, inject: bool = True, scenario: str = "zhang2018", ticks: int | None = 200
) -> Iterator[GroundEnd]:
    """The other end of the link of a bench's plant; its log is in memory."""
    bench = Bench.open(scenario, [*BARE, *(overrides or [])], log="memory")
    with tempfile.TemporaryDirectory(prefix="hs-", dir="/tmp") as name:
        config = GroundConfig(socket=f"{name}/plant.sock", inject=inject)
        ground = open_ground(bench.plant_node, config, SystemClock(), name="mine", ticks=ticks)
        end = GroundEnd(Path(name), bench)
        try:
            yield end
        finally:
            ground.close()
            end.endpoint.close()
            bench.close()


def strip_heartbeats(run: Run) -> Any:
    """Frames without those that carry the number of the scenario."""
    frames = run.frames()
    return frames[~np.isin(frames["id"] & 0x7FF, (0x701, 0x702))]


def phases(run: Run) -> list[tuple[int, str, str]]:
    return [(record["tick"], record["id"], record["phase"]) for record in run.faults]


# -- set -----------------------------------------------------------------------------------------------------------


def test_what_comes_before_a_tick_acts_on_it_and_is_logged_with_it() -> None:
    """Asked between ticks 4 and 5: onset and effect on tick 5, one line that says who asked, and no other fault."""
    with link() as end:
        end.bench.step(5)
        reply = end.call({"do": "set", "fault": LOSS})
        assert (reply["state"], reply["final"]) == ("accepted", True)
        assert (reply["id"], reply["tick"], reply["t_s"]) == ("command[0]", 5, pytest.approx(0.5))
        end.run(3)
        run = end.bench.log
        assert phases(run) == [(5, "command[0]", "onset"), (5, "command[0]", "effect")]
        said = [event["message"] for event in run.events if "hilsat inject" in event["message"]]
        assert said == [
            "fault.add by hilsat inject at tick 5: command[0]: wheel.2 loss effectiveness 0.3",
        ]


def test_at_tick_is_exact_and_waits_until_then() -> None:
    """Asked at tick 2 for tick 9: it waits, is listed so, and begins on 9."""
    with link() as end:
        end.bench.step(2)
        assert end.call({"do": "set", "fault": LOSS, "at_tick": 9, "for_s": 0.5})["tick"] == 9
        (listed,) = end.call({"do": "list"})["faults"]
        assert (listed["state"], listed["had_effect"], listed["tick"]) == ("waiting", False, 9)
        assert listed["definition"] == {**LOSS, "at_s": pytest.approx(0.9), "until_s": pytest.approx(1.4)}
        end.run(14)
        assert phases(end.bench.log) == [
            (9, "command[0]", "onset"), (9, "command[0]", "effect"), (14, "command[0]", "end"),
        ]  # fmt: skip
        (listed,) = end.call({"do": "list"})["faults"]
        assert (listed["state"], listed["had_effect"]) == ("over", True)


@pytest.mark.parametrize(
    "fault",
    [
        LOSS,
        {"unit": "gyro.y", "kind": "spikes", "rate_rad_s": 0.01, "probability": 0.5},
        {"unit": "wheel.3", "kind": "bias", "torque_nm": 0.01, "sigma_per_sqrt_s": 0.3},
        {"unit": "star_tracker", "kind": "dropout", "probability": 0.5},
    ],
)
def test_the_same_bytes_as_the_same_fault_in_the_scenario(fault: dict[str, Any]) -> None:
    """By request for tick 30 and by YAML at its time: the same frames on the bus and the same truth, chance and all."""
    at_s = 30 * 0.1
    whole = {**fault, "at_s": at_s}
    with link() as end:
        end.bench.step(7)
        assert end.call({"do": "set", "fault": fault, "at_tick": 30})["state"] == "accepted"
        end.run(92)
        commanded = end.bench.log
        text = ", ".join(f"{key}: {value}" for key, value in whole.items())
        with Bench.open("zhang2018", [*BARE, f"faults=[{{{text}}}]"], log="memory") as bench:
            written = bench.step(100).log
            ours, its = (strip_heartbeats(run) for run in (commanded, written))
            assert len(ours) > 1000
            assert ours.tobytes() == its.tobytes()
            for topic in TRUTH:
                ours, its = commanded.signals(topic), written.signals(topic)
                assert all(np.array_equal(ours[key], its[key], equal_nan=True) for key in its)


def test_one_who_waits_is_told_of_the_first_effect() -> None:
    """A slow drag that begins on tick 3 is accepted, then bites on the tick that the log has, once and finally."""
    with link() as end:
        end.ask({"do": "set", "fault": LOSS, "at_tick": 3, "wait": True})
        accepted, bit = end.run(8)
        assert (accepted["state"], accepted["tick"], accepted["final"]) == ("accepted", 3, False)
        assert (bit["state"], bit["id"], bit["tick"], bit["final"]) == ("bit", accepted["id"], 3, True)
        (effect,) = [record for record in end.bench.log.faults if record["phase"] == "effect"]
        assert effect["tick"] == bit["tick"]


@pytest.mark.parametrize(
    ("what", "state", "tick"),
    [
        ({"do": "clear"}, "cleared", 6),
        ({"do": "status"}, "ended", 9),
    ],
)
def test_one_who_waits_for_what_never_bites_is_told_how_it_ended(what: dict[str, Any], state: str, tick: int) -> None:
    """A rare loss of frames: cleared before it struck, or over by itself; each said once and finally."""
    fault = {"unit": "wheel.1", "kind": "drop", "probability": 1e-9}
    with link() as end:
        end.ask({"do": "set", "fault": fault, "at_tick": 4, "for_s": 0.5, "wait": True})
        end.run(6)
        end.ask(what)
        replies = [reply for reply in end.run(6) if "ids" not in reply and "name" not in reply]
        assert [(reply["state"], reply["tick"], reply["final"]) for reply in replies] == [(state, tick, True)]


def test_one_who_waits_is_told_when_the_run_is_over() -> None:
    """Before the socket goes."""
    with link() as end:
        end.ask({"do": "set", "fault": LOSS, "at_tick": 50, "wait": True})
        end.run(3)
        ground = end.bench.plant_node.ground
        assert ground is not None
        ground.close()  # type: ignore[attr-defined]
        (reply,) = end.replies()
        assert (reply["state"], reply["tick"], reply["final"]) == ("closing", 3, True)
        assert end.bench.plant_node.ground is None
        assert not (end.directory / "plant.sock").exists()


# -- refusals ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ({"do": "set", "fault": {**LOSS, "kind": "los"}}, 'kind: "los" .*did you mean "loss"'),
        ({"do": "set", "fault": {**LOSS, "unit": "wheel.9"}}, "unit: .*wheel.9"),
        ({"do": "set", "fault": {**LOSS, "effectivness": 1}}, "effectivness"),
        ({"do": "set", "fault": {**LOSS, "effectiveness": 1.5}}, "effectiveness: 1.5.* out of range"),
        ({"do": "set", "fault": {"unit": "wheel.1", "kind": "bias", "torque_nm": 0}}, "no effect"),
        ({"do": "set", "fault": {"unit": "wheel.1", "kind": "runaway"}}, "wheel.1 is an ideal wheel"),
        ({"do": "set", "fault": LOSS, "at_tick": 4}, "at_tick: 4 has passed; the next tick is 5"),
        ({"do": "set", "fault": LOSS, "at_tick": 200}, "beyond the end of the run; its last tick is 199"),
        ({"do": "set", "fault": LOSS, "at_tick": 7.0}, "at_tick: must be a whole number"),
        ({"do": "set", "fault": LOSS, "at_tick": True}, "at_tick: must be a whole number"),
        ({"do": "set", "fault": {**LOSS, "at_s": 0.1}}, "at_s: 0.1 s has passed; it is 0.5 s"),
        ({"do": "set", "fault": {**LOSS, "at_s": 20}}, "at_s: 20 s is beyond the last tick"),
        ({"do": "set", "fault": {**LOSS, "at_s": 3}, "at_tick": 9}, "give one of both"),
        ({"do": "set", "fault": {**LOSS, "until_s": 3}, "for_s": 1}, "give one of both"),
        ({"do": "set", "fault": {**LOSS, "until_s": 0.4}}, "until_s: 0.4 s is not after the onset"),
        ({"do": "set", "fault": LOSS, "for_s": 0}, "for_s: must be a number of seconds above 0"),
        ({"do": "set", "fault": LOSS, "for_s": "x"}, "for_s: must be a number of seconds above 0"),
        ({"do": "set", "fault": LOSS, "wait": 1}, "wait: must be true or false"),
        ({"do": "set", "fault": {**LOSS, "id": "a\nb"}}, "printable"),
        ({"do": "set", "fault": {**LOSS, "id": "\ud800"}}, "printable"),
        ({"do": "set", "fault": {**LOSS, "id": "x" * 300}}, "printable"),
        ({"do": "set", "fault": {**LOSS, "id": "x" * 100}}, "id: has 100 characters"),
        ({"do": "set", "fault": {**LOSS, "effectiveness": [0.3]}}, "must be a number or a text"),
        ({"do": "set", "fault": {**LOSS, "effectiveness": 10**400}}, "must be a finite number"),
        ({"do": "set", "fault": [1]}, "fault: must be a mapping"),
        ({"do": "set"}, "fault: must be a mapping"),
        ({"do": "set", "fault": LOSS, "at": 3}, "'at': not a key of set; it takes fault, at_tick, for_s, wait"),
        ({"do": "clear", "id": "nobody"}, 'no fault with id "nobody" is waiting or active'),
        ({"do": "clear", "unit": "wheel.1", "id": "x"}, "one of id and unit"),
        ({"do": "clear", "id": 3}, "one of id and unit"),
        ({"do": "catalogue", "unit": "wheel.5"}, "did you mean wheel"),
        ({"do": "catalogue", "unit": ["x"]}, "is not a unit"),
        ({"do": "sett"}, "do: must be one of set, clear, list"),
        ({"do": ["set"]}, "do: must be one of"),
        ({}, "do: must be one of"),
    ],
)
def test_what_cannot_act_is_refused_with_the_reason(what: dict[str, Any], reason: str) -> None:
    """At tick 5 of 200 of a bench with ideal wheels; nothing is set, and the bench goes on."""
    with link() as end:
        end.bench.step(5)
        reply = end.call(what)
        assert (reply["state"], reply["final"]) == ("refused", True)
        assert re.search(reason, " ".join(reply["reasons"]))
        assert "fault.add" not in " ".join(reply["reasons"])
        assert end.call({"do": "list"})["faults"] == []


def test_ids_are_unique_and_numbered_as_commands_are() -> None:
    """One's own id twice is refused; the next without one is numbered on, past an id that somebody has taken."""
    with link() as end:
        assert end.call({"do": "set", "fault": {**LOSS, "id": "command[1]"}})["id"] == "command[1]"
        assert end.call({"do": "set", "fault": {**LOSS, "id": "command[1]"}})["state"] == "refused"
        end.bench.inject(**LOSS)
        end.run(1)
        assert end.call({"do": "set", "fault": LOSS})["id"] == "command[3]"
        assert [item["id"] for item in end.call({"do": "list"})["faults"]] == ["command[1]", "command[2]", "command[3]"]


def test_a_run_that_takes_no_faults_says_so_and_answers_all_else() -> None:
    """Set and clear are refused with what to do; list, catalogue and status are answered."""
    with link(["faults=[{unit: wheel.1, kind: dead, at_s: 1}]"], inject=False) as end:
        assert end.call({"do": "set", "fault": LOSS})["reasons"] == [NOT_ALLOWED]
        assert end.call({"do": "clear"})["reasons"] == [NOT_ALLOWED]
        assert [item["id"] for item in end.call({"do": "list"})["faults"]] == ["faults[0]"]
        status = end.call({"do": "status"})
        assert status.pop("t_s") == pytest.approx(0.3)
        assert status == {"state": "done", "name": "mine", "tick": 3, "ticks": 200, "inject": False, "final": True}
        assert len(phases(end.bench.log)) == 0


# -- clear, list, catalogue ----------------------------------------------------------------------------------------


def test_clear_ends_one_a_unit_or_all_on_the_tick_of_the_command() -> None:
    """Waiting ones too, and those of the scenario; each is logged as cleared on that tick."""
    with link(["faults=[{unit: gyro.x, kind: dead, at_s: 0}]"]) as end:
        for unit in ("wheel.1", "wheel.2", "wheel.3"):
            end.call({"do": "set", "fault": {**LOSS, "unit": unit}, "at_tick": 100 if unit == "wheel.3" else None})
        assert end.call({"do": "clear", "id": "command[0]"})["ids"] == ["command[0]"]
        reply = end.call({"do": "clear", "unit": "wheel.2"})
        assert (reply["state"], reply["tick"], reply["ids"]) == ("accepted", 4, ["command[1]"])
        assert end.call({"do": "clear"})["ids"] == ["faults[0]", "command[2]"]
        assert end.call({"do": "clear"})["ids"] == []
        cleared = [(tick, name) for tick, name, phase in phases(end.bench.log) if phase == "cleared"]
        assert cleared == [(3, "command[0]"), (4, "command[1]"), (5, "faults[0]"), (5, "command[2]")]
        assert all(item["state"] == "over" for item in end.call({"do": "list"})["faults"])


@pytest.mark.parametrize("scenario", ["zhang2018", "ithaco-hold"])
def test_the_catalogue_has_what_can_act_on_this_plant(scenario: str) -> None:
    """A kind is in it exactly when a request for it with ordinary magnitudes is accepted."""
    with link(scenario=scenario, ticks=None) as end:
        end.ask({"do": "catalogue"})
        (reply,) = end.run(40)
        listed = {(item["kind"], unit) for item in reply["kinds"] for unit in item["units"]}
        taken = set()
        for unit in UNITS:
            for kind, cls in KINDS[family_of(unit)].items():
                magnitudes = {key: value for key, value in plain(make_sample(cls)).items() if value is not None}
                fault = {"unit": unit, "kind": kind, **magnitudes}
                if end.call({"do": "set", "fault": fault})["state"] == "accepted":
                    taken.add((kind, unit))
                    end.call({"do": "clear"})
        assert listed == taken
        keys = {
            key["name"]: key
            for item in reply["kinds"]
            if item["kind"] == "loss" and item["unit"][:5] == "wheel"
            for key in item["keys"]
        }
        assert keys == {
            "effectiveness": {
                "name": "effectiveness", "unit": "1", "limits": ">= 0, < 1", "default": None, "needed": True,
            }
        }  # fmt: skip


# -- the link ------------------------------------------------------------------------------------------------------


def test_a_repeated_request_is_answered_again_and_not_done_again() -> None:
    """By the same sender and token: the same answers; another token sets another fault."""
    with link() as end:
        for _ in range(3):
            end.ask({"do": "set", "fault": LOSS, "wait": True}, token=77)
        first = end.run(4)
        accepted = [reply for reply in first if reply["state"] == "accepted"]
        assert accepted == accepted[:1] * 3
        end.ask({"do": "set", "fault": LOSS, "wait": True}, token=77)
        assert [reply["state"] for reply in end.run(1)] == ["accepted", "bit"]
        assert len(end.call({"do": "list"})["faults"]) == 1
        end.call({"do": "set", "fault": LOSS})
        assert len(end.call({"do": "list"})["faults"]) == 2


def test_a_flood_of_requests_is_bounded() -> None:
    """The number of faults, what is logged of refusals, the size of a list, and what is taken a tick."""
    with link(ticks=None) as end:
        wrong = {"do": "set", "fault": {"unit": "wheel.1", "kind": "nonsense"}}
        for _ in range(LOGGED_REFUSALS + 50):
            end.call(wrong)
        refused = [record for record in end.bench.log.faults if record["phase"] == "refused"]
        assert len(refused) == LOGGED_REFUSALS
        desk = end.bench.plant_node.ground.desk  # type: ignore[union-attr]
        fault = {"unit": "wheel.1", "kind": "silent", "at_s": 1e6}
        states = [desk.set(fault, "test")[1] is not None for _ in range(MOST_FAULTS + 5)]
        assert states.count(True) == MOST_FAULTS
        assert states[-1] is False
        end.ask({"do": "list"})
        (reply,) = end.run(60)
        assert len(reply["faults"]) + reply["left_out"] == MOST_FAULTS
        assert len(reply["faults"]) > 100


def test_what_happens_is_said_to_everybody_who_listens() -> None:
    """STATUSTEXT of every onset, effect and end, by request, bench and scenario alike, in the words of the log."""
    with link(["faults=[{unit: gyro.z, kind: dead, at_s: 0.8, until_s: 1.1}]"]) as end:
        end.send(MAVLink_heartbeat_message(words.TYPE_GROUND, words.AUTOPILOT_INVALID, 0, 0, words.STATE_ACTIVE, 3))
        end.bench.step(2)
        end.ask({"do": "set", "fault": LOSS, "for_s": 0.3})
        end.bench.inject(at_tick=4, unit="wheel.4", kind="dead")
        heard = []
        for _ in range(15):
            end.bench.step()
            heard += [m for m in end.hear() if m.get_type() == "STATUSTEXT"]
        texts: dict[int, str] = {}
        said = []
        for message in heard:
            if message.id == 0:
                said.append(text_of(message.text))
            else:
                texts[message.id] = texts.get(message.id, "") + text_of(message.text)
        said += texts.values()
        logged = [event["message"] for event in end.bench.log.events if event["message"].startswith("fault ")]
        logged = [message for message in logged if not message.startswith("fault.")]
        assert len(logged) == 8
        assert sorted(said) == sorted(logged)


def test_a_bench_without_a_link_has_none() -> None:
    """No socket and nothing to poll unless it is opened."""
    with Bench.open("zhang2018", BARE) as bench:
        assert bench.plant_node.ground is None
