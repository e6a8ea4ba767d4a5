"""Does the judge see? For each shipped requirement, what turns it to FAIL: docs/judge.md.

python -m tools.design.judge_study                      all scenarios anew, into docs/judge.md (15 min of CPU time)
python -m tools.design.judge_study zhang2018 nominal    these alone; what the page has of others stays
python -m tools.design.judge_study --missing            those whose requirements the page has not, or has otherwise

Each scenario is flown as it is, then with one thing wrong at a time, handling of faults first, until each of its
requirements has failed once. Every flight is graded by the requirements of the sound scenario. Its first 60 % are graded
too: what needs the rest must not pass. Flights are in process, but for one: missed deadlines take a clock that goes on.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from bus.errors import ConfigError, UsageError
from bus.settings import plain
from tools.config.expect import Expectation, expressions_of
from tools.config.loader import load_scenario
from tools.config.requirements import load_requirements
from tools.config.scenario import Resolved, Scenario
from tools.config.scenario_files import SHIPPED
from tools.grading.grade import WORDS, Grade, grade_run, scenario_of
from tools.grading.verdict import Outcome
from tools.log.mcap_reader import read_run
from tools.run.bench import Bench

PAGE: Final = Path(__file__).resolve().parents[2] / "docs" / "judge.md"
ROW: Final = re.compile(r"\| (.*) \| (PASS|FAIL|NOT EXECUTED) \| (PASS|FAIL|NOT EXECUTED) \| (.*?) \| (.*) \|")
COMMANDED: Final = "fsw.control.tau_rw_cmd_nm"
NOTHING: Final = "**nothing that was tried**"
COMMAND: Final = "python -m tools.design.judge_study"
BENCH: Final = "bench"  # requirement file that any run can be held against
BENCH_ON: Final = "zhang2018-flight"
BENCH_S: Final = 20.0
STALLED_ON: Final = "realtime-60s"
STALLED: Final = "flight software stopped for 0.05 s, twice a second, in real time"
STOP_S: Final = 0.05
PATIENCE_S: Final = 30.0
CUT: Final = 0.6  # share of a run after which the log is cut
WORKERS: Final = 2


@dataclass(frozen=True, slots=True)
class Mutation:
    """One thing that is made wrong: what, and the overrides that do it."""

    name: str
    overrides: tuple[str, ...]
    only: str = ""  # flown for requirements whose signal has this in it, and for no others


@dataclass(slots=True)
class Row:
    """What became of one requirement."""

    name: str
    sound: Outcome
    cut: Outcome
    catch: str = ""  # the first mutation that turned it to FAIL; empty: none did
    figure: str = ""  # what was graded then, and what it had to be


def list_mutations(scenario: Scenario) -> Iterator[Mutation]:
    """Everything that is made wrong in a scenario, one thing at a time; what handles faults comes first."""
    fsw = scenario.fsw
    handlers = {"observer": fsw.observer, "wheel_health": fsw.wheel_health, "detector": fsw.detector}
    words = {"observer": "observer off", "wheel_health": "wheel health off", "detector": "gyro fault detection off"}
    for key, settings in handlers.items():
        if settings.kind != "none":
            yield Mutation(words[key], (f"fsw.{key}={{kind: none}}",))
    if scenario.faults:
        yield Mutation("faults do not come", ("faults=[]",))
        yield Mutation("faults do not end", (_faults(scenario, keep=False),))
        yield Mutation("faults come and go 2 s late", (_faults(scenario, late_s=2.0),))
    torque = fsw.model.wheel_max_torque_nm
    belief = "flight software believes in three times the wheel torque"
    beliefs, turned = f"fsw.model.wheel_max_torque_nm={3 * torque}", "plant.body.attitude_q=[0, 0.6, 0, 0.8]"
    if fsw.model.wheels is not None:  # each has its own
        wheels = [item | {"max_torque_nm": 3 * item["max_torque_nm"]} for item in plain(fsw.model.wheels)]
        beliefs = f"fsw.model.wheels={json.dumps(wheels)}"
    yield Mutation(belief, (beliefs,), COMMANDED)
    yield Mutation(f"{belief}, and starts turned away by 180 deg", (beliefs, turned), COMMANDED)
    yield from _list_more_faults(scenario)
    inertia = [[3.0 * value for value in row] for row in scenario.plant.body.inertia_kgm2]
    yield Mutation("body three times as heavy", (f"plant.body.inertia_kgm2={inertia}",))
    if fsw.timeline:
        yield Mutation("commands of the timeline do not come", ("fsw.timeline=[]",))
    torques = [*plain(scenario.plant.torques), {"kind": "constant", "torque_nm": [0.5 * torque] * 3}]
    yield Mutation("disturbance of half a wheel's torque about each axis", (f"plant.torques={json.dumps(torques)}",))
    yield Mutation("commands 5 ticks late", ("plant.command_latency_ticks=5", "plant.command_max_age_ticks=9"))
    yield Mutation("start turned away by 180 deg", (turned,))
    yield Mutation("tactical gyro", ("plant.gyro={preset: tactical}",))


def _list_more_faults(scenario: Scenario) -> Iterator[Mutation]:
    half_s = round(0.5 * scenario.duration_s)
    more = {
        "every wheel gives a fifth from 1 s on": [
            {"unit": f"wheel.{n}", "kind": "loss", "effectiveness": 0.2, "at_s": 1.0} for n in (1, 2, 3, 4)
        ],
        "wheels 2 and 3 dead from half of the run on": [
            {"unit": f"wheel.{n}", "kind": "dead", "at_s": half_s} for n in (2, 3)
        ],
        "every gyro axis drifts by 0.02 rad/s from 2 s on": [
            {"unit": f"gyro.{axis}", "kind": "constant", "rate_rad_s": 0.02, "at_s": 2.0} for axis in "xyz"
        ],
        "gyro z drifts by 0.05 rad/s from half of the run on": [
            {"unit": "gyro.z", "kind": "constant", "rate_rad_s": 0.05, "at_s": half_s}
        ],
        "star tracker turns away by 1 deg from half of the run on": [
            {"unit": "star_tracker", "kind": "misaligned", "angle_deg": 1.0, "at_s": half_s}
        ],
        "star tracker frozen from 5 s on": [{"unit": "star_tracker", "kind": "frozen", "at_s": 5.0}],
        "bus loses nine frames of ten from 5 s on": [{"unit": "bus", "kind": "loss", "probability": 0.9, "at_s": 5.0}],
        "bits turned in one frame of ten from 5 s on": [
            {"unit": "bus", "kind": "bit_errors", "probability": 0.1, "at_s": 5.0}
        ],
        "star tracker silent on the bus from 5 s on": [
            {"unit": "bus", "kind": "silent", "node": "star_tracker", "at_s": 5.0}
        ],
    }  # fmt: skip
    for name, faults in more.items():
        yield Mutation(name, (_faults(scenario, faults),))


def _faults(
    scenario: Scenario, more: Iterable[dict[str, object]] = (), *, keep: bool = True, late_s: float = 0.0
) -> str:
    """The scenario's faults and more; `keep` False: without their ends; late_s: so much later."""
    own = [
        {key: value + late_s if key in ("at_s", "until_s") else value for key, value in item.items()}
        for item in plain(scenario.faults)
    ]
    kept = [{key: value for key, value in item.items() if keep or key != "until_s"} for item in own]
    return f"faults={json.dumps([*kept, *more])}"


