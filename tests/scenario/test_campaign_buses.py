"""A campaign on other clocks and real buses: one run after the other, judged from the logs."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from tools.campaign.job import make_job
from tools.campaign.launch import Options, fly_campaign
from tools.campaign.plan import Point, RunPlan
from tools.campaign.progress import Silence
from tools.campaign.results import RunResult, read_results
from tools.campaign.strategies.settings import PlanSettings
from tools.log.mcap_reader import read_run

BASE = "zhang2018-flight"
PLAN = PlanSettings()
EXPECT = "{name: rate, check: below, signal: norm(fsw.attitude.omega_bi_b_hat_rad_s), unit: rad/s, bound: "


@dataclasses.dataclass
class TwoRuns:
    """A campaign without a file: one run that passes, one that does not."""

    runs: int | None = 2
    seed: int = 3
    name: str = "two"
    title: str = ""
    text: str = "name: two\n"
    bases: tuple[str, ...] = (BASE,)
    axes: tuple[Any, ...] = ()
    metrics: Any = ()
    strategy: Any = PLAN
    keep_logs: str = "none"
    limit_s: float | None = None

    def points(self) -> list[Point]:
        return [Point(values={"bound": bound}, labels={"bound": str(bound)}) for bound in (1.0, 0.001)]

    def plan(self, number: int, point: Point) -> RunPlan:
        words = ("duration_s=1", "faults=[]", f"expect=[{EXPECT}{point.values['bound']}}}]")
        return RunPlan(number=number, point=point, base=BASE, overrides=words, seed=5)


def fly(out: Path, keep_logs: str, clock: str = "inprocess", bus: str | None = None) -> list[RunResult]:
    options = Options(jobs=1, keep_logs=keep_logs, clock=clock, bus=bus)
    fly_campaign(TwoRuns(), make_job("two", [BASE], clock=clock, bus=bus), out, options, Silence())
    return read_results(out)


def test_lockstep_over_a_hub_gives_the_same_results(tmp_path: Path) -> None:
    """Three processes over the embedded bus: the results, and the digest of the kept log, are those of one process."""
    alone = fly(tmp_path / "alone", "failures")
    assert [result.outcome for result in alone] == ["pass", "fail"]
    assert fly(tmp_path / "hub", "failures", "lockstep", "hub:") == alone
    assert [path.name for path in (tmp_path / "hub/logs").iterdir()] == ["000001.mcap"]
    assert read_run(tmp_path / "hub/logs/000001.mcap").metadata["run"]["clock"] == "lockstep"


def test_a_bus_that_is_not_there_is_infra(tmp_path: Path) -> None:
    """A run whose bus cannot be opened is INFRA with the bus' own words, and the next one is tried all the same."""
    results = fly(tmp_path / "out", "none", "lockstep", "socketcan:nosuch0")
    assert [result.outcome for result in results] == ["infra", "infra"]
    assert "nosuch0" in results[0].reason


@pytest.mark.vcan
@pytest.mark.usefixtures("vcan")
def test_real_vcan_gives_the_same_results(tmp_path: Path) -> None:
    """The same over AF_CAN sockets of the kernel."""
    assert fly(tmp_path / "vcan", "all", "lockstep", "socketcan:vcan0") == fly(tmp_path / "alone", "all")
