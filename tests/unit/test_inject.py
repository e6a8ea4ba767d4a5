"""`hilsat inject`: finding the bench, asking its plant, and what is said when that goes wrong.

The plant here is a stand-in that answers by a script over the real socket; real benches: tests/scenario/test_break_it.py.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from bus.errors import PeerLostError, UsageError
from bus.mavlink.endpoint import Endpoint
from bus.mavlink.json_parts import Assembler, cut_reply
from bus.mavlink.words import PLANT_COMPONENT, SYSTEM_ID
from tools.cli import main
from tools.inject.bench_finder import find_plant, list_benches, look_into
from tools.inject.client import BenchGone, PlantClient, Refused
from tools.inject.completion import write_completion
from tools.inject.request_words import make_request, spell_out
from tools.run.run_file import RunFile, read_run_file, write_run_file

Answer = Callable[[dict[str, Any]], list[dict[str, Any]]]
OPTIONS: dict[str, Any] = dict.fromkeys(("at_s", "at_tick", "for_s", "until_s", "id", "profile", "wait"))


class StandIn:
    """A plant's socket that answers each request with what a function makes of it; `deaf` requests are not heard."""

    def __init__(self, path: Path, answer: Answer, deaf: int = 0) -> None:
        self.asked: list[tuple[int, dict[str, Any]]] = []
        self._answer, self._deaf = answer, deaf
        self._endpoint = Endpoint(path, SYSTEM_ID, PLANT_COMPONENT)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        assembler = Assembler()
        while not self._ended.is_set():
            select.select([self._endpoint], [], [], 0.02)
            for message, sender in self._endpoint.poll():
                what = assembler.add(message, sender)
                if what is not None:
                    self.asked.append((message.token, what))
                    if len(self.asked) > self._deaf:
                        self._reply(message, sender, what)
        self._endpoint.close()

    def _reply(self, message: Any, sender: str, what: dict[str, Any]) -> None:
        to = (message.get_srcSystem(), message.get_srcComponent())
        for number, reply in enumerate(self._answer(what)):
            for part in cut_reply(reply, message.token, number, *to):
                while not self._endpoint.send(part, sender) and not self._ended.wait(0.001):
                    pass

    def close(self) -> None:
        self._ended.set()
        self._thread.join()


def describe(private: Path, **changes: Any) -> RunFile:
    told = {
        "name": "zhang2018", "side": "both", "out": None, "pid": os.getpid(), "clock": "lockstep", "bus": "hub:/x",
        "inject": "allowed", "plant": str(private / "plant.sock"), "fsw": None, "started": "2026-11-28T12:00:00+00:00",
    }  # fmt: skip
    return RunFile(**told | changes)


