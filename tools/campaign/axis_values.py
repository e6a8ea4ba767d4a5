"""Values that an axis of a campaign is written with: lists of anything, named cases, weights, two ends."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any, Final

from bus.settings import INVALID, KeyPath, Reading
from bus.units import ANY_REACH
from bus.words import describe

LONGEST_LABEL: Final = 60
MOST: Final = 10_000


def name_value(value: Any) -> str:
    """What a value is called in tables."""
    if isinstance(value, str):
        return value if len(value) <= LONGEST_LABEL else value[: LONGEST_LABEL - 3] + "..."
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list) and value and all(isinstance(item, float | int) for item in value):
        return "[" + ", ".join(f"{item:.4g}" for item in value) + "]"
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= LONGEST_LABEL else text[: LONGEST_LABEL - 3] + "..."


@dataclass(frozen=True, slots=True)
class Listed:
    """A list of anything, each with its label."""

    items: tuple[tuple[str, Any], ...]

    @classmethod
    def read_settings(cls, data: object, at: KeyPath, out: Reading) -> Any:
        """The values of a list, INVALID where it is none."""
        if not isinstance(data, list):
            return out.add(at, f"{describe(data)} where a list of values is needed")
        if not data:
            return out.add(at, "is empty: no run would come of it")
        if len(data) > MOST:
            return out.add(at, f"has {len(data)} values; at most {MOST}")
        labels = [name_value(value) for value in data]
        if len(set(labels)) < len(labels):  # told apart by all of their digits, or by their number
            labels = [repr(v) if isinstance(v, float) else label for v, label in zip(data, labels, strict=True)]
        sound = True
        first: dict[str, int] = {}
        for index, (label, value) in enumerate(zip(labels, data, strict=True)):
            if label in first:
                if value == data[first[label]]:
                    out.add((*at, index), f"{label} is there twice; the first is entry {first[label]}")
                else:
                    out.add((*at, index), f"looks like entry {first[label]} in tables; give them names: `cases`")
                sound = False
            first.setdefault(label, index)
        return cls(tuple(zip(labels, data, strict=True))) if sound else INVALID

    def plain_settings(self) -> list[Any]:
        """The list."""
        return [value for _, value in self.items]


@dataclass(frozen=True, slots=True)
class Cases:
    """Values with a label each."""

    items: tuple[tuple[str, Any], ...]

    @classmethod
    def read_settings(cls, data: object, at: KeyPath, out: Reading) -> Any:
        """The cases of a mapping, INVALID where it is none."""
        if not isinstance(data, dict) or not data:
            return out.add(at, f"{describe(data)} where a mapping is needed: label -> value, one or more")
        if len(data) > MOST:
            return out.add(at, f"has {len(data)} cases; at most {MOST}")
        for label in data:
            if len(str(label)) > LONGEST_LABEL:
                return out.add((*at, label), f"is longer than {LONGEST_LABEL} characters", at_key=True)
        return cls(tuple((str(label), value) for label, value in data.items()))

    def plain_settings(self) -> dict[str, Any]:
        """The mapping."""
        return dict(self.items)


@dataclass(frozen=True, slots=True)
class Shares:
    """Labels and how likely each is, up to a common factor."""

    labels: tuple[str, ...]
    weights: tuple[float, ...]

    @classmethod
    def read_settings(cls, data: object, at: KeyPath, out: Reading) -> Any:
        """The weights of a mapping, INVALID where they are none."""
        if not isinstance(data, dict) or not data:
            return out.add(at, f"{describe(data)} where a mapping is needed: label -> weight, one or more")
        wrong = [label for label, weight in data.items() if not (is_number(weight) and 0 <= weight <= 1e9)]
        for label in wrong:
            out.add((*at, label), f"{describe(data[label])} is not a weight: a number from 0 to 1e9")
        if wrong:
            return INVALID
        if not any(data.values()):
            return out.add(at, "has no weight above 0")
        return cls(tuple(map(str, data)), tuple(map(float, data.values())))

    def plain_settings(self) -> dict[str, float]:
        """The mapping."""
        return dict(zip(self.labels, self.weights, strict=True))


class Ends(tuple[float, float]):
    """Lower and upper end; whole numbers stay whole."""

    __slots__ = ()

    @classmethod
    def read_settings(cls, data: object, at: KeyPath, out: Reading) -> Any:
        """The two numbers of a list, INVALID where they are none."""
        if not isinstance(data, list) or len(data) != 2:
            return out.add(at, f"{describe(data)} where a list of two numbers is needed: [lower, upper]")
        sound = True
        for index, number in enumerate(data):
            if not is_number(number):
                out.add((*at, index), f"{describe(number)} is not a finite number")
                sound = False
            elif abs(number) > ANY_REACH.most and not isinstance(number, int):
                out.add((*at, index), f"{number:g} is out of reach; its magnitude can be at most {ANY_REACH.most:g}")
                sound = False
            elif abs(number) > 2**53:
                out.add((*at, index), f"{describe(number)} is out of reach; its magnitude can be at most 2**53")
                sound = False
        if not sound:
            return INVALID
        if not data[0] < data[1]:
            return out.add((*at, 1), f"{data[1]} is not above the lower end, {data[0]}")
        return cls((data[0], data[1]))

    def plain_settings(self) -> list[float]:
        """The list."""
        return list(self)


def is_number(value: Any) -> bool:
    """Whether a value is a finite number."""
    if isinstance(value, float):
        return math.isfinite(value)
    return isinstance(value, int) and not isinstance(value, bool)
