"""Settings from plain data: both sides build their frozen dataclasses from the resolved file with this, and check it.

The limits stand beside the fields (`Annotated[float, Unit("N m"), Gt(0)]`, see bus/units.py); here they are enforced,
with the standard library only, so that the flight software checks its own settings without a validation library.
"""

from __future__ import annotations

import dataclasses
import json
import math
import types
import typing
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union

from annotated_types import Ge, Gt, Le, Lt

from bus.errors import ConfigError
from bus.texts import SHORT, Text, explain_text
from bus.units import ANY_REACH, MOST_LISTED, REACH, WHOLE_REACH, Unit
from bus.words import describe, nearest

T = TypeVar("T")
KeyPath = tuple[str | int, ...]

INVALID: Any = object()  # stands for a value that could not be built
NOTHING: Any = object()  # stands for the default of a field that has none

MAX_UNKNOWN = 20  # unknown keys of one mapping that are named; more are counted
MAX_GUESSES = (
    20  # near misses that are looked for in one reading: a file of nothing but typing errors is something else
)


# -- building ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing wrong with a value: which, what, and whether the key itself is at fault."""

    path: KeyPath
    message: str
    at_key: bool = False


class Reading:
    """Result of reading plain data: `value` (INVALID when it could not be built), all `problems`, and `parts`.

    `parts` holds every value that could be built, by key path, defaults included: checks that span several keys run on
    what is sound even when something else is not.
    """

    __slots__ = ("_guesses", "parts", "problems", "value")

    def __init__(self, cls: Any, data: object) -> None:
        self._guesses = 0
        self.problems: list[Problem] = []
        self.parts: dict[KeyPath, Any] = {}
        self.value: Any = _read(cls, data, (), self)

    def add(self, path: KeyPath, message: str, *, at_key: bool = False) -> Any:
        self.problems.append(Problem(path, message, at_key))
        return INVALID

    def guess(self, word: str, known: Iterable[str]) -> str | None:
        """The known word that was perhaps meant; None when none is close, or after MAX_GUESSES of them."""
        self._guesses += 1
        return nearest(word, known) if self._guesses <= MAX_GUESSES else None


def build(cls: type[T], data: object, where: str) -> T:
    """The settings object that `data` (as JSON gives it) describes.

    Raises ConfigError with every problem found, each as `where: key.path: what is wrong`.
    """
    reading = Reading(cls, data)
    if reading.problems:
        raise ConfigError(*(f"{where}: {join_key(p.path)}: {p.message}" for p in reading.problems))
    return typing.cast(T, reading.value)


