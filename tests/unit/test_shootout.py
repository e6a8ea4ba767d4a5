"""`hilsat shootout`: who meets whom, what it says of them, and what becomes of pairs that cannot fly."""

from __future__ import annotations

import json
import math
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bus.attitude import angle_between
from bus.errors import UsageError
from bus.units import DEG
from fsw import allocators, controllers, observers, wheel_health
from fsw.controllers.settings import SmcConfig
from tools.cli import main
from tools.config.scenario_files import find_scenario
from tools.run.bench import Bench
from tools.shootout import flights
from tools.shootout.flights import FLEW, NOT_FLOWN, Outcome, fly_all
from tools.shootout.pairs import COMPANIONS, Contest, Pair, choose_pairs

SHORT = ["shootout", "-q", "--controllers", "smc,braking_profile", "--allocators", "pseudo_inverse"]
PAIRS = choose_pairs("smc,braking_profile", "pseudo_inverse")


def contest(*settings: str, until_s: float | None = 2.0) -> Contest:
    return Contest(find_scenario("zhang2018"), settings, until_s)


def test_every_registered_law_meets_every_registered_allocator() -> None:
    """The registries say who: nobody is left out, nobody comes twice."""
    pairs = choose_pairs(None, None)
    assert [(pair.controller, pair.allocator) for pair in pairs] == [
        (law, share) for law in controllers.REGISTRY.kinds for share in allocators.REGISTRY.kinds
    ]


def test_companions_are_registered() -> None:
    """What a law is made for is there, and the law too."""
    assert COMPANIONS.keys() <= controllers.REGISTRY.kinds.keys()
    for companions in COMPANIONS.values():
        assert companions.observer in {None, *observers.REGISTRY.kinds}
        assert companions.wheel_health in {None, *wheel_health.REGISTRY.kinds}


@pytest.mark.parametrize("law", list(controllers.REGISTRY.kinds))
def test_every_law_can_fly_the_published_faults(law: str) -> None:
    """With its defaults and its companions: the scenario is sound, and says so of the law that was asked for."""
    resolved = contest(until_s=None).load(Pair(law, "pseudo_inverse"))
    fsw = resolved.scenario.fsw
    assert fsw.controller == controllers.REGISTRY.kinds[law][0](kind=law)
    companions = COMPANIONS.get(law)
    own = ("ilo", "none")
    wanted = own if companions is None else (companions.observer or own[0], companions.wheel_health or own[1])
    assert (fsw.observer.kind, fsw.wheel_health.kind) == wanted


def test_a_law_flies_with_its_defaults_whatever_the_scenario_has(tmp_path: Path) -> None:
    """A scenario with smc tuned otherwise: the shootout flies the defaults, unless --set says more."""
    path = tmp_path / "mine.yaml"
    path.write_text("extends: zhang2018\nname: mine\nfsw: {controller: {k1: 9, beta0: 0.2}}\n")
    pair = Pair("smc", "transpose")
    assert Contest(path, ()).load(pair).scenario.fsw.controller == SmcConfig(kind="smc")
    tuned = Contest(path, ("fsw.controller.k1=3",)).load(pair).scenario.fsw.controller
    assert tuned == SmcConfig(kind="smc", k1=3.0)