@pytest.fixture
def place(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A temporary directory of its own, short enough for sockets."""
    with tempfile.TemporaryDirectory(prefix="hs") as name:
        monkeypatch.setattr(tempfile, "tempdir", name)
        yield Path(name)


def add_bench(place: Path, folder: str = "hilsat-a", **changes: Any) -> Path:
    private = place / folder
    private.mkdir(mode=0o700)
    write_run_file(private, describe(private, **changes))
    return private


@pytest.fixture
def bench(place: Path) -> Iterator[tuple[Path, list[StandIn]]]:
    """A private directory, and stand-ins that are closed in the end."""
    started: list[StandIn] = []
    yield add_bench(place), started
    for one in started:
        one.close()


def serve(bench: tuple[Path, list[StandIn]], answer: Answer, deaf: int = 0) -> StandIn:
    bench[1].append(StandIn(bench[0] / "plant.sock", answer, deaf))
    return bench[1][-1]


# -- the file by which a bench is found --------------------------------------------------------------------------------


def test_a_run_file_reads_back(place: Path) -> None:
    """What was written is what is read."""
    private = add_bench(place)
    assert read_run_file(private) == describe(private)


@pytest.mark.parametrize(
    "text",
    ["", "{", "[1]", '{"name": "x"}', "[" * 100_000, '{"pid": "1"}', "\0" * 70_000],
)
def test_a_run_file_that_is_none_is_none(place: Path, text: str) -> None:
    """Whatever stands in the file, nothing is raised and nothing is believed."""
    private = add_bench(place)
    (private / "run.json").write_text(text)
    assert read_run_file(private) is None


def test_a_socket_elsewhere_is_not_believed(place: Path) -> None:
    """A run file cannot lead to a socket outside its own directory."""
    private = add_bench(place, plant="/tmp/other/plant.sock")
    assert read_run_file(private) is None


# -- finding -----------------------------------------------------------------------------------------------------------


def test_none_runs(place: Path) -> None:
    """Said with what to do, and code 3."""
    with pytest.raises(PeerLostError, match=r"no bench runs here.*--inject") as failure:
        find_plant()
    assert failure.value.exit_code == 3


def test_one_that_allows_no_injection_says_how(place: Path) -> None:
    """A bench without sockets is found all the same."""
    add_bench(place, inject="off", plant=None)
    words = "bench zhang2018 runs, but its scenario does not allow injection: inject: allowed.*hilsat run --inject"
    with pytest.raises(UsageError, match=words):
        find_plant()


def test_sockets_for_a_gateway_do_not_allow_injection(bench: tuple[Path, list[StandIn]], place: Path) -> None:
    """A bench with a ground link alone has a plant socket and still takes no faults."""
    private = add_bench(place, "hilsat-b", inject="off", name="linked")
    other = StandIn(private / "plant.sock", lambda what: [])
    try:
        with pytest.raises(UsageError, match="bench linked runs, but"):
            find_plant(private)
    finally:
        other.close()


def test_several_are_listed(place: Path) -> None:
    """Two benches: both named with the option that chooses; --run takes log directories and private ones."""
    standing = []
    for name in ("a", "b"):
        private = add_bench(place, f"hilsat-{name}", name=f"scenario-{name}", out=str(place / name))
        standing.append(StandIn(private / "plant.sock", lambda what: []))
    try:
        with pytest.raises(UsageError, match=r"(?s)2 benches run.*--run .*/a .*--run .*/b "):
            find_plant()
        assert find_plant(place / "b").about.name == "scenario-b"
        assert find_plant(place / "hilsat-a").about.name == "scenario-a"
        with pytest.raises(PeerLostError, match="no bench runs that logs there"):
            find_plant(place / "c")
    finally:
        for one in standing:
            one.close()


def test_what_the_dead_left_is_passed_over(place: Path) -> None:
    """A socket that refuses, a process that is gone, a directory that others can write to, a link: none is a bench."""
    refused = add_bench(place, "hilsat-refused")
    with StandInSocket(refused / "plant.sock"):
        assert look_into(refused) is not None
    (refused / "plant.sock").touch()
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    add_bench(place, "hilsat-gone", pid=gone.pid)
    open_to_all = add_bench(place, "hilsat-open")
    open_to_all.chmod(0o777)
    (place / "hilsat-link").symlink_to(add_bench(place, "elsewhere"))
    (place / "hilsat-file").touch()
    assert list_benches() == []


class StandInSocket:
    """A socket that is bound and left behind."""

    def __init__(self, path: Path) -> None:
        self._endpoint = Endpoint(path, SYSTEM_ID, PLANT_COMPONENT)
        self._path = path

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        self._endpoint.close()


def test_flight_software_alone_is_no_bench_to_break(place: Path) -> None:
    """Where only that side runs here, the words say where to go."""
    private = add_bench(place, side="fsw", plant=None)
    with pytest.raises(UsageError, match="flight software alone"):
        find_plant(private)


# -- asking ------------------------------------------------------------------------------------------------------------


def test_replies_come_in_order_and_whole(bench: tuple[Path, list[StandIn]]) -> None:
    """A reply of many parts, longer than the socket's queue, and several replies to one request."""
    text = "x" * 20_000
    plant = serve(bench, lambda what: [{"state": "accepted", "text": text}, {"state": "bit", "final": True}])
    with PlantClient(bench[0] / "plant.sock") as client:
        replies = list(client.ask({"do": "set"}, 5.0))
    assert [reply["state"] for reply in replies] == ["accepted", "bit"]
    assert replies[0]["text"] == text
    assert [what for _, what in plant.asked] == [{"do": "set"}]


def test_an_unanswered_request_is_sent_once_more_by_the_same_token(bench: tuple[Path, list[StandIn]]) -> None:
    """So that the plant can tell it from another."""
    plant = serve(bench, lambda what: [{"state": "done", "final": True}], deaf=1)
    with PlantClient(bench[0] / "plant.sock") as client:
        assert client.ask_once({"do": "status"}, 0.6)["state"] == "done"
    tokens = [token for token, _ in plant.asked]
    assert len(tokens) == 2
    assert tokens[0] == tokens[1] != 0


def test_no_answer_ends_in_time(bench: tuple[Path, list[StandIn]]) -> None:
    """A plant that hears and says nothing: two sendings, no more, and code 3."""
    plant = serve(bench, lambda what: [])
    with PlantClient(bench[0] / "plant.sock") as client, pytest.raises(BenchGone, match="no answer") as failure:
        client.ask_once({"do": "status"}, 0.5)
    assert failure.value.exit_code == 3
    assert len(plant.asked) == 2


def test_a_bench_that_goes_is_noticed(bench: tuple[Path, list[StandIn]]) -> None:
    """While an effect is waited for, without a limit."""
    plant = serve(bench, lambda what: [{"state": "accepted", "id": "a"}])
    with PlantClient(bench[0] / "plant.sock") as client:
        replies = client.ask({"do": "set"}, 5.0)
        assert next(replies)["id"] == "a"
        plant.close()
        with pytest.raises(BenchGone, match="has ended"):
            next(replies)


def test_a_refusal_keeps_its_reasons(bench: tuple[Path, list[StandIn]]) -> None:
    """In the plant's words, code 2."""
    serve(bench, lambda what: [{"state": "refused", "reasons": ["a", "did you mean loss?"], "final": True}])
    with PlantClient(bench[0] / "plant.sock") as client, pytest.raises(Refused, match="a\ndid you mean") as failure:
        client.ask_once({"do": "set"}, 5.0)
    assert failure.value.exit_code == 2


def test_clients_clean_up(bench: tuple[Path, list[StandIn]]) -> None:
    """Their sockets have names of their own, and go."""
    with PlantClient(bench[0] / "plant.sock"), PlantClient(bench[0] / "plant.sock"):
        assert len(list(bench[0].glob("ground-*.sock"))) == 2
    assert list(bench[0].glob("ground-*.sock")) == []


# -- words -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "full"),
    [
        ("wheel.2 loss effectiveness=0.3", "set wheel.2 loss effectiveness=0.3"),
        ("wheel.2 loss --for 20 effectiveness=0.3 --wait", "set wheel.2 loss effectiveness=0.3 --for 20 --wait"),
        ("--run runs/x list --json", "list --run runs/x --json"),
        ("--json wheel.2 dead", "set wheel.2 dead --json"),
        ("clear --all", "clear --all"),
        ("--help", "--help"),
        ("", ""),
    ],
)
def test_the_bare_form_is_spelt_out(words: str, full: str) -> None:
    """UNIT KIND is short for set UNIT KIND, wherever the options stand."""
    assert spell_out(words.split()) == full.split()


