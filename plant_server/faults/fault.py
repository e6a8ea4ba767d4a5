"""One fault: where, from when, until when, how it comes on, and what it does. Flat as in a scenario file, checked once."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from bus.errors import ConfigError
from bus.settings import INVALID, NOTHING, KeyPath, Problem, Reading, fields_of, join_key, read_keys
from bus.units import Ge, Gt, Seconds
from plant_server.config import PlantConfig
from plant_server.faults import kinds as _kinds  # noqa: F401  (imported to fill KINDS)
from plant_server.faults.effects import KINDS, Effect
from plant_server.faults.profiles import PROFILES, STEP, Profile
from plant_server.faults.units import FAMILIES, UNITS, family_of

Keys = dict[str, tuple[Any, Any]]  # type with annotations, and default, as bus.settings.fields_of lists them


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultKeys:
    """One fault: what, where, from when, until when, how it comes on. The same form from YAML and from a command."""

    unit: str  # wheel.1 .. wheel.4, gyro.x .. gyro.z, gyro (all axes), star_tracker
    kind: str  # see the kinds of fault
    at_s: Annotated[Seconds, Ge(0)]
    until_s: Annotated[Seconds, Gt(0)] | None = None  # None: to the end of the run
    id: str | None = None  # name in the log and for commands; None: faults[0] for the first of the scenario


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One fault on one unit. Made from its keys with `make_fault` or by the settings reader."""

    unit: str
    at_s: float
    until_s: float | None = None
    id: str | None = None
    profile: Profile = STEP
    effect: Effect

    @property
    def kind(self) -> str:
        """Name of its kind."""
        return self.effect.kind

    @classmethod
    def read_settings(cls, data: object, at: KeyPath, out: Reading) -> Any:
        """Return the fault that a flat mapping describes, INVALID when there is none; problems and parts go to `out`."""
        known, kind = find_keys(data)
        if isinstance(data, dict):
            data = {
                key: item for key, item in data.items() if key in known or not _is_foreign(key, item, kind, at, out)
            }
        values = read_keys(known, data, at, out)
        if kind is None or INVALID in values.values():
            return INVALID
        profile, effect = _find_profile(data), kind
        return cls(
            **{key: values[key] for key in ("unit", "at_s", "until_s", "id")},
            profile=profile(**{key: values[key] for key in fields_of(profile)}),
            effect=effect(**{key: values[key] for key in magnitudes_of(effect)}),
        )

    def plain_settings(self) -> dict[str, Any]:
        """Return the flat mapping that reads back as this fault; what was left out stays out."""
        head = {"id": self.id, "unit": self.unit, "kind": self.kind, "at_s": self.at_s, "until_s": self.until_s}
        profile = dataclasses.asdict(self.profile)  # type: ignore[call-overload]
        effect = dataclasses.asdict(self.effect)  # type: ignore[call-overload]
        return {key: value for key, value in {**head, **effect, **profile}.items() if value is not None}

    @property
    def definition(self) -> str:
        """The whole fault as one line of JSON, keys as in a scenario file."""
        return json.dumps(self.plain_settings(), separators=(",", ":"), allow_nan=False)

    @property
    def magnitudes(self) -> dict[str, float]:
        """What its kind takes of numbers, in their order; those left out are not there."""
        effect = self.effect
        given = {name: getattr(effect, name) for name in magnitudes_of(type(effect))}
        return {name: value for name, value in given.items() if isinstance(value, float | int)}

    def describe(self) -> str:
        """Return unit, kind and magnitudes as a phrase for a log."""
        text = ", ".join(f"{key} {value:g}" for key, value in self.magnitudes.items())
        return " ".join(word for word in (self.unit, self.kind, text) if word)

    def check(self, plant: PlantConfig | None = None) -> list[Problem]:
        """Return what is wrong between its keys, and with it on this plant (None: whatever plant), paths relative to it."""
        problems = []
        if word := explain_times(self.at_s, self.until_s):
            problems.append(Problem(("until_s",), word))
        if self.id is not None and not 0 < len(self.id.strip()) <= LONGEST_ID:
            problems.append(Problem(("id",), f"has {len(self.id)} characters; give 1 to {LONGEST_ID}, not all blank"))
        if word := self.effect.explain_futile(plant):
            problems.append(Problem(("kind",), word))
        return problems


LONGEST_ID = 80
PROFILE_NAME: Any = Literal[tuple(PROFILES)] | None


