"""Scenario files broken at random: the loader says what is wrong, and agrees with pydantic on what is well-formed."""

from __future__ import annotations

import copy
import json
from functools import reduce
from operator import or_
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from pydantic import BeforeValidator, ConfigDict, GetCoreSchemaHandler, TypeAdapter, ValidationError, create_model
from pydantic_core import CoreSchema, core_schema

from bus.settings import NOTHING, Reading, fields_of
from plant_server.faults import KINDS, PROFILES, UNITS, Fault, family_of
from plant_server.faults.fault import FaultKeys
from tools.config import Scenario, examine_text, load_scenario
from tools.config.reference import walk_classes

ROOT = Path(__file__).resolve().parents[2]
TEXTS = [path.read_text() for path in sorted((ROOT / "scenarios").glob("zhang2018*.yaml"))]
RESOLVED = [load_scenario(path).as_dict() for path in sorted((ROOT / "scenarios").glob("*.yaml"))]
NAME = str(ROOT / "scenarios" / "s.yaml")  # where `extends` is looked for


STRICT = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)
FAULT_KEYS = {
    "profile",
    *(key for group in (PROFILES, *KINDS.values()) for cls in group.values() for key in fields_of(cls)),
}


def drop_empty(data: Any) -> Any:
    """Without the empty keys that some other kind of fault has: those are as good as left out."""
    return {k: v for k, v in data.items() if v is not None or k not in FAULT_KEYS} if isinstance(data, dict) else data


def make_fault_oracle() -> TypeAdapter[Any]:
    """One pydantic model for each kind of fault with each profile, from the register of kinds; any of them may fit."""
    models = []
    for family, kinds in KINDS.items():
        units = Literal[tuple(unit for unit in UNITS if family_of(unit) == family)]
        for kind, cls in kinds.items():
            for name, profile in PROFILES.items() if cls.rises else [("step", None)]:
                named = Literal[name] if cls.rises else None
                keys = {**fields_of(FaultKeys), **(fields_of(profile) if profile else {}), **fields_of(cls)}
                fields: dict[str, Any] = {
                    key: (item, ... if default is NOTHING else default) for key, (item, default) in keys.items()
                }
                fields |= {"unit": (units, ...), "kind": (Literal[kind], ...)}
                if named is not None:
                    fields["profile"] = (named, name)
                models.append(create_model(f"{family}_{kind}_{name}", __config__=STRICT, **fields))
    return TypeAdapter(Annotated[reduce(or_, models), BeforeValidator(drop_empty)])


def read_fault(data: Any) -> Fault:
    """The fault that pydantic makes of a mapping: validated by its models, put together here."""
    found = FAULT_ORACLE.validate_python(data, strict=True)
    values = {key: getattr(found, key) for key in type(found).model_fields}
    profile = PROFILES[values.pop("profile", "step")]
    effect = KINDS[family_of(found.unit)][values.pop("kind")]
    take = lambda cls: cls(**{key: values.pop(key) for key in fields_of(cls)})  # noqa: E731
    return Fault(profile=take(profile), effect=take(effect), **values)


def fault_schema(source: type, handler: GetCoreSchemaHandler) -> CoreSchema:
    return core_schema.no_info_plain_validator_function(read_fault)


FAULT_ORACLE = make_fault_oracle()


def make_oracle() -> TypeAdapter[Scenario]:
    """pydantic over the settings classes, as strict as ours: unknown keys, NaN and infinities are errors."""
    Fault.__get_pydantic_core_schema__ = staticmethod(fault_schema)
    for _, cls in walk_classes(Scenario, ""):
        cls.__pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}
    return TypeAdapter(Scenario)


ORACLE = make_oracle()

SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(min_value=-(10**6), max_value=10**6),
    st.floats(allow_nan=False, allow_infinity=False, width=32),
    st.text(max_size=6),
    st.sampled_from(["ilo", "none", "smc", "mekf", "direct", "constant", "x", "settles", "0", "1e-3", "hub:"]),
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)