def test_values_are_read_as_yaml_scalars() -> None:
    """Numbers also in the form that PyYAML takes for text, words as words."""
    settings = ["torque_nm=1e-3", "until_s=20", "latch=until_reset", "id=a:b", "latch2=true"]
    fault = make_request("wheel.1", "bias", settings, OPTIONS)["fault"]
    assert fault == {
        "unit": "wheel.1", "kind": "bias", "torque_nm": 0.001, "until_s": 20, "latch": "until_reset", "id": "a:b",
        "latch2": True,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("settings", "options", "words"),
    [
        (["effectiveness"], {}, "KEY=VALUE"),
        (["a=1", "a=2"], {}, "given twice"),
        (["id=x"], {"id": "y"}, "given twice"),
        ([], {"at_s": 1.0, "at_tick": 3}, "--at and --at-tick"),
        ([], {"for_s": 1.0, "until_s": 3.0}, "--for and --until"),
        (["at_s=1"], {"at_tick": 3}, "at_s and --at-tick"),
        (["until_s=1"], {"for_s": 3.0}, "until_s and --for"),
    ],
)
def test_contradictions_are_named(settings: list[str], options: dict[str, Any], words: str) -> None:
    """Before anything is asked of a plant."""
    with pytest.raises(UsageError, match=words):
        make_request("wheel.1", "loss", settings, OPTIONS | options)


