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
from tools.config.scenario import Resolved, Scenario
from tools.config.semantics import check_semantics
from tools.config.yaml_nodes import Node


@dataclass(frozen=True, slots=True)
class Examination:
    """What came of a scenario file: `resolved` when nothing is wrong, else `findings`."""

    path: str
    resolved: Resolved | None
    findings: tuple[Finding, ...]


def load_scenario(path: str | Path, overrides: Sequence[str] = ()) -> Resolved:
    """The scenario of a file, with `key.path=value` overrides applied.

    Raises ConfigError with every problem found, each as `file:line:col: key.path: message` and the line with a caret.
    """
    return _unwrap(examine(path, overrides))


def load_text(text: str, name: str, overrides: Sequence[str] = ()) -> Resolved:
    """The scenario of a text, such as the one attached to a log. `name` stands for its file. Raises ConfigError."""
    return _unwrap(examine_text(text, name, overrides))


def examine(path: str | Path, overrides: Sequence[str] = ()) -> Examination:
    """What came of a scenario file. Does not raise for anything that a file can contain."""
    merger = Merger()
    return _examine(os.fspath(path), merger, merger.read_file(path), overrides)


def examine_text(text: str, name: str, overrides: Sequence[str] = ()) -> Examination:
    """What came of a scenario text. Does not raise for anything that a text can contain."""
    merger = Merger()
    return _examine(name, merger, merger.read_text(Source(name, text)), overrides)


def _unwrap(examination: Examination) -> Resolved:
    if examination.resolved is None:
        raise ConfigError(*(str(finding) for finding in examination.findings))
    return examination.resolved


def _examine(name: str, merger: Merger, root: Node | None, overrides: Sequence[str]) -> Examination:
    if root is None:
        return Examination(name, None, tuple(merger.findings))
    root = apply_overrides(merger, root, overrides)
    reading = Reading(Scenario, root.plain())
    problems = [*reading.problems, *check_semantics(reading)]
    findings = list(merger.findings)
    told = {finding.key for finding in findings}
    findings += [_place(root, problem) for problem in problems if join_key(problem.path) not in told]
    order = {source.name: index for index, source in enumerate(merger.sources)}
    findings.sort(key=lambda f: (order.get(f.place.source.name, 0), f.place.line, f.place.column))
    if findings:
        return Examination(name, None, tuple(findings))
    return Examination(name, Resolved(reading.value, Path(name), tuple(merger.sources)), ())


def _place(root: Node, problem: Problem) -> Finding:
    return Finding(root.locate(problem.path, at_key=problem.at_key), join_key(problem.path), problem.message)