def build_file(cls: type[T], path: Path) -> T:
    """The settings object that a JSON file describes. Raises ConfigError when it cannot be read or is wrong."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: cannot read settings: {error}") from None
    return build(cls, data, str(path))


def plain(value: Any) -> Any:
    """The same value in JSON types: dataclasses become mappings, tuples become lists. The inverse of `build`."""
    if isinstance(value, str | float | int) or value is None:  # nearly all of them
        return value
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    if hasattr(value, "plain_settings"):
        return value.plain_settings()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        kind: type = type(value)
        return {name: plain(getattr(value, name)) for name in _names_of(kind)}
    return value


@cache
def _names_of(cls: type) -> tuple[str, ...]:
    return tuple(item.name for item in dataclasses.fields(cls))


def join_key(path: KeyPath) -> str:
    """Key path as people write it: plant.wheels[2].max_torque_nm."""
    text = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path)
    return text.removeprefix(".") or "(top level)"


# -- types ---------------------------------------------------------------------------------------------------------


@cache
def fields_of(cls: type) -> dict[str, tuple[Any, Any]]:
    """For each field of a settings class: its type with all annotations, and its default (NOTHING: required)."""
    hints = typing.get_type_hints(cls, include_extras=True)
    result = {}
    for item in dataclasses.fields(cls):
        default: Any = NOTHING
        if item.default is not dataclasses.MISSING:
            default = item.default
        elif item.default_factory is not dataclasses.MISSING:
            default = item.default_factory()
        result[item.name] = (hints[item.name], default)
    return result


def strip_annotations(kind: Any) -> tuple[Any, tuple[Any, ...]]:
    """Type without `Annotated`, and what was said there (units, limits)."""
    if typing.get_origin(kind) is Annotated:
        return kind.__origin__, kind.__metadata__
    return kind, ()


def branches_of(kind: Any) -> tuple[Any, ...]:
    """Members of a union (one member: the type itself), without None."""
    if typing.get_origin(kind) in (Union, types.UnionType):
        return tuple(member for member in typing.get_args(kind) if member is not type(None))
    return (kind,)


def is_optional(kind: Any) -> bool:
    return typing.get_origin(kind) in (Union, types.UnionType) and type(None) in typing.get_args(kind)


@cache
def tags_of(members: tuple[type, ...]) -> tuple[str, dict[str, type]]:
    """Key that tells the members of a union apart (the first single-word Literal), and the member for each word."""
    for name, (kind, _) in fields_of(members[0]).items():
        if typing.get_origin(kind) is Literal and len(typing.get_args(kind)) == 1:
            return name, {typing.get_args(fields_of(member)[name][0])[0]: member for member in members}
    raise TypeError(f"no key tells {', '.join(m.__name__ for m in members)} apart: give each a Literal field")


def unit_of(notes: tuple[Any, ...]) -> str:
    """Unit symbol among annotations, the innermost one first given last ('' when there is none)."""
    return next((note.symbol for note in reversed(notes) if isinstance(note, Unit)), "")


def find_unit(kind: Any) -> str:
    """Unit symbol of a setting, through unions with None ('' when there is none)."""
    return unit_of(all_notes(kind))


def limits_of(notes: tuple[Any, ...]) -> str:
    """Allowed range in words: '> 0, <= 0.1' ('' when there is none)."""
    words = []
    for note in notes:
        for kind, sign, name in ((Gt, ">", "gt"), (Ge, ">=", "ge"), (Lt, "<", "lt"), (Le, "<=", "le")):
            if isinstance(note, kind):
                words.append(f"{sign} {getattr(note, name)}")
    return ", ".join(words)


# -- reading -------------------------------------------------------------------------------------------------------


def _read(kind: Any, data: object, at: KeyPath, out: Reading, notes: tuple[Any, ...] = ()) -> Any:
    kind, own = strip_annotations(kind)
    notes = notes + own
    members = branches_of(kind)
    if data is None and is_optional(kind):
        value: Any = None
    elif len(members) > 1:
        value = _read_tagged(members, data, at, out)
    elif members[0] is not kind:
        return _read(members[0], data, at, out, notes)
    elif hasattr(kind, "read_settings"):  # a class that knows its own keys, see `read_keys`
        value = kind.read_settings(data, at, out)
    elif dataclasses.is_dataclass(kind):
        value = _read_mapping(typing.cast(type, kind), data, at, out)
    elif typing.get_origin(kind) is tuple:
        value = _read_list(typing.get_args(kind), data, at, out, notes)
    elif typing.get_origin(kind) is Literal:
        value = _read_word(typing.get_args(kind), data, at, out)
    else:
        value = _read_scalar(kind, data, at, out, notes)
    if value is not INVALID:
        out.parts[at] = value
    return value


def _read_mapping(cls: type, data: object, at: KeyPath, out: Reading) -> Any:
    values = read_keys(fields_of(cls), data, at, out)
    return cls(**values) if all(value is not INVALID for value in values.values()) else INVALID


def read_keys(known: dict[str, tuple[Any, Any]], data: object, at: KeyPath, out: Reading) -> dict[str, Any]:
    """The value of every known key of a mapping (as `fields_of` lists them), INVALID where it is not sound.

    For classes whose keys are not those of one dataclass: such a class has a class method `read_settings(data, at, out)`
    that returns an instance or INVALID, and `plain_settings()`, its inverse.
    """
    if not isinstance(data, dict):
        out.add(at, f"{describe(data)} where a mapping is needed, with the keys {', '.join(known)}")
        return dict.fromkeys(known, INVALID)
    meant = _tell_unknown(known, data, at, out)
    values: dict[str, Any] = {}
    for name, (kind, default) in known.items():
        if name in data:
            values[name] = _read(kind, data[name], (*at, name), out)
        elif default is not NOTHING:
            values[name] = default
            _note_parts(default, (*at, name), out)
        else:
            values[name] = INVALID
            if name not in meant:
                unit = unit_of(strip_annotations(kind)[1])
                out.add((*at, name), "is missing" + (f" [{unit}]" if unit else ""), at_key=True)
    return values


def _tell_unknown(known: dict[str, tuple[Any, Any]], data: dict[Any, Any], at: KeyPath, out: Reading) -> set[str]:
    """Add a problem for each unknown key, up to MAX_UNKNOWN; return the known keys that were perhaps meant."""
    unknown = [key for key in data if key not in known]
    meant = set()
    for key in unknown[:MAX_UNKNOWN]:
        if guess := out.guess(str(key), known):
            meant.add(guess)
        out.add((*at, key), _say_unknown(guess, known), at_key=True)
    if len(unknown) > MAX_UNKNOWN:
        out.add(at, f"has {len(unknown) - MAX_UNKNOWN} more unknown keys; there are: {', '.join(known)}", at_key=True)
    return meant


def _read_tagged(members: tuple[Any, ...], data: object, at: KeyPath, out: Reading) -> Any:
    tag, classes = tags_of(members)
    if not isinstance(data, dict):
        return out.add(at, f"{describe(data)} where a mapping is needed, with {tag}: {' | '.join(classes)}")
    if tag not in data:
        return out.add((*at, tag), f"is missing; there are: {', '.join(classes)}", at_key=True)
    word = data[tag]
    if not isinstance(word, str) or word not in classes:
        return _read_word(tuple(classes), word, (*at, tag), out)
    return _read_mapping(classes[word], data, at, out)


def _read_list(kinds: tuple[Any, ...], data: object, at: KeyPath, out: Reading, notes: tuple[Any, ...]) -> Any:
    if not isinstance(data, list | tuple):
        return out.add(at, f"{describe(data)} where a list is needed")
    if kinds[-1] is Ellipsis:
        if len(data) > MOST_LISTED:
            return out.add(at, f"has {len(data)} entries, at most {MOST_LISTED}")
        kinds = (kinds[0],) * len(data)
    elif len(kinds) != len(data):
        return out.add(at, f"has {len(data)} entries, needs {len(kinds)}")
    units = tuple(note for note in notes if isinstance(note, Unit))
    values = tuple(
        _read(kind, item, (*at, index), out, units) for index, (kind, item) in enumerate(zip(kinds, data, strict=True))
    )
    return INVALID if any(value is INVALID for value in values) else values


def _read_word(words: tuple[Any, ...], data: object, at: KeyPath, out: Reading) -> Any:
    if isinstance(data, str | bool) and any(
        data is word or (data == word and type(data) is type(word)) for word in words
    ):
        return data
    texts = [word if isinstance(word, str) else json.dumps(word) for word in words]
    guess = out.guess(data, texts) if isinstance(data, str) else None
    hint = f' did you mean "{guess}"?' if guess else ""
    return out.add(at, f"{describe(data)} is not known;{hint} there are: {', '.join(texts)}")


def _read_scalar(kind: Any, data: object, at: KeyPath, out: Reading, notes: tuple[Any, ...]) -> Any:
    if kind is str:
        return _read_text(data, at, out, notes)
    if kind is bool:
        return data if isinstance(data, bool) else out.add(at, f"{describe(data)} is neither true nor false")
    if kind is float:
        return _read_float(data, at, out, notes)
    if kind is int:
        if isinstance(data, int) and not isinstance(data, bool):
            return _limit(data, at, out, notes)
        return out.add(at, f"{describe(data)} is not a whole number{_say_allowed(notes)}")
    raise TypeError(f"{join_key(at)}: settings of type {kind!r} are not supported")


def _read_text(data: object, at: KeyPath, out: Reading, notes: tuple[Any, ...]) -> Any:
    if not isinstance(data, str):
        return out.add(at, f"{describe(data)} is not text; put it in quotes")
    allowed = next((note for note in notes if isinstance(note, Text)), SHORT)
    word = explain_text(data, allowed)
    return data if word is None else out.add(at, f"{describe(data)} {word}")


def _read_float(data: object, at: KeyPath, out: Reading, notes: tuple[Any, ...]) -> Any:
    if not isinstance(data, int | float) or isinstance(data, bool):
        unit = unit_of(notes)
        hint = ""
        if isinstance(data, str) and unit and data.rstrip().endswith(unit):
            hint = f"; write the number alone, in {unit}"
        return out.add(at, f"{describe(data)} is not a number{_say_allowed(notes)}{hint}")
    try:
        number = float(data)
    except OverflowError:
        return out.add(at, f"is too large for a number{_say_allowed(notes)}")
    if not math.isfinite(number):
        return out.add(at, f"{number} is not a finite number{_say_allowed(notes)}")
    return _limit(number, at, out, notes)


def _limit(number: int | float, at: KeyPath, out: Reading, notes: tuple[Any, ...]) -> Any:
    for note in notes:
        if (
            (isinstance(note, Gt) and not number > note.gt)  # type: ignore[operator]
            or (isinstance(note, Ge) and not number >= note.ge)  # type: ignore[operator]
            or (isinstance(note, Lt) and not number < note.lt)  # type: ignore[operator]
            or (isinstance(note, Le) and not number <= note.le)  # type: ignore[operator]
        ):
            unit = unit_of(notes)
            shown = f"{describe(number)} {unit}" if unit else describe(number)
            return out.add(at, f"{shown} is out of range; allowed: {limits_of(notes)}")
    if word := _explain_reach(number, notes):
        return out.add(at, word)
    return number


def _explain_reach(number: int | float, notes: tuple[Any, ...]) -> str | None:
    """Why a number within its own limits still cannot be computed with: see bus/units.py, REACH."""
    unit = unit_of(notes)
    shown = f"{describe(number)} {unit}" if unit else describe(number)
    if isinstance(number, int):
        bounded = any(isinstance(note, Le | Lt) for note in notes)
        far = abs(number) > WHOLE_REACH and not bounded
        return f"{shown} is out of reach; its magnitude can be at most {WHOLE_REACH}" if far else None
    reach = REACH.get(unit, ANY_REACH)
    if abs(number) > reach.most:
        return f"{shown} is out of reach; its magnitude can be at most {reach.most:g}"
    if number < reach.least and any(isinstance(note, Gt) for note in notes):
        return f"{shown} is out of reach; it must be at least {reach.least:g}"
    return None


def _note_parts(value: Any, at: KeyPath, out: Reading) -> None:
    out.parts[at] = value
    if dataclasses.is_dataclass(value):
        for item in dataclasses.fields(value):
            _note_parts(getattr(value, item.name), (*at, item.name), out)


# -- words of messages ---------------------------------------------------------------------------------------------


def _say_unknown(guess: str | None, known: dict[str, tuple[Any, Any]]) -> str:
    if guess is None:
        return f"is not a known key; there are: {', '.join(known)}"
    unit = find_unit(known[guess][0])
    return f'is not a known key; did you mean "{guess}"{f" [{unit}]" if unit else ""}?'


def _say_allowed(notes: tuple[Any, ...]) -> str:
    unit, limits = unit_of(notes), limits_of(notes)
    return (f" [{unit}]" if unit else "") + (f"; allowed: {limits}" if limits else "")


def all_notes(kind: Any) -> tuple[Any, ...]:
    """Everything that is said of a type, through unions with None."""
    kind, notes = strip_annotations(kind)
    for member in branches_of(kind):
        if member is not kind:
            notes = notes + all_notes(member)
    return notes
