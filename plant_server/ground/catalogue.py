"""Which kinds of fault can act on a plant, and what each takes, for whoever asks the running plant."""

from __future__ import annotations

import difflib
from typing import Any, Literal, get_args, get_origin

from bus.settings import NOTHING, all_notes, branches_of, find_unit, limits_of, plain, strip_annotations
from bus.units import Ge, Gt, Le, Lt
from plant_server.config import PlantConfig
from plant_server.faults import FAMILIES, KINDS, UNITS, family_of
from plant_server.faults.effects import Effect
from plant_server.faults.fault import magnitudes_of


def list_kinds(plant: PlantConfig | None, unit: object = None) -> list[dict[str, Any]] | str:
    """Return the kinds that can act on a unit or a family (None: on any) of this plant (None: of some), or why it is none.

    Each with `unit` (the family where it can act on all of its units), `units`, `kind`, `text` and `keys`.
    """
    if unit is not None and unit not in UNITS and unit not in FAMILIES:
        known = tuple(dict.fromkeys((*UNITS, *FAMILIES)))
        near = difflib.get_close_matches(str(unit)[:80], known, 1)
        hint = f"did you mean {near[0]}? " if near else ""
        return f"unit: {str(unit)[:80]!r} is not a unit; {hint}there are: {', '.join(known)}"
    found = []
    for family, kinds in KINDS.items():
        units = [name for name in UNITS if family_of(name) == family and unit in (None, family, name)]
        for cls in kinds.values():
            able = [name for name in units if can_act(cls, plant, name)]
            if able:
                every = unit != able[0] and len(able) == len(units)
                found.append(_describe(cls, family if every else ", ".join(able), able))
    return found


def can_act(cls: type[Effect], plant: PlantConfig | None, unit: str) -> bool:
    """Return whether a kind with ordinary magnitudes can have an effect on a unit of this plant."""
    return make_sample(cls).explain_futile(plant, unit) is None


def make_sample(cls: type[Effect]) -> Effect:
    """Return a kind with its defaults, and something in the midst of its range for what has none."""
    given = {key: _choose(kind) for key, (kind, default) in magnitudes_of(cls).items() if default is NOTHING}
    return cls(**given)


def _choose(kind: Any) -> Any:
    """Return something in the midst of what a key can be."""
    base = strip_annotations(branches_of(strip_annotations(kind)[0])[0])[0]
    notes = all_notes(kind)
    if get_origin(base) is Literal:
        return get_args(base)[0]
    if base is str:
        return ""
    low: list[Any] = [note.gt if isinstance(note, Gt) else note.ge for note in notes if isinstance(note, Gt | Ge)]
    high: list[Any] = [note.lt if isinstance(note, Lt) else note.le for note in notes if isinstance(note, Lt | Le)]
    if base is int:
        return int(low[0]) + 1 if low else 1
    if low and high:
        return 0.5 * (low[0] + high[0])
    return low[0] + 0.5 if low else high[0] - 0.5 if high else 0.5


def _describe(cls: type[Effect], unit: str, units: list[str]) -> dict[str, Any]:
    keys = []
    for name, (kind, default) in magnitudes_of(cls).items():
        item = {"name": name, "unit": find_unit(kind) or "1", "limits": limits_of(all_notes(kind))}
        needed = default is NOTHING
        keys.append({**item, "default": None if needed else plain(default), "needed": needed})
    text = " ".join((cls.__doc__ or "").split("\n\n")[0].split())
    return {"unit": unit, "units": units, "kind": cls.kind, "text": text, "keys": keys}