def study(path: Path, expect: tuple[Expectation, ...], overrides: tuple[str, ...] = ()) -> list[Row]:
    """What becomes of each requirement when the scenario is flown as it is, cut short, and with one thing wrong."""
    own = (*overrides, "expect=[]")
    resolved = load_scenario(path, own)
    cut, sound = fly(resolved, expect, (CUT, 1.0))
    rows = [Row(item.name, sound[item.name][0], cut[item.name][0]) for item in expect]
    signals = {item.name: " ".join(expressions_of(item)) for item in expect}
    for mutation in list_mutations(resolved.scenario):
        wanted = [row for row in rows if not row.catch and mutation.only in signals[row.name]]
        if not wanted:
            continue
        try:
            (graded,) = fly(load_scenario(path, [*own, *mutation.overrides]), expect)
        except ConfigError:
            continue  # not possible here: a wheel that is dead already, a topic of an algorithm that is off
        for row in wanted:
            outcome, figure = graded[row.name]
            if outcome == "fail":
                row.catch, row.figure = mutation.name, figure
    slips = [item.name for item in expect if any("slips" in expression for expression in expressions_of(item))]
    for row in [row for row in rows if row.name in slips and not row.catch]:
        outcome, figure = stall(expect)[row.name]
        if outcome == "fail":
            row.catch, row.figure = STALLED, figure
    return rows