def explain_times(at_s: float, until_s: float | None) -> str | None:
    """Return why a fault cannot end at until_s, None when it can."""
    if until_s is None or at_s < until_s:
        return None
    return f"{until_s} s is not after the onset at {at_s} s; give a later time or leave it out"


# -- keys ----------------------------------------------------------------------------------------------------------


def find_keys(data: object) -> tuple[Keys, type[Effect] | None]:
    """Return the keys that a fault of this unit and kind has, and the class of its kind.

    While that is not known (None) the keys are those of every kind, none of them needed.
    """
    given: dict[Any, Any] = data if isinstance(data, dict) else {}
    unit, kind = given.get("unit"), given.get("kind")
    families = [family_of(unit)] if isinstance(unit, str) and unit in UNITS else FAMILIES
    names = tuple(dict.fromkeys(name for family in families for name in KINDS[family]))
    keys = dict(fields_of(FaultKeys))
    keys["unit"] = (Literal[UNITS], NOTHING)
    keys["kind"] = (Literal[names], NOTHING)
    if len(families) == 1 and isinstance(kind, str) and kind in names:
        effect = KINDS[families[0]][kind]
        return {**keys, **magnitudes_of(effect), **_profile_keys(given, effect)}, effect
    every = {
        key: (item, None)
        for family in families
        for cls in KINDS[family].values()
        for key, (item, _) in magnitudes_of(cls).items()
    }
    every |= {key: (item, None) for cls in PROFILES.values() for key, (item, _) in fields_of(cls).items()}
    return {**keys, "profile": (PROFILE_NAME, None), **every}, None


def magnitudes_of(effect: type) -> Keys:
    """Return the magnitudes of a kind: types and defaults by key."""
    return fields_of(effect)


def _profile_keys(given: dict[Any, Any], effect: type[Effect]) -> Keys:
    if not effect.rises:
        return {}
    return {"profile": (PROFILE_NAME, None), **fields_of(_find_profile(given))}


def _find_profile(data: object) -> Any:
    """Return the class of the profile that a mapping asks for: by name, or by a key that only one of them has."""
    given: dict[Any, Any] = data if isinstance(data, dict) else {}
    name = given.get("profile")
    if isinstance(name, str) and name in PROFILES:
        return PROFILES[name]
    return next(
        (cls for cls in PROFILES.values() if any(given.get(key) is not None for key in fields_of(cls))),
        PROFILES["step"],
    )


def _every_key() -> set[str]:
    classes = [*PROFILES.values(), *(cls for family in KINDS.values() for cls in family.values())]
    return {"profile", *(key for cls in classes for key in fields_of(cls))}


def _is_foreign(key: object, value: object, kind: type[Effect] | None, at: KeyPath, out: Reading) -> bool:
    """Say so when a key belongs to other kinds than this; one that is empty is as good as left out."""
    if kind is None or not isinstance(key, str) or key not in _every_key():
        return False
    if value is not None:
        own = [*magnitudes_of(kind), *(("profile", "rise_s") if kind.rises else ())]
        name = f"{kind.family} fault {kind.kind}"
        out.add((*at, key), f"{name} has no use for {key}; it takes {', '.join(own) or 'no magnitude'}", at_key=True)
    return True


# -- several -------------------------------------------------------------------------------------------------------


def make_fault(**keys: Any) -> Fault:
    """Return the fault with these keys, as in a scenario file. Raises ConfigError with everything that is wrong."""
    reading = Reading(Fault, {key: value for key, value in keys.items() if value is not None})
    problems = reading.problems or reading.value.check()
    if problems:
        raise ConfigError(*(f"fault: {join_key(p.path)}: {p.message}" for p in problems))
    fault: Fault = reading.value
    return fault


def fault_ids(faults: Iterable[Fault]) -> tuple[str, ...]:
    """Return the id of each of a scenario's faults: its own, or faults[i]."""
    return tuple(f"faults[{i}]" if fault.id is None else fault.id for i, fault in enumerate(faults))


def check_faults(faults: Iterable[Fault], plant: PlantConfig | None = None) -> list[Problem]:
    """Return everything wrong with a scenario's faults beyond the value of each key, paths starting with the index."""
    faults = tuple(faults)
    problems = [
        Problem((i, *problem.path), problem.message, problem.at_key)
        for i, fault in enumerate(faults)
        for problem in fault.check(plant)
    ]
    first: dict[str, int] = {}
    for i, name in enumerate(fault_ids(faults)):
        if first.setdefault(name, i) != i:
            problems.append(Problem((i, "id"), f'"{name}" is the id of faults[{first[name]}] too; ids are unique'))
    return problems