def spots_of(value: Any) -> list[tuple[Any, Any]]:
    """Every (container, key) in a tree of mappings and lists."""
    if isinstance(value, dict):
        pairs = list(value.items())
    elif isinstance(value, list):
        pairs = list(enumerate(value))
    else:
        return []
    return [(value, key) for key, _ in pairs] + [spot for _, child in pairs for spot in spots_of(child)]


def mutate(draw: st.DrawFn, data: Any) -> None:
    """Change, drop, rename or add one thing somewhere in the tree."""
    container, key = draw(st.sampled_from(spots_of(data)))
    action = draw(st.sampled_from(["change", "change", "drop", "rename", "add"]))
    if action == "change":
        container[key] = draw(VALUES)
    elif action == "drop":
        del container[key]
    elif isinstance(container, list):
        container.insert(key, draw(VALUES))
    elif action == "rename":
        container[draw(st.text(max_size=5))] = container.pop(key)
    else:
        container[draw(st.sampled_from(["kind", "extra", "seed", "at_s", "k1"]))] = draw(VALUES)


@st.composite
def broken(draw: st.DrawFn) -> dict[str, Any]:
    data: dict[str, Any] = copy.deepcopy(draw(st.sampled_from(RESOLVED)))
    for _ in range(draw(st.integers(1, 3))):
        mutate(draw, data)
    return data


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(broken())
def test_well_formed_means_the_same_as_to_pydantic(data: dict[str, Any]) -> None:
    """An independent validator, strict, over the same classes: each accepts exactly what the other accepts.

    Only checks of single values and structure are compared; those across keys are ours alone.
    """
    try:
        expected: Scenario | None = ORACLE.validate_json(json.dumps(data), strict=True)
    except ValidationError:
        expected = None
    reading = Reading(Scenario, data)
    assert (expected is None) == bool(reading.problems), reading.problems
    if expected is not None:
        assert reading.value == expected


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(broken())
def test_a_broken_tree_is_a_scenario_or_explained(data: dict[str, Any]) -> None:
    """Whatever stands where: either sound, or findings that each name a place; nothing else is raised."""
    examination = examine_text(json.dumps(data), "s.yaml")
    assert (examination.resolved is None) == bool(examination.findings)
    assert all(str(finding).startswith("s.yaml:1:") for finding in examination.findings)
    if examination.resolved is not None:
        again = examine_text(examination.resolved.to_yaml(), "again").resolved
        assert again is not None
        assert again.scenario == examination.resolved.scenario


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.data())
def test_a_broken_text_is_a_scenario_or_explained(data: st.DataObject) -> None:
    """Characters cut out, doubled and put in, among them those that mean something to YAML."""
    text = data.draw(st.sampled_from(TEXTS))
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        stop = min(len(text), start + data.draw(st.integers(0, 12)))
        word = data.draw(st.text(alphabet="{}[]:,-#&*!|>'\"%@`?<=\t\n ab01.eE+~\0\x07é\U0001f6f0", max_size=4))
        text = text[:start] + word + text[stop:]
    examination = examine_text(text, NAME)
    assert (examination.resolved is None) == bool(examination.findings)
    assert all(finding.message for finding in examination.findings)


@settings(max_examples=100, deadline=None)
@given(st.text(max_size=30), st.text(max_size=20))
@example("\u00b9", "1")  # a digit that is no number
@example("a[" + "9" * 5000 + "]", "1")  # more digits than Python takes for one
def test_any_override_is_taken_or_explained(key: str, value: str) -> None:
    for word in (f"{key}={value}", f"plant.{key}={value}", f"faults[0].kind={value}", f"title={value}"):
        examination = examine_text(TEXTS[0], NAME, [word])
        assert (examination.resolved is None) == bool(examination.findings)


def test_oracle_knows_the_shipped_scenarios() -> None:
    """Both accept them: the comparison above starts from sound data."""
    for data in RESOLVED:
        assert ORACLE.validate_json(json.dumps(data), strict=True) == Reading(Scenario, data).value
    with pytest.raises(ValidationError):
        ORACLE.validate_json(json.dumps(RESOLVED[0] | {"extra": 1}), strict=True)
