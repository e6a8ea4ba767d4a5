"""Scenario files broken at random: the loader says what is wrong, and agrees with pydantic on what is well-formed."""

from __future__ import annotations

import copy
import json
import random
import re
import shutil
import time
from functools import reduce
from operator import or_
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from pydantic import BeforeValidator, ConfigDict, GetCoreSchemaHandler, TypeAdapter, ValidationError, create_model
from pydantic_core import CoreSchema, core_schema

from bus.errors import ConfigError
from bus.settings import NOTHING, Reading, fields_of
from plant_server.faults import KINDS, PROFILES, UNITS, Fault, family_of
from plant_server.faults.fault import keys_of_all, profile_keys_of, profiles_of
from tools.config.check import summarise
from tools.config.loader import examine_text, load_scenario
from tools.config.reference import walk_classes
from tools.config.scenario import Scenario

EXAMPLES = settings.default.max_examples
ROOT = Path(__file__).resolve().parents[2]
TEXTS = [path.read_text() for path in sorted((ROOT / "scenarios").glob("zhang2018*.yaml"))]
RESOLVED = [load_scenario(path).as_dict() for path in sorted((ROOT / "scenarios").glob("*.yaml"))]
NAME = str(ROOT / "scenarios" / "s.yaml")  # where `extends` is looked for


STRICT = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)
FAULT_KEYS = {
    "profile",
    "latch",
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
            profiles = profiles_of(cls)
            # one that names no profile has the kind's usual one, where that takes the keys it gives
            order = sorted(profiles.items(), key=lambda item: item[1] is not type(cls.usual))
            for name, profile in order or [("step", None)]:
                named = Literal[name] if profiles else None
                keys = {**keys_of_all(family), **(profile_keys_of(profile, cls) if profile else {}), **fields_of(cls)}
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


# what our border says beyond structure and limits: the oracle does not know it, and its own tests are elsewhere
BORDER = ("is out of reach; ", " characters; at most ", "which cannot be printed", "is not a name; ")


@settings(max_examples=3 * EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.too_slow])
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
    problems = [problem for problem in reading.problems if not any(word in problem.message for word in BORDER)]
    assert (expected is None) == bool(problems), reading.problems
    if expected is not None and not reading.problems:
        assert reading.value == expected


@settings(max_examples=2 * EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.too_slow])
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


@settings(max_examples=3 * EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.too_slow])
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


@settings(max_examples=EXAMPLES, deadline=None)
@given(st.text(max_size=30), st.text(max_size=20))
@example("\u00b9", "1")  # a digit that is no number
@example("a[" + "9" * 5000 + "]", "1")  # more digits than Python takes for one
def test_any_override_is_taken_or_explained(key: str, value: str) -> None:
    for word in (f"{key}={value}", f"plant.{key}={value}", f"faults[0].kind={value}", f"title={value}"):
        examination = examine_text(TEXTS[0], NAME, [word])
        assert (examination.resolved is None) == bool(examination.findings)


NUMBERS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False),
    st.integers(),
    st.sampled_from([0, -0.0, 5e-324, 1e-300, 1e-18, 1e-9, 1e7, 1e12, -1e12, 1e150, 1e308, 2**64, 10**400, -(10**400)]),
)


def number_spots(value: Any) -> list[tuple[Any, Any]]:
    """Every (container, key) of a number in a tree."""
    return [
        (container, key)
        for container, key in spots_of(value)
        if isinstance(container[key], int | float) and not isinstance(container[key], bool)
    ]


@settings(max_examples=2 * EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.data())
def test_any_number_is_computed_with_or_explained(data: st.DataObject) -> None:
    """Any number at any place of a scenario that ships: sound, built and printable, or findings; soon, and never else."""
    tree = copy.deepcopy(data.draw(st.sampled_from(RESOLVED)))
    for _ in range(data.draw(st.integers(1, 3))):
        container, key = data.draw(st.sampled_from(number_spots(tree)))
        container[key] = data.draw(NUMBERS)
    start_s = time.process_time()
    examination = examine_text(json.dumps(tree), "s.yaml")
    assert time.process_time() - start_s < 5.0
    assert (examination.resolved is None) == bool(examination.findings)
    assert all(len(str(finding)) < 1500 for finding in examination.findings)
    if examination.resolved is not None:
        summarise(examination.resolved)