def stall(expect: tuple[Expectation, ...]) -> dict[str, tuple[Outcome, str]]:
    """Fly a few seconds in real time, with the flight software stopped now and then; outcome and figure by name.

    Raises UsageError where it could not be stopped.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        words = ["run", STALLED_ON, "--duration", "5", "--set", "expect=[]", "--set", "faults=[]", "--no-plot", "-q"]
        runner = subprocess.Popen(
            [sys.executable, "-P", "-m", "tools.cli", *words, "--out", str(out)], stdout=subprocess.DEVNULL
        )
        until = time.monotonic() + PATIENCE_S
        child = None
        while child is None and time.monotonic() < until and runner.poll() is None:
            time.sleep(0.1)
            child = _find_child(runner.pid, "fsw")
        if child is not None:
            _stop_again_and_again(runner, child)
        runner.wait()
        logs = list(out.rglob("*.mcap"))
        if child is None or not logs:
            raise UsageError("the flight software of a run in real time was not found")
        run = read_run(logs[0])
        return _read_verdicts(grade_run(run, scenario_of(run, logs[0]), expect), expect)


def _stop_again_and_again(runner: subprocess.Popen[bytes], child: int) -> None:
    """Stop a process for a moment, twice a second, until the run is over."""
    while runner.poll() is None:
        try:
            os.kill(child, signal.SIGSTOP)
            time.sleep(STOP_S)
            os.kill(child, signal.SIGCONT)
        except ProcessLookupError:
            return
        time.sleep(0.5)


def _find_child(parent: int, module: str) -> int | None:
    """Process id of a child that runs a module, None where there is none yet."""
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            words = (entry / "cmdline").read_bytes().split(b"\0")
            if int((entry / "stat").read_text().rpartition(")")[2].split()[1]) == parent and module.encode() in words:
                return int(entry.name)
        except (OSError, ValueError):
            continue
    return None


def fly(
    resolved: Resolved, expect: tuple[Expectation, ...], shares: tuple[float, ...] = (1.0,)
) -> list[dict[str, tuple[Outcome, str]]]:
    """Fly in process; outcome and figure of every requirement by its name, after each of these shares of the run."""
    found = []
    with Bench(resolved, log="memory") as bench:
        for share in shares:
            bench.step(round(share * bench.ticks) - bench.tick)
            found.append(_read_verdicts(grade_run(bench.log, resolved, expect), expect))
    return found


def _read_verdicts(grade: Grade, expect: tuple[Expectation, ...]) -> dict[str, tuple[Outcome, str]]:
    found: dict[str, tuple[Outcome, str]] = {}
    for verdict in grade.verdicts[: len(expect)]:
        value = "-" if verdict.value is None else f"{verdict.value:.3g}"
        found[verdict.name] = (verdict.outcome, f"{value}; {verdict.bound}")
    return found


@cache
def list_cases() -> dict[str, tuple[Path, tuple[Expectation, ...], tuple[str, ...]]]:
    """What is studied, by name: scenario, requirements, overrides."""
    cases = {path.stem: _make_case(path) for path in sorted(SHIPPED.glob("*.yaml"))}
    for path in sorted((SHIPPED / "requirements").glob("*.yaml")):
        length = (f"duration_s={BENCH_S}", "faults=[]")
        expect = load_requirements(path, BENCH_ON, BENCH_S)
        cases[f"requirements/{path.stem}"] = (SHIPPED / f"{BENCH_ON}.yaml", expect, length)
    return cases


def _make_case(path: Path) -> tuple[Path, tuple[Expectation, ...], tuple[str, ...]]:
    return path, load_scenario(path).scenario.expect, ("clock.mode=lockstep",)


def _study_case(name: str) -> tuple[str, list[Row]]:
    path, expect, overrides = list_cases()[name]
    return name, study(path, expect, overrides)


def format_case(name: str, rows: list[Row]) -> str:
    """The table of one scenario."""
    lines = [
        f"## {name}",
        "",
        "| requirement | as it is | log cut at 60 % | turned to FAIL by | graded then; must be |",
    ]
    lines.append("|---|---|---|---|---|")
    for row in rows:
        catch = row.catch or NOTHING
        cells = (row.name, WORDS[row.sound], WORDS[row.cut], catch, row.figure)
        lines.append("| " + " | ".join(cell.replace("|", "\\|").replace("<", "&lt;") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def read_page(text: str) -> dict[str, list[Row]]:
    """The rows of each scenario that a page has."""
    outcomes: dict[str, Outcome] = {word: outcome for outcome, word in WORDS.items()}
    found: dict[str, list[Row]] = {}
    name = ""
    for line in text.splitlines():
        if line.startswith("## "):
            name = line.removeprefix("## ")
        elif name and (match := ROW.match(line)):
            wanted, sound, cut, catch, figure = (
                cell.replace("\\|", "|").replace("&lt;", "<") for cell in match.groups()
            )
            catch = "" if catch == NOTHING else catch
            found.setdefault(name, []).append(Row(wanted, outcomes[sound], outcomes[cut], catch, figure))
    return found


def format_page(studied: dict[str, list[Row]], unflown: Iterable[str] = ()) -> str:
    """The page: what was done, the sum, a table a scenario. unflown: scenarios that ship and are not in it, in words."""
    rows = [(name, row) for name, rows in studied.items() for row in rows]
    caught = sum(bool(row.catch) for _, row in rows)
    blind = [f"- {name}: {row.name}" for name, row in rows if not row.catch]
    counts: dict[str, int] = {}
    for _, row in rows:
        counts[row.catch or "nothing that was tried"] = counts.get(row.catch or "nothing that was tried", 0) + 1
    order = sorted(counts.items(), key=lambda item: -item[1])
    missing = [f"- {words}" for words in unflown]
    text = f"""# Does the judge see?

