"""Requirement files: expectations that several scenarios share, each with an id.

    requirements:
      - id: ADCS-012
        name: settles to 1 deg
        text: After a wheel fault the pointing error shall return within 1 degree in 90 s.
        severity: high
        applies_to: [zhang2018*]          # names of scenarios, * for any letters; left out: all
        check: settles
        signal: truth.attitude.error_deg
        bound: 1
        by_s: 90

A scenario takes the files in by name, `requirements: [pointing]`: from a folder `requirements` beside it, or from those that
ship with hilsat. What is taken in stands among its expectations from then on, in the log too.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Final

from bus.errors import ConfigError
from bus.settings import Reading, join_key
from bus.words import describe, nearest
from tools.config.expect import Expectation
from tools.config.expect_checks import check_expectation
from tools.config.findings import Finding, Place, Source
from tools.config.merge import Merger, read_text_file
from tools.config.scenario_files import SHIPPED
from tools.config.yaml_nodes import Node, read_yaml

KEY: Final = "requirements"
MOST: Final = 500  # requirements of a file


@dataclass(frozen=True, slots=True, kw_only=True)
class _Wanted:
    """What a file comes to, for reading it with the settings of a scenario."""

    expect: tuple[Expectation, ...]


def load_requirements(path: Path, scenario: str, duration_s: float) -> tuple[Expectation, ...]:
    """The requirements of a file that apply to a scenario of this name and length.

    Raises ConfigError with everything that is wrong in it, each with line and column.
    """
    merger = Merger()
    nodes = _read_file(merger, os.fspath(path), None, scenario)
    root = Node({"expect": Node(nodes, Place(Source(os.fspath(path), "")))}, Place(Source(os.fspath(path), "")))
    reading = Reading(_Wanted, root.plain())
    found = [Finding(root.locate(p.path, at_key=p.at_key), join_key(p.path[2:]), p.message) for p in reading.problems]
    if not found and not merger.findings:
        for index, item in enumerate(reading.value.expect):
            values = {key: getattr(item, key) for key in item.__dataclass_fields__}
            for key, word in check_expectation(values, duration_s):
                found.append(Finding(root.locate(("expect", index, key)), key, word))
    if found or merger.findings:
        raise ConfigError(*(str(finding) for finding in (*merger.findings, *found)))
    wanted: _Wanted = reading.value
    return wanted.expect


def expand_requirements(merger: Merger, root: Node) -> None:
    """Put the requirements that a scenario takes in by name among its expectations; what is wrong goes to the merger."""
    wanted = root.value.pop(KEY, None)
    if wanted is None or wanted.value is None:
        return
    if not isinstance(wanted.value, list) or not all(isinstance(item.value, str) for item in wanted.value):
        merger.add(wanted.place, KEY, "takes a list of names of requirement files, such as [pointing]")
        return
    if not merger.files:
        merger.add(wanted.place, KEY, "is not read here: a log carries its requirements among its expectations")
        return
    name = root.value["name"].value if "name" in root.value else ""
    taken = [
        node for item in wanted.value if (path := _find_file(merger, item)) is not None
        for node in _read_file(merger, path, item.place, str(name))
    ]  # fmt: skip
    expect = root.value.get("expect")
    if expect is None:
        root.value["expect"] = Node(taken, wanted.place, wanted.key_place)
    elif isinstance(expect.value, list):
        expect.value += taken


def _find_file(merger: Merger, item: Node) -> str | None:
    """Path of a requirement file: in `requirements` beside the file that names it, else one that ships with hilsat."""
    name = str(item.value)
    stem = name.removesuffix(".yaml")
    if not stem or "/" in stem or "\0" in stem:
        merger.add(item.place, KEY, f"{describe(name)} is not the name of a requirement file, without a folder")
        return None
    folders = [os.path.join(os.path.dirname(item.place.source.name), KEY), os.fspath(SHIPPED / KEY)]
    for folder in folders:
        path = os.path.normpath(os.path.join(folder, f"{stem}.yaml"))
        if os.path.isfile(path):
            return path
    known = sorted({path.stem for folder in folders for path in Path(folder).glob("*.yaml")})
    near = nearest(stem, known)
    hint = f"did you mean {near}? " if near else ""
    merger.add(
        item.place, KEY, f"there is no requirement file {stem}.yaml; {hint}there are: {', '.join(known) or 'none'}"
    )
    return None


def _read_file(merger: Merger, path: str, wanted_at: Place | None, scenario: str) -> list[Node]:
    """The requirements of a file that apply to a scenario, as nodes of expectations."""
    text, complaint = read_text_file(path)
    if text is None:
        merger.add(wanted_at or Place(Source(path, "")), KEY, f"{path}: {complaint}")
        return []
    source = Source(path, text)
    merger.sources.append(source)
    root, findings = read_yaml(source)
    merger.findings += findings
    if findings:
        return []
    listed = root.value.get(KEY) if root is not None and isinstance(root.value, dict) else None
    if root is None or listed is None or not isinstance(listed.value, list) or len(root.value) > 1:
        place = root.place if root is not None else Place(source, 1, 1)
        merger.add(place, "", f"a requirement file has one key, {KEY}, with a list of requirements")
        return []
    if not listed.value:
        merger.add(listed.place, KEY, "the list is empty: nothing would be required")
        return []
    if len(listed.value) > MOST:
        merger.add(listed.place, KEY, f"{len(listed.value)} requirements; a file takes at most {MOST}")
        return []
    return list(_choose(merger, listed.value, scenario))


def _choose(merger: Merger, items: list[Node], scenario: str) -> Iterator[Node]:
    """Those that apply, each without the key that says so; ids are there, and each once."""
    first: dict[str, Node] = {}
    for index, item in enumerate(items):
        at = f"{KEY}[{index}]"
        if not isinstance(item.value, dict):
            merger.add(item.place, at, "is no requirement: a mapping with id, name, check, signal and so on")
            continue
        own = item.value.get("id")
        if own is None or not isinstance(own.value, str):
            merger.add(item.place, at, "needs an id, such as ADCS-012")
        elif first.setdefault(own.value, item) is not item:
            line = first[own.value].place.line
            merger.add(own.place, f"{at}.id", f"{describe(own.value)} is the id of the requirement in line {line} too")
        applies = item.value.pop("applies_to", None)
        patterns = ["*"] if applies is None else _read_patterns(merger, applies, f"{at}.applies_to")
        if any(fnmatchcase(scenario, pattern) for pattern in patterns):
            yield item


def _read_patterns(merger: Merger, node: Node, key: str) -> list[str]:
    if not isinstance(node.value, list) or not all(isinstance(item.value, str) for item in node.value):
        merger.add(node.place, key, "takes a list of names of scenarios, * for any letters, such as [zhang2018*]")
        return []
    return [item.value for item in node.value]
