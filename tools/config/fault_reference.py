"""What scenario files and pages say of faults, made from the register of kinds: JSON schema, keys, table of kinds."""

from __future__ import annotations

from typing import Any

from bus.settings import NOTHING, limits_of, strip_annotations
from plant_server.faults import FAMILIES, KINDS, UNITS, family_of
from plant_server.faults.effects import Effect
from plant_server.faults.fault import FaultKeys, keys_of_all, magnitudes_of, profiles_of
from tools.config.comments import comments_of, summary_of

PLANT_PAGE_BEGIN, PLANT_PAGE_END = "<!-- kinds of fault: begin, generated -->\n", "<!-- kinds of fault: end -->\n"
UNITS_OF = {family: tuple(unit for unit in UNITS if family_of(unit) == family) for family in FAMILIES}


def list_variants() -> list[tuple[str, type[Effect]]]:
    """Every kind with its family, in the order of families, then of registration."""
    return [(family, cls) for family, kinds in KINDS.items() for cls in kinds.values()]


def keys_of(cls: type[Effect]) -> list[tuple[type, str, Any, Any]]:
    """Class, key, type and default of everything that a fault of one kind takes beside unit and kind."""
    sources: list[type] = [*profiles_of(cls).values(), cls]
    found: list[tuple[type, str, Any, Any]] = [
        (FaultKeys, name, kind, default) for name, (kind, default) in keys_of_all(cls.family).items()
    ]
    found += [
        (source, name, kind, default) for source in sources for name, (kind, default) in magnitudes_of(source).items()
    ]
    return [item for item in found if item[1] not in ("unit", "kind")]


def format_kinds() -> str:
    """Table of every kind of fault: where it can be, what it does, which magnitudes it takes."""
    lines = ["| unit | kind | needs | may have | what happens |", "|---|---|---|---|---|"]
    for family, cls in list_variants():
        source: type = cls
        comments = comments_of(source)
        needs, may = [], []
        for name, (kind, default) in magnitudes_of(cls).items():
            limits = limits_of(strip_annotations(kind)[1])
            if default is NOTHING:
                needs.append(f"`{name}`" + (f" {limits}" if limits else ""))
            else:
                usual = "" if default is None else default if isinstance(default, str) else f"{default:.6g}"
                said = "; ".join(word for word in (usual, limits, comments[name]) if word)
                may.append(f"`{name}` ({said})" if said else f"`{name}`")
        meaning = summary_of(cls) + ("" if cls.rises else " (no slope)" if cls.switches else " (no rise)")
        lines.append(f"| {family} | `{cls.kind}` | {', '.join(needs)} | {', '.join(may)} | {meaning} |")
    return "\n".join(line.replace("<", "&lt;") for line in lines) + "\n"


def update_plant_page(text: str) -> str:
    """docs/plant.md with the table between its markers made anew."""
    before, _, rest = text.partition(PLANT_PAGE_BEGIN)
    _, _, after = rest.partition(PLANT_PAGE_END)
    return before + PLANT_PAGE_BEGIN + format_kinds() + PLANT_PAGE_END + after