# -- the verb ----------------------------------------------------------------------------------------------------------


def test_a_fault_is_set_and_waited_for(bench: tuple[Path, list[StandIn]], capsys: pytest.CaptureFixture[str]) -> None:
    """Both replies as lines on stdout, exit code 0, and the request that the protocol asks for."""
    plant = serve(
        bench,
        lambda what: [
            {"state": "accepted", "id": "command[0]", "tick": 120, "t_s": 1.2, "text": "wheel.2 loss"},
            {"state": "bit", "id": "command[0]", "tick": 121, "t_s": 1.21, "final": True},
        ],
    )
    code = main(["inject", "wheel.2", "loss", "effectiveness=0.3", "--for", "20", "--at-tick", "120", "--wait"])
    out = capsys.readouterr().out.splitlines()
    assert code == 0
    assert plant.asked[0][1] == {
        "do": "set", "fault": {"unit": "wheel.2", "kind": "loss", "effectiveness": 0.3}, "at_tick": 120, "for_s": 20.0,
        "wait": True,
    }  # fmt: skip
    assert out == [
        "command[0]  acts from tick 120 (1.2 s): wheel.2 loss",
        "command[0]  first changed something at tick 121 (1.21 s)",
    ]


@pytest.mark.parametrize(("state", "code"), [("ended", 1), ("cleared", 1), ("closing", 3)])
def test_a_fault_that_never_bit(
    bench: tuple[Path, list[StandIn]], capsys: pytest.CaptureFixture[str], state: str, code: int
) -> None:
    """--wait ends where it cannot come any more, and says so."""
    serve(bench, lambda what: [{"state": "accepted", "id": "x", "tick": 1}, {"state": state, "id": "x", "final": True}])
    assert main(["inject", "wheel.2", "dead", "--wait", "--json"]) == code
    said = capsys.readouterr()
    told = json.loads(said.out)
    assert (told["state"], told["accepted"]["tick"]) == (state, 1)
    assert "before" in said.err


def test_a_refusal_is_data_and_words(bench: tuple[Path, list[StandIn]], capsys: pytest.CaptureFixture[str]) -> None:
    """--json: one object on stdout also then."""
    serve(bench, lambda what: [{"state": "refused", "reasons": ["did you mean wheel.2?"], "final": True}])
    assert main(["inject", "weel.2", "dead", "--json"]) == 2
    said = capsys.readouterr()
    assert json.loads(said.out) == {"state": "refused", "reasons": ["did you mean wheel.2?"], "exit_code": 2}
    assert "did you mean wheel.2?" in said.err


