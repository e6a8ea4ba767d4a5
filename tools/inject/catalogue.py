"""What can be injected, from the register of kinds: units, kinds, keys with unit, limits and default."""

from __future__ import annotations

from typing import Any

from bus.errors import UsageError
from bus.settings import NOTHING, find_unit, limits_of, plain, strip_annotations
from bus.words import describe, suggest
from plant_server.faults import KINDS, UNITS, family_of
from plant_server.faults.fault import magnitudes_of
from tools.config.comments import summary_of

Kind = dict[str, Any]


def list_kinds(unit: str | None = None) -> list[Kind]:
    """Return every kind of fault of every unit, or of one. Raises UsageError for a unit that there is not."""
    if unit is not None and unit not in UNITS:
        raise UsageError(f"{describe(unit)} is no unit; {suggest(unit, UNITS)}there are: {', '.join(UNITS)}")
    return [
        {"unit": name, "kind": cls.kind, "text": summary_of(cls), "keys": _list_keys(cls)}
        for name in UNITS
        if unit in (None, name)
        for cls in KINDS[family_of(name)].values()
    ]


def _list_keys(cls: type) -> list[dict[str, Any]]:
    keys = []
    for name, (kind, default) in magnitudes_of(cls).items():
        key = {"name": name, "unit": find_unit(kind), "limits": limits_of(strip_annotations(kind)[1])}
        keys.append(key if default is NOTHING else key | {"default": plain(default)})
    return keys


def format_kinds(kinds: list[Kind]) -> str:
    """Return a catalogue for people: each kind once, the units that have it ahead of it."""
    alike: dict[str, list[Kind]] = {}
    for kind in kinds:
        family = str(kind["unit"]).partition(".")[0]
        alike.setdefault(f"{family}/{kind['kind']}/{kind['keys']}", []).append(kind)
    lines: list[str] = []
    last = ""
    for group in alike.values():
        units = " ".join(str(kind["unit"]) for kind in group)
        if units != last:
            lines += ([""] if lines else []) + [units]
            last = units
        lines.append(f"  {group[0]['kind']:<20} {group[0]['text']}")
        lines += [f"      {_format_key(key)}" for key in group[0]["keys"]]
    return "\n".join(lines)


def _format_key(key: dict[str, Any]) -> str:
    words = [f"[{key['unit']}]" if key.get("unit") else "", str(key.get("limits") or "")]
    if not key.get("needed", "default" not in key):
        words.append("may be left out" if key.get("default") is None else f"default {key['default']}")
    return f"{key['name']}=  {'  '.join(word for word in words if word)}".rstrip()
