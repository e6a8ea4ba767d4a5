"""Whether a scenario gives the same bytes here however it is run: again, in other processes, on every bus, by each build."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from bus.build import CURRENT
from bus.errors import HilsatError
from tools.log.diff import Comparison, compare_runs
from tools.log.mcap_reader import read_run
from tools.vcan import native

PATIENCE_S: Final = 3600.0
NET: Final = Path("/sys/class/net")


@dataclass(frozen=True, slots=True)
class Way:
    """One way to run a scenario. `hash_seed`: of Python's sets and dictionaries, another one each time."""

    name: str
    words: tuple[str, ...]
    build: str = ""  # plain or compiled, in place of the usual one
    hash_seed: str = "0"


@dataclass(frozen=True, slots=True)
class Tried:
    """What came of one way."""

    way: str
    digest: str  # empty: it could not be run
    trouble: str = ""
    same: bool | None = None  # as the first way; None: not known
    comparison: Comparison | None = None  # where it differs

    def as_dict(self) -> dict[str, Any]:
        """In JSON types."""
        return asdict(self)


def list_ways() -> tuple[list[Way], list[str]]:
    """The ways that this machine has, and in words those that it has not."""
    ways = [
        Way("in process", ("--clock", "inprocess")),
        Way("in process, once more", ("--clock", "inprocess"), hash_seed="4711"),
        Way("lock-step, two processes, embedded bus", ("--clock", "lockstep", "--bus", "hub:"), hash_seed="1"),
    ]
    missing = []
    obstacle = native.socket_obstacle()
    interfaces = sorted(path.name for path in NET.glob("vcan*")) if not obstacle else []
    if interfaces:
        ways.append(Way(f"lock-step, {interfaces[0]}", ("--clock", "lockstep", "--bus", f"socketcan:{interfaces[0]}")))
    else:
        missing.append(
            f"no vcan: {obstacle or 'no such interface is up'}; `hilsat vcan exec -- hilsat verify ...` has one"
        )
    if CURRENT.compiled:
        ways.append(Way("in process, the plain build", ("--clock", "inprocess"), build="plain"))
    else:
        missing.append("no compiled build: `make compiled` makes one")
    missing.append("real time is left out: what arrives when is up to the machine there")
    return ways, missing


def try_ways(scenario: str, overrides: Sequence[str], ways: Sequence[Way], place: Path) -> Iterator[Tried]:
    """Run the scenario in each way and compare it with the first one that ran."""
    first: Path | None = None
    for i, way in enumerate(ways):
        out = place / str(i)
        trouble = _run(scenario, overrides, way, out)
        if trouble:
            yield Tried(way.name, "", trouble)
            continue
        log = out / "run.mcap"
        try:
            run = read_run(log)
            if first is None:
                first = log
                yield Tried(way.name, run.digest(), same=True)
                continue
            comparison = compare_runs(read_run(first), run)
        except HilsatError as error:
            yield Tried(way.name, "", str(error))
            continue
        yield Tried(way.name, comparison.digest_b, "", comparison.same, None if comparison.same else comparison)
        log.unlink()


def _run(scenario: str, overrides: Sequence[str], way: Way, out: Path) -> str:
    """Run it as a user would; return why that did not work, empty when it did."""
    command = [
        sys.executable,
        "-P",
        "-m",
        "tools.cli",
        "run",
        scenario,
        "--no-plot",
        "--json",
        "-q",
        "--out",
        str(out),
        *way.words,
    ]
    command += [word for override in overrides for word in ("--set", override)]
    environment = {**os.environ, "PYTHONHASHSEED": way.hash_seed} | ({"HILSAT_BUILD": way.build} if way.build else {})
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=PATIENCE_S, env=environment, check=False,
            stdin=subprocess.DEVNULL,
        )  # fmt: skip
        ended = int(json.loads(done.stdout)["run"]["exit_code"]) if done.stdout else done.returncode
    except (OSError, ValueError, KeyError, TypeError, subprocess.TimeoutExpired) as error:
        return f"cannot be run: {error}"
    words = done.stderr.strip().splitlines()
    return "" if ended == 0 else (words[-1] if words else f"ended with exit code {ended}")
