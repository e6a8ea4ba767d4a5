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
from plant_server.faults.profiles import PROFILES, STEP, Profile, Step
from plant_server.faults.units import FAMILIES, UNITS, family_of

Keys = dict[str, tuple[Any, Any]]  # type with annotations, and default, as bus.settings.fields_of lists them
Latch = Literal[True, "until_reset", "until_power_cycle"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultKeys:
    """One fault: what, where, from when, until when, how it comes on. The same form from YAML and from a command."""

    unit: str  # wheel.1 .. wheel.4, gyro.x .. gyro.z, gyro (all axes), star_tracker, bus
    kind: str  # see the kinds of fault
    at_s: Annotated[Seconds, Ge(0)]
    until_s: Annotated[Seconds, Gt(0)] | None = None  # None: to the end of the run
    id: str | None = None  # name in the log and for commands; None: faults[0] for the first of the scenario
    latch: Latch | None = (
        None  # wheels: what alone ends it; true: nothing to the end of the run; None: until_s or its profile
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One fault on one unit. Made from its keys with `make_fault` or by the settings reader."""

    unit: str
    at_s: float
    until_s: float | None = None
    id: str | None = None
    latch: Latch | None = None
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
                key: item for key, item in data.items() if key in known or not _is_foreign(data, key, kind, at, out)
            }
        values = read_keys(known, data, at, out)
        if kind is None or INVALID in values.values():
            return INVALID
        profile, effect = _find_profile(data, kind), kind
        return cls(
            **{key: values[key] for key in ("unit", "at_s", "until_s", "id")},
            latch=values.get("latch"),
            profile=profile(**{key: values[key] for key in magnitudes_of(profile)}),
            effect=effect(**{key: values[key] for key in magnitudes_of(effect)}),
        )

    def plain_settings(self) -> dict[str, Any]:
        """Return the flat mapping that reads back as this fault; what was left out stays out."""
        head = {"id": self.id, "unit": self.unit, "kind": self.kind, "at_s": self.at_s, "until_s": self.until_s}
        head["latch"] = self.latch
        profile = {} if self.profile == self.effect.usual else dataclasses.asdict(self.profile)  # type: ignore[call-overload]
        effect = dataclasses.asdict(self.effect)  # type: ignore[call-overload]
        named = {key: value for key, value in {**head, **effect, **profile}.items() if value is not None}
        if self.profile != self.effect.usual and _find_profile(named, type(self.effect)) is not type(self.profile):
            named["profile"] = next(name for name, cls in PROFILES.items() if cls is type(self.profile))
        return named

    @property
    def definition(self) -> str:
        """The whole fault as one line of JSON, keys as in a scenario file."""
        return json.dumps(self.plain_settings(), separators=(",", ":"), allow_nan=False)

    @property
    def ends_s(self) -> float | None:
        """When it ends without anyone doing anything [s]; None: not before the run does."""
        if self.latch:
            return None
        span_s = self.profile.span_s
        ends = [end for end in (self.until_s, None if span_s is None else self.at_s + span_s) if end is not None]
        return min(ends, default=None)

    @property
    def magnitudes(self) -> dict[str, float]:
        """What its kind takes of numbers, in their order; those left out are not there."""
        effect = self.effect
        given = {name: getattr(effect, name) for name in magnitudes_of(type(effect))}
        return {
            name: value
            for name, value in given.items()
            if isinstance(value, float | int) and not isinstance(value, bool)
        }

    def describe(self) -> str:
        """Return unit, kind and magnitudes as a phrase for a log."""
        text = ", ".join(f"{key} {value:g}" for key, value in self.magnitudes.items())
        return " ".join(word for word in (self.unit, self.kind, text) if word)

    def check(self, plant: PlantConfig | None = None) -> list[Problem]:
        """Return what is wrong between its keys, and with it on this plant (None: whatever plant), paths relative to it."""
        problems = []
        if word := explain_times(self.at_s, self.until_s):
            problems.append(Problem(("until_s",), word))
        if self.latch is True and self.until_s is not None:
            problems.append(
                Problem(("until_s",), "a fault with latch: true stays to the end of the run; leave one of both out")
            )
        if self.id is not None and not 0 < len(self.id.strip()) <= LONGEST_ID:
            problems.append(Problem(("id",), f"has {len(self.id)} characters; give 1 to {LONGEST_ID}, not all blank"))
        if self.id is not None and self.id in NO_IDS:
            problems.append(Problem(("id",), f'"{self.id}" is what units are called by; give another id'))
        if word := self.effect.explain_futile(plant, self.unit):
            problems.append(Problem(("kind",), word))
        return problems


LONGEST_ID = 80
NO_IDS = {*UNITS, *FAMILIES, "all"}  # who clears by a name means the unit
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
    keys = keys_of_all(*families)
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
    every |= {key: (item, None) for cls in PROFILES.values() for key, (item, _) in magnitudes_of(cls).items()}
    return {**keys, "profile": (PROFILE_NAME, None), **every}, None


def keys_of_all(*families: str) -> Keys:
    """Return the keys that faults of these families have whatever their kind: types and defaults."""
    return {key: item for key, item in fields_of(FaultKeys).items() if key != "latch" or "wheel" in families}


def magnitudes_of(part: type) -> Keys:
    """Return the magnitudes of a kind, or the keys of a profile: types and defaults by key."""
    return fields_of(part)


def profiles_of(effect: type[Effect]) -> dict[str, type[Profile]]:
    """Return the profiles that a kind can have, by name; none when how far it has come on means nothing to it."""
    if effect.rises:
        return PROFILES
    return {name: cls for name, cls in PROFILES.items() if cls.switches} if effect.switches else {}


def profile_keys_of(profile: type[Profile], effect: type[Effect]) -> Keys:
    """Return the keys of a profile: types and defaults; those of the kind's usual profile default to what it has."""
    keys, usual = magnitudes_of(profile), effect.usual
    if type(usual) is not profile:
        return keys
    return {key: (item, getattr(usual, key)) for key, (item, _) in keys.items()}


def _profile_keys(given: dict[Any, Any], effect: type[Effect]) -> Keys:
    known = profiles_of(effect)
    if not known:
        return {}
    return {"profile": (Literal[tuple(known)] | None, None), **profile_keys_of(_find_profile(given, effect), effect)}


def _find_profile(data: object, effect: type[Effect]) -> type[Profile]:
    """Return the class of the profile that a mapping asks for: by name, or by the keys that are there.

    Without a name it is the first that takes all keys of profiles that are given, the kind's usual one ahead of all; where
    none does, the first that takes one of them.
    """
    given: dict[Any, Any] = data if isinstance(data, dict) else {}
    known, name = profiles_of(effect), given.get("profile")
    if isinstance(name, str) and name in known:
        return known[name]
    keys = {key for cls in known.values() for key in magnitudes_of(cls) if given.get(key) is not None}
    order = [type(effect.usual), *known.values()]
    return next(
        (cls for cls in order if keys <= magnitudes_of(cls).keys()),
        next((cls for cls in order if keys & magnitudes_of(cls).keys()), Step),
    )


def _every_key() -> set[str]:
    classes = [*PROFILES.values(), *(cls for family in KINDS.values() for cls in family.values())]
    return {"profile", "latch", *(key for cls in classes for key in magnitudes_of(cls))}


def _is_foreign(data: dict[Any, Any], key: object, kind: type[Effect] | None, at: KeyPath, out: Reading) -> bool:
    """Say so when a key belongs to other kinds than this; one that is empty is as good as left out."""
    if kind is None or not isinstance(key, str) or key not in _every_key():
        return False
    if data[key] is None:
        return True
    profiles = profiles_of(kind)
    if any(key in magnitudes_of(cls) for cls in profiles.values()):
        profile = _find_profile(data, kind)
        name = next(name for name, cls in PROFILES.items() if cls is profile)
        own = list(magnitudes_of(profile))
        text = f"profile {name} has no use for {key}; it takes {', '.join(own) or 'no key'}"
    else:
        steps = dict.fromkeys(key for cls in profiles.values() for key in magnitudes_of(cls))
        own = [*magnitudes_of(kind), *(("profile", *steps) if profiles else ())]
        text = f"{kind.family} fault {kind.kind} has no use for {key}; it takes {', '.join(own) or 'no magnitude'}"
    out.add((*at, key), text, at_key=True)
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
