"""Axes of a campaign that are lists: gone through value by value, each under its label."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, Literal

from bus.settings import KeyPath
from bus.texts import Text
from bus.units import Ge, Le, Positive
from tools.campaign import draws
from tools.campaign.axis_values import Cases, Ends, Listed, name_value

MOST_LISTED: Final = 10_000  # values of one axis


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """What every axis may say."""

    unit: Annotated[str, Text(40)] = ""  # of its values, for tables and reports
    key: Annotated[str, Text(200)] = ""  # key of the scenario that it sets, as --set takes it; else `$axis` under `set`

    width: ClassVar[int] = 1  # numbers that one draw takes

    def explain(self) -> tuple[KeyPath, str] | None:
        """What is wrong between its keys."""
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class ListAxis(Axis):
    """An axis that has so many values."""

    def list_items(self) -> tuple[tuple[str, Any], ...]:
        """Label and value of each, in order."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True, kw_only=True)
class Values(ListAxis):
    """These values, whatever they are."""

    values: Listed  # one or more

    def list_items(self) -> tuple[tuple[str, Any], ...]:
        """Label and value of each, in order."""
        return self.values.items


@dataclass(frozen=True, slots=True, kw_only=True)
class Range(ListAxis):
    """Numbers from one end to the other, both included."""

    range: Ends  # first and last
    step: Positive | None = None  # from each to the next; or
    count: Annotated[int, Ge(2), Le(MOST_LISTED)] | None = None  # how many
    spacing: Literal["even", "log"] = "even"  # log: the same factor from each to the next

    def explain(self) -> tuple[KeyPath, str] | None:
        """What is wrong between its keys."""
        lower, upper = self.range
        if (self.step is None) == (self.count is None):
            return ("range",), "needs step or count, one of them"
        if self.step is not None and (upper - lower) / self.step > MOST_LISTED:
            return ("step",), f"{self.step:g} makes {(upper - lower) / self.step:.3g} values; at most {MOST_LISTED}"
        if self.step is not None and (rest := (upper - lower) / self.step % 1.0) > 1e-6 and rest < 1.0 - 1e-6:
            last = lower + math.floor((upper - lower) / self.step) * self.step
            return ("step",), f"{self.step:g} does not go from {lower:g} to {upper:g}: the last value would be {last:g}"
        if self.spacing == "log" and (lower <= 0 or self.step is not None):
            return ("spacing",), "log goes with count, between ends above 0"
        return None

    def list_items(self) -> tuple[tuple[str, Any], ...]:
        """Label and value of each, in order."""
        lower, upper = self.range
        if self.step is not None:
            count = math.floor((upper - lower) / self.step + 1e-9) + 1
            numbers = [lower + index * self.step for index in range(count)]
        else:
            shares = [index / ((self.count or 2) - 1) for index in range(self.count or 2)]
            is_log = self.spacing == "log"
            numbers = [lower * (upper / lower) ** s if is_log else lower + s * (upper - lower) for s in shares]
        values: list[Any] = [draws.round_all(float(number)) for number in numbers]
        if isinstance(lower, int) and isinstance(upper, int) and all(value == round(value) for value in values):
            values = [round(value) for value in values]
        return tuple((name_value(value), value) for value in values)


@dataclass(frozen=True, slots=True, kw_only=True)
class CasesAxis(ListAxis):
    """Values with a name each, such as mappings of several keys."""

    cases: Cases  # label -> value

    def list_items(self) -> tuple[tuple[str, Any], ...]:
        """Label and value of each, in order."""
        return self.cases.items
