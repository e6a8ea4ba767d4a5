"""The compiled build and the plain one compute the same bits: every shipped scenario, in process, whole.

Run by `make test-compiled`, which builds first.
"""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tools.config.scenario_files import list_shipped

pytestmark = pytest.mark.compiled

FLY = """
import sys, tempfile
from pathlib import Path
from bus.build import CURRENT
from tools.config.loader import load_scenario
from tools.config.scenario_files import find_scenario
from tools.log.mcap_reader import read_run
from tools.run.in_process import run_in_process

resolved = load_scenario(find_scenario(sys.argv[1]), ["clock.mode=inprocess"])
with tempfile.TemporaryDirectory() as place:
    report = run_in_process(resolved, Path(place) / "run", lambda tick: None)
    print(CURRENT.words.split(":")[0], report.ticks, read_run(report.log).digest())
"""


def run_python(code: str, scenario: str, build: str) -> list[str]:
    """The words that a program prints when that build runs it."""
    environment = {**os.environ, "HILSAT_BUILD": build}
    done = subprocess.run(
        [sys.executable, "-P", "-c", code, scenario],
        capture_output=True,
        text=True,
        timeout=280,
        env=environment,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.parametrize("scenario", list_shipped())
def test_plain_and_compiled_give_the_same_bytes(scenario: str) -> None:
    """Digests over all deterministic topics, frames included, from two processes that say which build they run."""
    plain, compiled = (run_python(FLY, scenario, build) for build in ("plain", "compiled"))
    assert (plain[0], compiled[0]) == ("plain", "compiled")
    assert plain[1:] == compiled[1:]


COUNT = """
import sys
from collections import Counter
from tools.config.loader import load_scenario
from tools.config.scenario_files import find_scenario
from tools.run.bench import Bench

bench = Bench(load_scenario(find_scenario(sys.argv[1]), ["clock.mode=inprocess", "expect=[]"]), log="memory")
bench.step(200)
calls = Counter()
sys.setprofile(lambda frame, event, _: calls.update([frame.f_code.co_filename] if event == "call" else []))
bench.step(1000)
sys.setprofile(None)
print(sum(calls.values()) / 1000, *calls.most_common(5))
"""


@pytest.mark.parametrize("scenario", ["zhang2018", "zhang2018-flight"])
def test_a_tick_is_compiled_through_and_through(scenario: str) -> None:
    """Calls of interpreted functions a tick, counted: a module of the hot path that slips back makes them many more."""
    words = run_python(COUNT, scenario, "compiled")
    assert float(words[0]) < 6.0, words
