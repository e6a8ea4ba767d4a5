"""What all runs of a campaign share, complete in itself: whoever has it and a plan can fly that run, on any machine."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Final

from bus.errors import ConfigError, UsageError
from tools.campaign.plan import RunPlan
from tools.config.expect import Expectation
from tools.config.loader import load_text
from tools.config.merge import Merger
from tools.config.requirements import expand_requirements, load_requirements
from tools.config.scenario import Resolved
from tools.config.scenario_files import find_scenario
from tools.config.yaml_nodes import write_yaml

IN_PROCESS: Final = "inprocess"


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """A number that is taken of every run beside its verdicts."""

    statistic: str  # see tools/campaign/metrics.py
    signal: str  # expression over signals, as in expectations
    percent: float | None = None  # of a percentile
    from_s: float = 0.0  # first moment that counts [s]
    until_s: float | None = None  # last moment that counts [s]; None: the end of the run
    unit: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """Base scenarios as texts, what is required beside them, what is measured, and on which clock and bus it is flown."""

    name: str
    bases: Mapping[str, str]  # name or path of a base -> its text, with all that it extends and requires
    more: Mapping[str, tuple[Expectation, ...]] = field(default_factory=dict)  # base -> added requirements
    metrics: Mapping[str, Metric] = field(default_factory=dict)
    clock: str = IN_PROCESS
    bus: str | None = None

    def resolve(self, plan: RunPlan) -> Resolved:
        """The scenario of a run. Raises ConfigError when it is not sound, UsageError for a base that is not of the job.

        What can only be found by building both sides is left to whoever builds them for the flight.
        """
        text = self.bases.get(plan.base)
        if text is None:
            raise UsageError(f"run {plan.number}: the base {plan.base} is not one of this campaign")
        words = [*plan.overrides, f"clock.mode={self.clock}"]
        if self.bus is not None:
            words.append(f"bus.address={self.bus}")
        resolved = _load(text, plan.base, tuple(words))
        if any(word.partition("=")[0].strip() == "seed" for word in words):
            return resolved
        seeded = dataclasses.replace(resolved.scenario, seed=plan.seed)
        return Resolved(seeded, resolved.path, resolved.sources)


@lru_cache(maxsize=64)  # repeats differ in their seeds alone
def _load(text: str, name: str, words: tuple[str, ...]) -> Resolved:
    return load_text(text, name, words, files=False)


def make_job(
    name: str,
    bases: Sequence[str],
    *,
    folder: Path | None = None,
    requirements: Sequence[Path] = (),
    metrics: Mapping[str, Metric] | None = None,
    clock: str = IN_PROCESS,
    bus: str | None = None,
) -> Job:
    """The job of these base scenarios: all their files are read now, and none later.

    folder       : where relative paths of bases start; None: the working directory
    requirements : files whose requirements are added to those of the bases
    Raises ConfigError for a base that cannot be read, UsageError for one that there is not.
    """
    texts = {base: read_base(find_base(base, folder)) for base in bases}
    more = {}
    for base, text in texts.items():
        if requirements:
            scenario = load_text(text, base, files=False).scenario
            more[base] = tuple(
                item for path in requirements for item in load_requirements(path, scenario.name, scenario.duration_s)
            )
    return Job(name=name, bases=texts, more=more, metrics=metrics or {}, clock=clock, bus=bus)


def find_base(base: str, folder: Path | None = None) -> Path:
    """The file of a base: beside the campaign's file, else as `hilsat run` finds it."""
    if folder is not None and (folder / base).is_file():
        return folder / base
    return find_scenario(base)


@lru_cache(maxsize=64)
def read_base(path: Path) -> str:
    """A scenario file and all that it extends and requires as one text, before anything is overridden or defaulted.

    Raises ConfigError with what is wrong in it.
    """
    merger = Merger()
    root = merger.read_file(path)
    if root is not None:
        expand_requirements(merger, root)
    if root is None or merger.findings:
        raise ConfigError(*(str(finding) for finding in merger.findings))
    return write_yaml(root.plain())