def test_faults_that_come_too_late_are_left_out() -> None:
    """--until 15 keeps the one fault of before 15 s; the full time keeps all five."""
    assert [fault.at_s for fault in contest(until_s=15.0).load_common().scenario.faults] == [10.0]
    assert len(contest(until_s=None).load_common().scenario.faults) == 5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--controllers", "smcc"], "did you mean smc?"),
        (["--controllers", "smc,braking"], "there are: braking_profile"),
        (["--allocators", "transposed"], "did you mean transpose?"),
        (["--controllers", ","], "names nobody"),
        (["zhang2081"], "did you mean zhang2018?"),
        (["--set", "fsw.observr={kind: none}"], 'did you mean "observer"?'),
        (["--set", "fsw.controller.k9=1"], "no pair can fly"),
        (["--until", "2.05"], "not a whole number of ticks"),
        (["--until", "nan"], "duration_s"),
        (["--jobs", "0"], "1 to 64"),
        (["--plot"], "--out"),
    ],
)
def test_mistakes_are_named(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 2, the choices or the near miss on stderr, nothing on stdout."""
    assert main(["shootout", "-q", *words]) == 2
    out, err = capsys.readouterr()
    assert message in err
    assert not out


def test_unknown_names_raise_before_anything_is_flown() -> None:
    """The first wrong name of a list."""
    with pytest.raises(UsageError, match="'direkt' is not known"):
        choose_pairs(None, "transpose,direkt")


def test_two_pairs_end_to_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Table, JSON and picture of two laws; the figures are those of a bench that was read tick by tick, without a log."""
    out = tmp_path / "out"
    assert main([*SHORT, "--until", "12", "--json", "--out", str(out)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == json.loads((out / "shootout.json").read_text())
    assert (out / "shootout.png").read_bytes()[:4] == b"\x89PNG"
    table = (out / "table.md").read_text()
    assert [line.split("|")[1].strip() for line in table.splitlines() if line.startswith("|")][2:] == [
        "smc",
        "braking_profile",
    ]
    for pair, row in zip(PAIRS, told["pairs"], strict=True):
        assert (row["controller"], row["allocator"], row["outcome"]) == (pair.controller, pair.allocator, FLEW)
        expected = read_tick_by_tick(pair, 12.0)
        assert {key: row["figures"][key] for key in expected} == pytest.approx(expected, rel=1e-9)
        assert row["figures"]["settled_5_deg_s"] is None  # 60 deg are not turned in 12 s
        assert f"not by {12:g}" in table


def read_tick_by_tick(pair: Pair, until_s: float) -> dict[str, float]:
    bench = Bench(contest(until_s=until_s).load(pair))
    impulse = effort = peak = variation = 0.0
    before = None
    errors = []
    for _ in range(bench.ticks):
        bench.step()
        flight = bench.flight
        errors.append(angle_between(flight.guidance.target.q_it, bench.sampled_truth.q_ib) / DEG)
        commands = flight.wheel_commands.tau_rw_nm
        impulse += math.hypot(*flight.tau_cmd_b_nm) * bench.tick_s
        effort += sum(u * u for u in commands) * bench.tick_s
        peak = max(peak, *map(abs, commands))
        variation += sum(abs(u - v) for u, v in zip(commands, before or commands, strict=True))
        before = commands
    last = sorted(errors[-30:])  # a quarter of 12 s
    return {
        "impulse_nms": impulse,
        "effort_n2m2s": effort,
        "peak_rw_nm": peak,
        "variation_nm_s": variation / until_s,
        "steady_deg": (last[14] + last[15]) / 2.0,
        "pointing_share": 1.0,
    }


def test_the_same_twice(capsys: pytest.CaptureFixture[str]) -> None:
    """Not a character differs from one shootout to the next."""
    texts = []
    for _ in range(2):
        assert main([*SHORT, "--until", "3"]) == 0
        texts.append(capsys.readouterr().out)
    assert texts[0] == texts[1]
    assert "not by 3" in texts[0]


@pytest.mark.slow
def test_two_at_a_time_give_what_one_after_the_other_gives(capsys: pytest.CaptureFixture[str]) -> None:
    """The order of the rows, and every figure."""
    texts = []
    for jobs in ("1", "2"):
        assert main([*SHORT, "--until", "3", "--jobs", jobs, "--json"]) == 0
        texts.append(capsys.readouterr().out)
    assert texts[0] == texts[1]


@pytest.mark.slow
def test_the_published_law_settles_when_the_reference_does(capsys: pytest.CaptureFixture[str]) -> None:
    """69.1, 99.3 and 123.8 s, of an independent integration of Zhang, Ye & Sun 2018, within 1 s."""
    assert main([*SHORT[:2], "--controllers", "smc", "--allocators", "pseudo_inverse", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)["pairs"][0]["figures"]
    for key, expected in (("settled_5_deg_s", 69.1), ("settled_1_deg_s", 99.3), ("settled_01_deg_s", 123.8)):
        assert figures[key] == pytest.approx(expected, abs=1.0), key


def test_a_pair_that_cannot_fly_is_a_row(capsys: pytest.CaptureFixture[str]) -> None:
    """A key that only one of two laws has: the other's row says why, and the exit code is 1."""
    assert main([*SHORT, "--until", "2", "--set", "fsw.controller.k1=5"]) == 1
    lines = capsys.readouterr().out.splitlines()
    row = next(line for line in lines if line.startswith("| braking_profile"))
    assert "cannot fly" in row
    assert any("fsw.controller.k1: is not a known key" in line for line in lines)
    assert "cannot fly" not in next(line for line in lines if line.startswith("| smc"))


def test_what_fails_on_the_way_is_a_row_and_3(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A crash of one law does not take the others with it; its traceback is kept."""
    monkeypatch.setenv("HILSAT_TRACES", str(tmp_path))
    step = Bench.step

    def fail(bench: Bench, *words: Any) -> Bench:
        if bench.flight.controller.__class__.__name__ == "SlidingMode":
            raise ZeroDivisionError("by nothing")
        return step(bench, *words)

    monkeypatch.setattr(Bench, "step", fail)
    assert main([*SHORT, "--until", "2", "--json"]) == 3
    failed, flew = json.loads(capsys.readouterr().out)["pairs"]
    assert (failed["outcome"], failed["figures"], flew["outcome"]) == ("failed", None, FLEW)
    assert "ZeroDivisionError: by nothing" in failed["reason"]
    assert len(list(tmp_path.glob("*traceback*"))) == 1


def stop_at(pair: Pair) -> Callable[..., Outcome]:
    """As `fly`, with Ctrl-C when the pair begins."""
    fly = flights.fly

    def fly_or_stop(contest: Contest, wanted: Pair) -> Outcome:
        if wanted == pair:
            raise KeyboardInterrupt
        return fly(contest, wanted)

    return fly_or_stop


def test_ctrl_c_keeps_what_is_done(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """On the second pair: the first stands in the table and in the files, the second is not flown, exit code 130."""
    monkeypatch.setattr(flights, "fly", stop_at(PAIRS[1]))
    assert main([*SHORT, "--until", "2", "--out", str(tmp_path), "--no-plot"]) == 130
    out = capsys.readouterr().out
    assert "CUT SHORT by a signal: 1 of 2 pairs are done" in out
    assert "not flown" in next(line for line in out.splitlines() if line.startswith("| braking_profile"))
    told = json.loads((tmp_path / "shootout.json").read_text())
    assert told["cut_short"] is True
    assert [row["outcome"] for row in told["pairs"]] == [FLEW, NOT_FLOWN]


def test_a_signal_while_it_is_told_cuts_short_too() -> None:
    """What is done is kept though the signal came before anybody heard of it."""

    def interrupt(outcome: Outcome) -> None:
        raise KeyboardInterrupt

    outcomes, number = fly_all(contest(), PAIRS, 1, interrupt)
    assert number == signal.SIGINT
    assert [outcome.state for outcome in outcomes] == [FLEW, NOT_FLOWN]


def test_what_is_there_is_not_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Refused before anything is flown; without a picture only the other two are written."""
    words = [*SHORT, "--until", "2", "--no-plot", "--out", str(tmp_path)]
    (tmp_path / "table.md").write_text("mine")
    assert main(words) == 2
    assert "there is a table.md in it already" in capsys.readouterr().err
    assert (tmp_path / "table.md").read_text() == "mine"
    (tmp_path / "table.md").unlink()
    assert main(words) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["shootout.json", "table.md"]


@pytest.mark.parametrize(
    "setting", ["fsw.controller.kind=pid", "fsw.allocator={kind: direct}", "fsw.controller={kind: pid}"]
)
def test_a_setting_does_not_change_what_a_row_names(setting: str) -> None:
    """The kinds are the shootout's own choice: set by hand, the row would name a law that did not fly."""
    with pytest.raises(UsageError, match=r"the shootout chooses these kinds itself; take --(controllers|allocators)"):
        contest(setting).check()
    contest("fsw.controller.k1=3").check()