A requirement that nothing can fail is no requirement. Each one that ships was held against flights with one thing made wrong
at a time, fault handling first, until it failed; the tables name the first thing that turned it to FAIL, with what was
graded then. Made by

    {COMMAND}

**{caught} of {len(rows)} requirements are turned to FAIL by something.** {_say_list("These are not:", blind)}The column
"log cut at 60 %" is the verdict on a log that ends there: PASS only where the window ends before. The run as a whole is
never passed then, for its last tick is missing.

{_say_list("Not flown for this page yet:", missing)}| made wrong | requirements that it was the first to turn |
|---|---|
"""
    text += "".join(f"| {name} | {count} |\n" for name, count in order) + "\n"
    return text + "\n".join(format_case(name, rows) for name, rows in studied.items() if rows)


def _say_list(head: str, items: list[str]) -> str:
    return f"{head}\n\n" + "\n".join(items) + "\n\n" if items else ""


def update_page(new: dict[str, list[Row]], *, anew: bool = False) -> None:
    """Write docs/judge.md with these scenarios, and what it has of others that still ship as they are; `anew`: without."""
    known = {} if anew or not PAGE.exists() else read_page(PAGE.read_text(encoding="utf-8"))
    cases = {name: [item.name for item in expect] for name, (_, expect, _) in list_cases().items() if expect}
    known |= new
    kept = {name: known[name] for name, names in cases.items() if [row.name for row in known.get(name, [])] == names}
    unflown = [f"{name}: {'; '.join(names)}" for name, names in cases.items() if name not in kept]
    with tempfile.NamedTemporaryFile("w", dir=PAGE.parent, delete=False, encoding="utf-8") as file:
        file.write(format_page(kept, unflown))
    Path(file.name).chmod(0o644)
    Path(file.name).replace(PAGE)


def main() -> None:
    """Study the scenarios named, or all, and keep the page up to date after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", help="names of scenarios, or requirements/NAME; left out: all")
    parser.add_argument("--missing", action="store_true", help="those alone that the page has not")
    args = parser.parse_args()
    known = [name for name, (_, expect, _) in list_cases().items() if expect]
    there = read_page(PAGE.read_text(encoding="utf-8")) if args.missing and PAGE.exists() else {}
    wanted = args.cases or [name for name in known if name not in there]
    if unknown := [name for name in wanted if name not in known]:
        parser.error(f"there is no {', '.join(unknown)}; there are: {', '.join(known)}")
    studied: dict[str, list[Row]] = {}
    with multiprocessing.get_context("spawn").Pool(WORKERS, os.nice, (2,)) as pool:
        for name, rows in pool.imap_unordered(_study_case, wanted, 1):
            studied[name] = rows
            print(format_case(name, rows), flush=True)
            update_page(studied, anew=not args.cases and not args.missing)
    print(PAGE)


if __name__ == "__main__":
    main()
