"""One run of a campaign by itself, to the bit: `FILE.yaml#1234`, `NAME#1234`, or `DIRECTORY#1234` of its results."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from bus.errors import UsageError
from tools.campaign.definition import find_campaign, load_campaign
from tools.campaign.inspection import find_requirements
from tools.campaign.job import make_job
from tools.campaign.keeping import read_bases
from tools.campaign.results import INFO_FILE, read_info, read_results
from tools.campaign.trial import describe_run
from tools.config.findings import Source
from tools.config.loader import load_text
from tools.config.requirements import load_requirements
from tools.config.scenario import Resolved
from tools.config.yaml_nodes import read_yaml

_WORD: Final = re.compile(r"(.+)#([0-9]{1,9})", re.DOTALL)


@dataclass(frozen=True, slots=True)
class OneRun:
    """The scenario of one run, and what it is in words."""

    resolved: Resolved
    words: str


def split_word(word: str) -> tuple[str, int] | None:
    """File or directory and number of `FILE#NUMBER`; None where a word is no such thing."""
    match = _WORD.fullmatch(word)
    return (match[1], int(match[2])) if match and not Path(word).exists() else None


def load_one(name: str, number: int, overrides: Sequence[str] = ()) -> OneRun:
    """The scenario of a run. `overrides` come on top: with any that changes what is flown it is no more the same run.

    Raises UsageError for a number that is not of the campaign, ConfigError, RecordError.
    """
    if Path(name).is_dir():
        return _load_flown(Path(name), number, overrides)
    path = find_campaign(name)
    campaign = load_campaign(path)
    if campaign.runs is None:
        raise UsageError(
            f"{name}#{number}: which runs there are is decided by the strategy {campaign.strategy.kind}, from what came of "
            "those before; name the directory of its results: DIRECTORY#NUMBER"
        )
    if number >= campaign.runs:
        raise UsageError(f"{name}#{number}: the campaign has runs 0 to {campaign.runs - 1}")
    plan = campaign.plan(number, campaign.points()[number])
    job = make_job(campaign.name, [plan.base], folder=path.parent)
    resolved = _resolve(job.bases[plan.base], plan.base, plan.overrides, plan.seed, overrides)
    words = f"{campaign.name}, {describe_run(number, plan.point)}"
    return OneRun(_require(resolved, campaign.requirements), words)


def _load_flown(directory: Path, number: int, overrides: Sequence[str]) -> OneRun:
    """The run as it was flown: from what the directory has, with the base scenarios as they were then."""
    if not (directory / INFO_FILE).is_file():
        raise UsageError(f"{directory}#{number}: {directory} is not the directory of a campaign: no {INFO_FILE} in it")
    info, results = read_info(directory), {result.number: result for result in read_results(directory)}
    result = results.get(number)
    if result is None:
        there = f"{min(results)} to {max(results)}" if results else "none"
        raise UsageError(f"{directory}#{number}: there is no result of that run; there are: {there}")
    bases = read_bases(directory)
    if result.base not in bases:
        raise UsageError(f"{directory}#{number}: its base scenario {result.base} is not among those that were kept")
    resolved = _resolve(bases[result.base], result.base, result.overrides, result.seed, overrides)
    labels = ", ".join(f"{axis} {label}" for axis, label in result.labels.items())
    files = _list_requirements(info.file, Path(info.provenance.get("path", "campaign.yaml")))
    return OneRun(_require(resolved, files), f"{info.name}, run {number}: {labels}")


def _resolve(text: str, base: str, own: Sequence[str], seed: int, overrides: Sequence[str]) -> Resolved:
    words = list(own)
    if not any(word.partition("=")[0].strip() == "seed" for word in words):
        words.append(f"seed={seed}")
    return load_text(text, base, [*words, *overrides])


def _list_requirements(text: str, path: Path) -> tuple[Path, ...]:
    """Requirement files that the text of a campaign's file names."""
    node, _ = read_yaml(Source(str(path), text))
    listed = node.plain().get("requirements") if node is not None and isinstance(node.value, dict) else None
    return tuple(find_requirements(path.parent, str(name)) for name in listed or ())


def _require(resolved: Resolved, files: Sequence[Path]) -> Resolved:
    """The scenario, judged by these files too."""
    scenario = resolved.scenario
    more = [item for path in files for item in load_requirements(path, scenario.name, scenario.duration_s)]
    return replace(resolved, scenario=replace(scenario, expect=(*scenario.expect, *more))) if more else resolved
