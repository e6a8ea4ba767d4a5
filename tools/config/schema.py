"""JSON schema of scenario files, for editors: `python -P -m tools.config.schema` writes it and the reference of keys.

Nothing but the top level is required, so that a file which extends another is not called incomplete while it is typed;
`hilsat check` has the last word.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import types
import typing
from typing import Any, Literal, Union

from annotated_types import Ge, Gt, Le, Lt

from bus.settings import NOTHING, fields_of, find_unit, plain, strip_annotations
from plant_server.faults import Fault
from plant_server.faults.fault import profiles_of
from tools.config.comments import comments_of, summary_of
from tools.config.fault_reference import UNITS_OF, keys_of, list_variants, update_plant_page
from tools.config.reference import REFERENCE_FILE, ROOT, update_reference
from tools.config.scenario import Scenario

SCHEMA_FILE = ROOT / "scenarios" / "scenario.schema.json"
PLANT_PAGE = ROOT / "docs" / "plant.md"
LIMIT_WORDS = {Gt: "exclusiveMinimum", Ge: "minimum", Lt: "exclusiveMaximum", Le: "maximum"}
SCALARS = {str: "string", float: "number", int: "integer", bool: "boolean"}


def make_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a scenario file."""
    definitions: dict[str, Any] = {}
    top = _describe_class(Scenario, definitions)
    top["properties"]["requirements"] = {
        "type": "array",
        "items": {"type": "string"},
        "description": "requirement files taken in by name: requirements/NAME.yaml beside this file, or shipped with hilsat",
    }
    top["properties"]["extends"] = {
        "type": "string",
        "description": "scenario that this one changes, relative to this file: mappings merge, lists replace",
    }
    required = [name for name, (_, default) in fields_of(Scenario).items() if default is NOTHING]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "hilsat scenario",
        **top,
        "if": {"not": {"required": ["extends"]}},
        "then": {"required": required},
        "$defs": dict(sorted(definitions.items())),
    }


def format_schema() -> str:
    """The schema as the text of its file."""
    return json.dumps(make_schema(), indent=1, ensure_ascii=False) + "\n"


def _describe_class(cls: type, definitions: dict[str, Any]) -> dict[str, Any]:
    properties = {
        name: _describe_key(cls, name, kind, default, definitions) for name, (kind, default) in fields_of(cls).items()
    }
    return {
        "type": "object",
        "description": summary_of(cls),
        "properties": properties,
        "additionalProperties": False,
    }


def _describe_key(cls: type, name: str, kind: Any, default: Any, definitions: dict[str, Any]) -> dict[str, Any]:
    item = _describe(kind, definitions)
    words = [comments_of(cls).get(name, ""), f"[{unit}]" if (unit := find_unit(kind)) else ""]
    if text := " ".join(word for word in words if word):
        item = {**item, "description": text}
    if default is not NOTHING and default is not None and not dataclasses.is_dataclass(default):
        item = {**item, "default": plain(default)}
    return item


def _describe_faults(definitions: dict[str, Any]) -> dict[str, Any]:
    """A fault: one form for each kind, made from the register of kinds."""
    forms = []
    for family, cls in list_variants():
        name = f"fault.{family}.{cls.kind}"
        properties: dict[str, Any] = {"unit": {"enum": list(UNITS_OF[family])}, "kind": {"const": cls.kind}}
        if profiles := profiles_of(cls):
            properties["profile"] = {"enum": list(profiles)}
        properties |= {
            key: _describe_key(source, key, kind, default, definitions) for source, key, kind, default in keys_of(cls)
        }
        definitions[name] = {
            "type": "object", "description": summary_of(cls), "properties": properties, "additionalProperties": False,
        }  # fmt: skip
        forms.append({"$ref": f"#/$defs/{name}"})
    return {"anyOf": forms}


def _describe(kind: Any, definitions: dict[str, Any]) -> dict[str, Any]:
    kind, notes = strip_annotations(kind)
    if typing.get_origin(kind) in (Union, types.UnionType):
        members = [_describe(member, definitions) for member in typing.get_args(kind)]
        return members[0] if len(members) == 1 else {"anyOf": members}
    if kind is type(None):
        return {"type": "null"}
    if kind is Fault:
        return _describe_faults(definitions)
    if dataclasses.is_dataclass(kind):
        name = typing.cast(type, kind).__name__
        if name not in definitions:
            definitions[name] = {}
            definitions[name] = _describe_class(typing.cast(type, kind), definitions)
        return {"$ref": f"#/$defs/{name}"}
    if typing.get_origin(kind) is Literal:
        words = list(typing.get_args(kind))
        return {"const": words[0]} if len(words) == 1 else {"enum": words}
    if typing.get_origin(kind) is tuple:
        return _describe_list(typing.get_args(kind), definitions)
    return {"type": SCALARS[kind], **_describe_limits(notes)}


def _describe_limits(notes: tuple[Any, ...]) -> dict[str, Any]:
    return {
        word: getattr(note, cls.__name__.lower())
        for note in notes
        for cls, word in LIMIT_WORDS.items()
        if isinstance(note, cls)
    }


def _describe_list(kinds: tuple[Any, ...], definitions: dict[str, Any]) -> dict[str, Any]:
    result: dict[str, Any] = {"type": "array", "items": _describe(kinds[0], definitions)}
    if kinds[-1] is not Ellipsis:
        result |= {"minItems": len(kinds), "maxItems": len(kinds)}
    return result


def main() -> int:
    """Write schema and reference; return the exit code."""
    SCHEMA_FILE.write_text(format_schema(), encoding="utf-8")
    print(SCHEMA_FILE)
    REFERENCE_FILE.write_text(update_reference(REFERENCE_FILE.read_text(encoding="utf-8")), encoding="utf-8")
    print(REFERENCE_FILE)
    PLANT_PAGE.write_text(update_plant_page(PLANT_PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    print(PLANT_PAGE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