@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.data())
def test_any_text_is_taken_or_explained_on_its_own_line(data: st.DataObject) -> None:
    """Any text in place of any text of a scenario that ships: no finding breaks a line but to show the source."""
    tree = copy.deepcopy(data.draw(st.sampled_from(RESOLVED)))
    spots = [(container, key) for container, key in spots_of(tree) if isinstance(container[key], str)]
    container, key = data.draw(st.sampled_from(spots))
    container[key] = data.draw(st.text(max_size=40) | st.sampled_from(["a" * 20_000, "a\nPASS: b", "../x", "a\0"]))
    examination = examine_text(json.dumps(tree), "s.yaml")
    assert (examination.resolved is None) == bool(examination.findings)
    assert all(len(finding.headline.splitlines()) == 1 for finding in examination.findings)
    assert all(len(finding.headline) < 1500 for finding in examination.findings)


def mutate_text(chance: random.Random, text: str) -> str:
    """Cut, double, shuffle and replace: bytes, words, lines and blocks of a scenario file."""
    for _ in range(chance.randint(1, 4)):
        start = chance.randrange(len(text) + 1)
        stop = min(len(text), start + chance.choice((0, 1, 3, 40, 400)))
        lines = text.split("\n")
        at = chance.randrange(len(lines))
        match chance.randrange(7):
            case 0:
                text = text[:start] + text[stop:]
            case 1:
                text = text[:stop] + text[start:]
            case 2:
                text = text[:start] + chance.choice(PIECES) + text[stop:]
            case 3:
                lines[at] = lines[chance.randrange(len(lines))]
                text = "\n".join(lines)
            case 4:
                lines[at] = " " * chance.randrange(6) + lines[at]
                text = "\n".join(lines)
            case 5:
                lines[at : at + chance.randint(1, 9)] = [lines[at]] * chance.randrange(200)
                text = "\n".join(lines)
            case _:
                text = re.sub(
                    r"(?<=[ \[])-?[0-9.]+", lambda _: chance.choice(PIECES), text, count=chance.randint(1, 20)
                )
    return text


PIECES = (
    "1e150", "-1e308", ".nan", "-.inf", "0x" + "f" * 400, "9" * 500, "1e-300", "0", "-1", "1e12", "18446744073709551616",
    "null", "true", "{}", "[]", "&a", "*a", "<<: *a", "!!float", "\0", "\t", "\x85", "\u2028", "\ud7ff", "\U0001f6f0", "- ",
    "? ", ": ",
    "{", "[", "}", "]", "'", '"', "|", ">", "%", "---", "...", "extends: zhang2018", "kind: mekf", "kind: practical",
    "kind: wang2010", "fsw.law.beta[0]", "norm(fsw.fdi.gyro_state)", "hub:/dev/null/x", "memory:", "#",
)  # fmt: skip


@pytest.mark.slow
def test_five_thousand_mutated_files_are_scenarios_or_explained(tmp_path: Path) -> None:
    """Files as `check` meets them, mutated from a fixed seed: findings or a scenario, each within 5 s of processor time."""
    chance = random.Random(9)
    files = sorted((ROOT / "scenarios").glob("*.yaml"))
    for file in files:
        shutil.copy(file, tmp_path)
    sound = unexplained = 0
    for number in range(5000):
        file = tmp_path / "mutated.yaml"
        data = mutate_text(chance, chance.choice(files).read_text()).encode("utf-8", "surrogatepass")
        if not number % 10:
            at = chance.randrange(len(data) + 1)
            data = data[:at] + chance.randbytes(chance.randint(1, 4)) + data[at + chance.randrange(5) :]
        file.write_bytes(data)
        start_s = time.process_time()
        try:
            load_scenario(file)
            sound += 1
        except ConfigError as error:
            unexplained += not str(error)
        assert time.process_time() - start_s < 5.0, number
    assert unexplained == 0
    assert 100 < sound < 4500  # the mutations are neither all harmless nor all fatal


def test_oracle_knows_the_shipped_scenarios() -> None:
    """Both accept them: the comparison above starts from sound data."""
    for data in RESOLVED:
        assert ORACLE.validate_json(json.dumps(data), strict=True) == Reading(Scenario, data).value
    with pytest.raises(ValidationError):
        ORACLE.validate_json(json.dumps(RESOLVED[0] | {"extra": 1}), strict=True)
