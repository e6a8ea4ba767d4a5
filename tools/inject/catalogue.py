"""The catalogue of faults for people: units, kinds, keys with unit, limits and default."""

from __future__ import annotations

from typing import Any

Kind = dict[str, Any]


def format_kinds(kinds: list[Kind]) -> str:
    """Return a catalogue for people: the kinds below the units that they can be on."""
    lines: list[str] = []
    last = ""
    for kind in kinds:
        units = " ".join(kind.get("units") or [kind["unit"]])
        if units != last:
            lines += ([""] if lines else []) + [units]
            last = units
        lines.append(f"  {kind['kind']:<20} {kind['text']}")
        lines += [f"      {_format_key(key)}" for key in kind["keys"]]
    return "\n".join(lines)


def _format_key(key: dict[str, Any]) -> str:
    words = [f"[{key['unit']}]" if key.get("unit") not in (None, "", "1") else "", str(key.get("limits") or "")]
    if not key.get("needed", "default" not in key):
        words.append("may be left out" if key.get("default") is None else f"default {key['default']}")
    return f"{key['name']}=  {'  '.join(word for word in words if word)}".rstrip()