@pytest.mark.parametrize(
    "words", [["--at", "nan"], ["torque_nm=.inf"], ["id=" + "x" * 100_000], ["--timeout", "nan"], ["--tim", "3"]]
)
def test_what_cannot_be_sent_is_refused(bench: tuple[Path, list[StandIn]], words: list[str]) -> None:
    """Numbers that are none, texts without end, options cut short: code 2, and the plant hears nothing."""
    plant = serve(bench, lambda what: [{"state": "accepted", "final": True}])
    try:
        code = main(["inject", "wheel.2", "bias", *words])
    except SystemExit as usage:
        code = int(str(usage.code))
    assert code == 2
    assert plant.asked == []


def test_clear_tells_an_id_from_a_unit(bench: tuple[Path, list[StandIn]], capsys: pytest.CaptureFixture[str]) -> None:
    """And asks for --all in so many words."""
    plant = serve(bench, lambda what: [{"state": "accepted", "tick": 7, "ids": ["a", "b"], "final": True}])
    for words in (["clear", "wheel.2"], ["clear", "mine"], ["clear", "--all"]):
        assert main(["inject", *words]) == 0
    assert [what for _, what in plant.asked] == [
        {"do": "clear", "unit": "wheel.2"}, {"do": "clear", "id": "mine"}, {"do": "clear"},
    ]  # fmt: skip
    assert capsys.readouterr().out.splitlines() == ["cleared at tick 7: a, b"] * 3
    assert main(["inject", "clear"]) == 2
    assert "--all" in capsys.readouterr().err


def test_list_and_status_for_people(bench: tuple[Path, list[StandIn]], capsys: pytest.CaptureFixture[str]) -> None:
    """What acts, whether it had an effect, and how far the bench is."""
    replies = {
        "list": {
            "state": "done", "tick": 5, "t_s": 0.05, "final": True,
            "faults": [{"id": "a", "unit": "wheel.1", "kind": "loss", "state": "active", "had_effect": False,
                        "definition": {"unit": "wheel.1", "kind": "loss", "effectiveness": 0.3}}],
        },
        "status": {"state": "done", "name": "zhang2018", "tick": 5, "ticks": 100, "t_s": 0.05, "final": True},
    }  # fmt: skip
    serve(bench, lambda what: [replies[what["do"]]])
    assert main(["inject", "list"]) == 0
    out = capsys.readouterr().out
    assert "active, no effect so far" in out
    assert "wheel.1 loss effectiveness=0.3" in out
    assert main(["inject", "status"]) == 0
    assert capsys.readouterr().out == "zhang2018: tick 5 of 100 (0.05 s)\n"


def test_the_catalogue_needs_no_bench(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every kind of the register for each of its units, the keys with what they take."""
    assert main(["inject", "catalogue", "--json"]) == 0
    kinds = json.loads(capsys.readouterr().out)["kinds"]
    loss = next(kind for kind in kinds if "wheel.2" in kind["units"] and kind["kind"] == "loss")
    assert loss["keys"] == [
        {"name": "effectiveness", "unit": "1", "limits": ">= 0, < 1", "default": None, "needed": True}
    ]
    assert main(["inject", "catalogue", "weel.2"]) == 2
    assert "did you mean wheel.2?" in capsys.readouterr().err


def test_the_completion_is_bash_and_offers_kinds(tmp_path: Path) -> None:
    """Run by bash itself: kinds of the unit's family, keys of the kind."""
    script = tmp_path / "complete"
    script.write_text(write_completion(("run", "inject")))
    ask = (
        f"source {script}; complete_words() {{ COMP_WORDS=(\"$@\"); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1)); "
        "_hilsat_inject 2>/dev/null; echo \"${COMPREPLY[*]}\"; }; "
        "complete_words hilsat inject wheel.2 lo; complete_words hilsat inject set gyro.x st; "
        "complete_words hilsat inject wheel.2 loss eff; complete_words hilsat in"
    )  # fmt: skip
    done = subprocess.run(["bash", "-c", ask], capture_output=True, text=True, check=True)
    wheel, gyro, key, verb = done.stdout.splitlines()
    assert "loss" in wheel.split()
    assert "stuck" in gyro
    assert (key, verb) == ("effectiveness=", "inject")
