"""From a campaign to its flight: directory, what is noted of it, and who flies."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Protocol

from bus.errors import UsageError
from tools.campaign.chosen_logs import check_keeping
from tools.campaign.crew import Crew, Halt, catch_signals
from tools.campaign.engine import Conclusion, Engine, Planner
from tools.campaign.job import IN_PROCESS, Job, Metric
from tools.campaign.keeping import Store, begin, read_bases
from tools.campaign.plan import Point, Strategy
from tools.campaign.pool import Pool, Solo
from tools.campaign.progress import Progress
from tools.campaign.results import AxisInfo, CampaignInfo, read_info
from tools.campaign.strategies import make_strategy
from tools.run.provenance import describe_program

NAMED: Final = ("host", "platform", "python", "versions", "git_rev", "build")
MOST_JOBS: Final = 512
LONGEST_NAME: Final = 128  # bytes


class Campaign(Planner, Protocol):
    """What is asked of a campaign; tools.campaign.definition reads one from its file."""

    name: str
    title: str
    seed: int
    text: str
    bases: tuple[str, ...]
    axes: tuple[AxisInfo, ...]
    keep_logs: str
    limit_s: float | None
    strategy: Any  # settings, see tools/campaign/strategies

    def points(self) -> list[Point]:
        """All points of the plan."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """How a campaign is flown, beside what its file says."""

    jobs: int = 1
    keep_logs: str = "none"
    limit_s: float | None = None
    clock: str = IN_PROCESS
    bus: str | None = None
    dask: str | None = None  # address of a scheduler, or local
    retry: bool = False  # fly again what could not be flown or judged
    noted: Mapping[str, str] = field(default_factory=dict)  # more for the provenance


def describe_campaign(campaign: Campaign, metrics: Mapping[str, Metric], options: Options) -> CampaignInfo:
    """What is noted of a campaign before its first run."""
    program = describe_program()
    return CampaignInfo(
        name=campaign.name, title=campaign.title, seed=campaign.seed, file=campaign.text, bases=campaign.bases,
        axes=campaign.axes, runs=campaign.runs, strategy=campaign.strategy.kind,
        metrics={name: metric.unit for name, metric in metrics.items()},
        provenance={
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            **{key: program[key] for key in NAMED},
            "keep_logs": options.keep_logs,
            "clock": options.clock,
            "bus": options.bus or "",
            **options.noted,
        },
    )  # fmt: skip


def check_same(directory: Path, info: CampaignInfo, bases: Mapping[str, str]) -> None:
    """Raise UsageError unless the campaign that was begun in the directory is this one, naming what differs."""
    there, there_bases = read_info(directory), read_bases(directory)
    differing = [name for name in ("name", "seed", "strategy") if getattr(there, name) != getattr(info, name)]
    differing += ["the text of its file"] if there.file != info.file else []
    differing += [
        f"the text of {base}"
        for base in dict.fromkeys((*there_bases, *bases))
        if there_bases.get(base) != bases.get(base)
    ]
    for key in ("overrides", "clock", "bus", "versions", "git_rev"):
        before, now = there.provenance.get(key, ""), info.provenance.get(key, "")
        if before != now:
            differing.append(
                f"{key.replace('git_rev', 'revision of hilsat')} (was {before or 'none'}, is {now or 'none'})"
            )
    if differing:
        raise UsageError(
            f"{directory}: the campaign that was begun there is not this one, for these differ: {', '.join(differing)}; "
            "begin anew in another directory"
        )


def make_directory(wanted: Path | None, name: str) -> Path:
    """The directory of a new campaign: as wanted, else runs/NAME-TIME, not yet made."""
    if wanted is not None:
        return wanted
    if "/" in name or "\0" in name or len(os.fsencode(name)) > LONGEST_NAME:
        raise UsageError(f"the campaign's name {name[:40]!r} cannot name a directory; use --out")
    base = Path("runs") / f"{name}-{datetime.now(UTC):%Y%m%d-%H%M%S}"
    found, count = base, 1
    while os.path.lexists(found):
        count += 1
        found = base.with_name(f"{base.name}-{count}")
    return found


def fly_campaign(
    campaign: Campaign,
    job: Job,
    directory: Path,
    options: Options,
    progress: Progress,
    strategy: Strategy | None = None,
    *,
    resume: bool = False,
) -> Conclusion:
    """Fly a campaign into its directory, or go on with it; return how it ended.

    strategy : which points; None: what the campaign asks for
    resume   : the directory has the campaign already
    Raises UsageError for a directory that is taken, or for another campaign; RecordError when results cannot be written.
    """
    check_options(options)
    info = describe_campaign(campaign, job.metrics, options)
    with catch_signals() as halt, make_crew(job, directory, options, halt) as crew:
        if resume:
            check_same(directory, info, job.bases)
        else:
            begin(directory, info, job.bases)
        with Store.open(directory) as store:
            if options.retry:
                store.forget({number for number, result in store.results.items() if result.outcome == "infra"})
            engine = Engine(campaign, job, store, crew, halt, progress, options.keep_logs)
            return engine.run(strategy or make_strategy(campaign))


def check_options(options: Options) -> None:
    """Raise UsageError for options that cannot be."""
    if not 1 <= options.jobs <= MOST_JOBS:
        raise UsageError(f"-j {options.jobs}: give 1 to {MOST_JOBS} runs at a time")
    if options.limit_s is not None and not options.limit_s > 0.0:
        raise UsageError(f"--limit {options.limit_s:g}: give more than 0 s")
    check_keeping(options.keep_logs)
    if options.clock == IN_PROCESS and options.bus is not None:
        raise UsageError("--bus: in process no frame leaves the process; name a clock too, such as --clock lockstep")
    if options.dask is not None and options.clock != IN_PROCESS:
        raise UsageError("--dask: a cluster flies in process; leave --clock and --bus out")


@contextlib.contextmanager
def make_crew(job: Job, directory: Path, options: Options, halt: Halt) -> Iterator[Crew]:
    """Yield who flies; they are let go at the end."""
    crew: Crew
    directory = directory.absolute()
    if options.dask is not None:
        from tools.campaign.dask_crew import DaskCrew

        crew = DaskCrew(job, directory, options.dask, options.jobs, options.limit_s, halt)
    elif job.clock != IN_PROCESS:
        crew = Solo(job, directory, halt)
    else:
        crew = Pool(job, directory, options.jobs, options.limit_s, halt)
    try:
        yield crew
    finally:
        crew.close()


def read_overrides(info: CampaignInfo) -> Sequence[str]:
    """The key=value words that a campaign was begun with."""
    words: Any = json.loads(info.provenance.get("overrides", "[]"))
    return [str(word) for word in words]
