"""A scenario file to a `Resolved`: read, merged with what it extends, overridden, checked; problems at their place."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bus.errors import ConfigError
from bus.settings import Problem, Reading, join_key
from tools.config.findings import Finding, Source
from tools.config.merge import Merger, apply_overrides
from tools.config.rehearsal import rehearse
from tools.config.requirements import expand_requirements
from tools.config.scenario import Resolved, Scenario
from tools.config.semantics import check_semantics
from tools.config.yaml_nodes import Node

MOST_FINDINGS = 100


@dataclass(frozen=True, slots=True)
class Examination:
    """What came of a scenario file: `resolved` when nothing is wrong, else `findings`, the first MOST_FINDINGS of them."""

    path: str
    resolved: Resolved | None
    findings: tuple[Finding, ...]
    unlisted: int = 0  # findings beyond those


def load_scenario(path: str | Path, overrides: Sequence[str] = ()) -> Resolved:
    """The scenario of a file, with `key.path=value` overrides applied.

    Raises ConfigError with every problem found, each as `file:line:col: key.path: message` and the line with a caret.
    """
    return _unwrap(examine(path, overrides))


def load_text(text: str, name: str, overrides: Sequence[str] = (), *, files: bool = True) -> Resolved:
    """The scenario of a text. `name` stands for its file. Raises ConfigError.

    files : False for a text that came out of a log: nothing on the disk is read, and nothing is built from it, for what
            was flown then need not be what would be built now
    """
    return _unwrap(examine_text(text, name, overrides, files=files))


def examine(path: str | Path, overrides: Sequence[str] = ()) -> Examination:
    """What came of a scenario file. Does not raise for anything that a file can contain."""
    merger = Merger()
    return _examine(os.fspath(path), merger, merger.read_file(path), overrides)


def examine_text(text: str, name: str, overrides: Sequence[str] = (), *, files: bool = True) -> Examination:
    """What came of a scenario text. Does not raise for anything that a text can contain. `files`: see `load_text`."""
    merger = Merger(files=files)
    return _examine(name, merger, merger.read_text(Source(name, text)), overrides, build=files)


def _unwrap(examination: Examination) -> Resolved:
    if examination.resolved is None:
        words = [str(finding) for finding in examination.findings]
        more = [f"and {examination.unlisted} more problems"] if examination.unlisted else []
        raise ConfigError(*words, *more)
    return examination.resolved


def _examine(
    name: str, merger: Merger, root: Node | None, overrides: Sequence[str], *, build: bool = True
) -> Examination:
    if root is None:
        return _refuse(name, merger, merger.findings)
    root = apply_overrides(merger, root, overrides)
    expand_requirements(merger, root)
    reading = Reading(Scenario, root.plain())
    problems = [*reading.problems, *check_semantics(reading, opens=build)]
    if build and not problems and not merger.findings:
        problems += rehearse(reading.value)
    told = {finding.key for finding in merger.findings}
    findings = [_place(root, problem) for problem in problems if join_key(problem.path) not in told]
    if findings or merger.findings:
        return _refuse(name, merger, [*merger.findings, *findings])
    return Examination(name, Resolved(reading.value, Path(name), tuple(merger.sources)), ())


def _refuse(name: str, merger: Merger, findings: list[Finding]) -> Examination:
    """The findings in the order of the sources and of their lines, as many as anybody reads."""
    order = {source.name: index for index, source in enumerate(merger.sources)}
    ranked = sorted(findings, key=lambda f: (order.get(f.place.source.name, 0), f.place.line, f.place.column))
    return Examination(name, None, tuple(ranked[:MOST_FINDINGS]), max(0, len(ranked) - MOST_FINDINGS))


def _place(root: Node, problem: Problem) -> Finding:
    return Finding(root.locate(problem.path, at_key=problem.at_key), join_key(problem.path), problem.message)
