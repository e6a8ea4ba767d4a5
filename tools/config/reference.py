"""The reference of scenario keys in docs/scenarios.md, made from the settings classes and their comments."""

from __future__ import annotations

import dataclasses
import json
import typing
from pathlib import Path
from typing import Any, Literal

from bus.settings import NOTHING, branches_of, fields_of, find_unit, limits_of, plain, strip_annotations
from plant_server.faults import PROFILES, UNITS, Fault
from plant_server.faults.fault import FaultKeys, magnitudes_of
from tools.config.comments import comments_of, summary_of
from tools.config.expect import SIGNAL_FUNCTIONS
from tools.config.fault_reference import format_kinds
from tools.config.scenario import Scenario

ROOT = Path(__file__).resolve().parents[2]
REFERENCE_FILE = ROOT / "docs" / "scenarios.md"
BEGIN, END = "<!-- reference: begin, generated -->\n", "<!-- reference: end -->\n"


def update_reference(text: str) -> str:
    """The page with the part between its markers made anew."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return before + BEGIN + format_reference() + END + after


def format_reference() -> str:
    """One table for each mapping of a scenario file, from the top down, then the functions of signals."""
    sections = [_format_class(path, cls) for path, cls in walk_classes(Scenario, "")]
    rows = "".join(f"| `{name}(x)` | {meaning} |\n" for name, meaning in SIGNAL_FUNCTIONS.items())
    functions = f"\n### Functions in signals\n\n| function | gives |\n|---|---|\n{rows}\n"
    return "\n" + "\n".join(sections) + "\n" + format_catalogue() + functions


def format_catalogue() -> str:
    """Profiles and kinds of fault: the keys that a fault has beside those of every fault."""
    profiles = "".join(
        f"| `{name}` | {', '.join(f'`{key}`' for key in magnitudes_of(cls))} | {summary_of(cls)} |\n"
        for name, cls in PROFILES.items()
    )
    return (
        "### Profiles of faults\n\n`profile` may be left out: it is the first of these that takes all the keys given; "
        "without any it is `step`, or what is usual for the kind.\n\n"
        f"| `profile` | keys | how the fault comes on |\n|---|---|---|\n{profiles}\n"
        f"### Kinds of fault\n\nUnits: {', '.join(f'`{unit}`' for unit in UNITS)}.\n\n{format_kinds()}"
    )


def walk_classes(cls: type, path: str) -> list[tuple[str, type]]:
    """Every settings class under one, depth first, with the key path that leads to it."""
    if cls is Fault:  # its other keys are those of its profile and its kind, see `format_catalogue`
        return [(path, FaultKeys)]
    found: list[tuple[str, type]] = [(path, cls)]
    for name, (kind, _) in fields_of(cls).items():
        for suffix, member in _classes_in(kind):
            found += walk_classes(member, f"{path}.{name}{suffix}".removeprefix("."))
    return found


def _classes_in(kind: Any) -> list[tuple[str, type]]:
    kind, _ = strip_annotations(kind)
    if typing.get_origin(kind) is tuple:
        return [("[]", member) for member in dict.fromkeys(m for a in typing.get_args(kind) for _, m in _classes_in(a))]
    members = branches_of(kind)
    if len(members) > 1 or members[0] is not kind:
        return [found for member in members for found in _classes_in(member)]
    return [("", kind)] if dataclasses.is_dataclass(kind) and isinstance(kind, type) else []


def _format_class(path: str, cls: type) -> str:
    tag = next((f", `{n}: {typing.get_args(k)[0]}`" for n, (k, _) in fields_of(cls).items() if _is_tag(k)), "")
    comments = comments_of(cls)
    lines = [f"### {f'`{path}`' if path else 'Top level'}{tag}", "", summary_of(cls), ""]
    lines += ["| key | value | unit | default | |", "|---|---|---|---|---|"]
    for name, (kind, default) in fields_of(cls).items():
        if _is_tag(kind):
            continue
        cells = (f"`{name}`", say_type(kind), find_unit(kind), _say_default(default), comments.get(name, ""))
        lines.append("| " + " | ".join(_escape(cell) for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def _escape(cell: str) -> str:
    return cell.replace("|", "\\|").replace("<", "&lt;") if "`" not in cell else cell.replace("|", "\\|")


def _is_tag(kind: Any) -> bool:
    return typing.get_origin(kind) is Literal and len(typing.get_args(kind)) == 1


def say_type(kind: Any) -> str:
    """A type in a reader's words: `number > 0`, `3 numbers`, `one of x, y`."""
    kind, notes = strip_annotations(kind)
    members = branches_of(kind)
    if len(members) > 1 or members[0] is not kind:
        return "one of the mappings below" if len(members) > 1 else say_type(members[0])
    if dataclasses.is_dataclass(kind):
        return "mapping"
    if typing.get_origin(kind) is Literal:
        words = [word if isinstance(word, str) else json.dumps(word) for word in typing.get_args(kind)]
        return "one of " + ", ".join(f"`{word}`" for word in words)
    if typing.get_origin(kind) is tuple:
        return _say_list(typing.get_args(kind))
    word = {str: "text", float: "number", int: "whole number", bool: "`true` or `false`"}[kind]
    return " ".join(part for part in (word, limits_of(notes)) if part)


def _say_list(kinds: tuple[Any, ...]) -> str:
    if kinds[-1] is Ellipsis:
        return "list of mappings"
    inner, _ = strip_annotations(kinds[0])
    if typing.get_origin(inner) is tuple:
        return f"{len(kinds)} x {len(typing.get_args(inner))} numbers"
    return f"{len(kinds)} {'mappings' if dataclasses.is_dataclass(inner) else 'numbers'}"


def _say_default(default: Any) -> str:
    if default is NOTHING:
        return "required"
    if default is None:
        return "none"
    if dataclasses.is_dataclass(default):
        tag = getattr(default, "kind", None)
        return f"`kind: {tag}`" if tag else "see below"
    return f"`{json.dumps(plain(default))}`" if default not in ("", ()) else "empty"
