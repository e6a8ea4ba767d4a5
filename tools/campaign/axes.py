"""Axes of a campaign: what its runs differ in. Lists are gone through, the others are drawn.

An axis is a list of values, or a mapping with one of the keys of KINDS, which says what it is.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Final, Literal

from bus.settings import INVALID, KeyPath, Reading, fields_of, read_keys
from bus.texts import Text
from bus.units import DEG, Deg, Ge, Gt, Le, Positive, Seconds
from bus.words import describe
from tools.campaign import draws
from tools.campaign.axis_values import Cases, Ends, Listed, Shares, name_value

MOST_LISTED: Final = 10_000  # values of one axis
Formula = Annotated[str, Text(400)]


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
class DrawnAxis(Axis):
    """An axis whose values are drawn."""

    common: Annotated[str, Text(80)] | None = None  # axes with the same word here share their draw: they are correlated

    def draw(self, u: Sequence[float]) -> Any:
        """The value at a place of the unit cube of `width` numbers."""
        raise NotImplementedError

    def label(self, value: Any) -> str:
        """What the value is called in tables."""
        return name_value(value)


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Uniform(DrawnAxis):
    """Uniform between two ends."""

    uniform: Ends  # lower, upper

    def draw(self, u: Sequence[float]) -> Any:
        """The value at a place of the unit cube."""
        return draws.draw_uniform(u[0], *self.uniform)


@dataclass(frozen=True, slots=True, kw_only=True)
class LogUniform(DrawnAxis):
    """The logarithm is uniform: every decade as likely."""

    log_uniform: Ends  # lower, upper, above 0

    def explain(self) -> tuple[KeyPath, str] | None:
        """What is wrong between its keys."""
        return None if self.log_uniform[0] > 0 else (("log_uniform", 0), f"{self.log_uniform[0]:g} is not above 0")

    def draw(self, u: Sequence[float]) -> Any:
        """The value at a place of the unit cube."""
        return draws.draw_log_uniform(u[0], *self.log_uniform)


@dataclass(frozen=True, slots=True, kw_only=True)
class Integer(DrawnAxis):
    """A whole number from one end to the other, both included; for seeds, say."""

    integer: Ends  # lower, upper

    def explain(self) -> tuple[KeyPath, str] | None:
        """What is wrong between its keys."""
        if all(isinstance(end, int) for end in self.integer):
            return None
        return ("integer",), f"{self.integer[0]}, {self.integer[1]}: whole numbers are needed"

    def draw(self, u: Sequence[float]) -> Any:
        """The value at a place of the unit cube."""
        return draws.draw_whole(u[0], int(self.integer[0]), int(self.integer[1]))


@dataclass(frozen=True, slots=True, kw_only=True)
class NormalShape:
    """A normal distribution."""

    mean: float = 0.0  # in the unit of the axis
    sigma: Positive = 1.0  # standard deviation


@dataclass(frozen=True, slots=True, kw_only=True)
class Normal(DrawnAxis):
    """Normal, without ends."""

    normal: NormalShape

    def draw(self, u: Sequence[float]) -> Any:
        """The value at a place of the unit cube."""
        return draws.draw_normal(u[0], self.normal.mean, self.normal.sigma)


@dataclass(frozen=True, slots=True, kw_only=True)
class TruncatedShape:
    """A normal distribution on condition that it is between two ends; the mean is that of the whole one."""

    mean: float = 0.0  # in the unit of the axis
    sigma: Positive = 1.0  # standard deviation of the whole one
    lower: float  # smallest value
    upper: float  # largest value


@dataclass(frozen=True, slots=True, kw_only=True)
class TruncatedNormal(DrawnAxis):
    """Normal between two ends."""

    truncated_normal: TruncatedShape

    def explain(self) -> tuple[KeyPath, str] | None:
        """What is wrong between its keys."""
        shape, at = self.truncated_normal, "truncated_normal"
        if shape.upper <= shape.lower:
            return (at, "upper"), f"{shape.upper:g} is not above lower, {shape.lower:g}"
        away = max(shape.lower - shape.mean, shape.mean - shape.upper, 0.0) / shape.sigma
        return ((at, "mean"), f"is {away:.3g} sigma outside of the ends; at most 30") if away > 30.0 else None

    def draw(self, u: Sequence[float]) -> Any:
        """The value at a place of the unit cube."""
        shape = self.truncated_normal
        return draws.draw_truncated_normal(u[0], shape.mean, shape.sigma, shape.lower, shape.upper)


@dataclass(frozen=True, slots=True, kw_only=True)
class Categorical(DrawnAxis):
    """One of several, each as likely as its weight says."""

    categorical: Shares  # label -> weight
    cases: Cases | None = None  # label -> value; None: the labels are the values

    def explain(self) -> tuple[KeyPath, str] | None:
        """What is wrong between its keys."""
        if self.cases is None:
            return None
        weights, cases = set(self.categorical.labels), {label for label, _ in self.cases.items}
        odd = sorted(weights ^ cases)
        return (("cases",), f"does not have the labels of categorical: {', '.join(odd)}") if odd else None

    def draw(self, u: Sequence[float]) -> Any:
        """The value at a place of the unit cube."""
        label = self.categorical.labels[draws.choose(u[0], self.categorical.weights)]
        return label if self.cases is None else dict(self.cases.items)[label]

    def label(self, value: Any) -> str:
        """What the value is called in tables."""
        if self.cases is None:
            return str(value)
        return next((label for label, item in self.cases.items if item == value), name_value(value))


@dataclass(frozen=True, slots=True, kw_only=True)
class TurnShape:
    """A random turn."""

    within_deg: Annotated[Deg, Gt(0), Le(180)] = 180.0  # largest angle of the turn; 180: any attitude, uniform on SO(3)


@dataclass(frozen=True, slots=True, kw_only=True)
class Attitude(DrawnAxis):
    """A unit quaternion, scalar first, uniform on SO(3) among the turns by at most an angle."""

    attitude: TurnShape

    width: ClassVar[int] = 3

    def draw(self, u: Sequence[float]) -> Any:
        """The value at a place of the unit cube."""
        return draws.draw_attitude(u, self.attitude.within_deg * DEG)


@dataclass(frozen=True, slots=True, kw_only=True)
class ArrowShape:
    """A random vector."""

    length: Positive = 1.0  # of the vector, in the unit of the axis


@dataclass(frozen=True, slots=True, kw_only=True)
class Direction(DrawnAxis):
    """A vector of three numbers whose direction is uniform on the sphere: a random axis."""

    direction: ArrowShape

    width: ClassVar[int] = 2

    def draw(self, u: Sequence[float]) -> Any:
        """The value at a place of the unit cube."""
        return draws.draw_direction(u, self.direction.length)


@dataclass(frozen=True, slots=True, kw_only=True)
class ArrivalShape:
    """A Poisson process."""

    rate_per_s: Annotated[float, Gt(0), Le(1e6)]  # events per second, on average
    from_s: Annotated[Seconds, Ge(0)] = 0.0  # when it begins
    until_s: Annotated[Seconds, Gt(0)]  # when it ends


@dataclass(frozen=True, slots=True, kw_only=True)
class Poisson(DrawnAxis):
    """Time of the first event of a Poisson process [s], on condition that it comes within the window."""

    poisson: ArrivalShape

    def explain(self) -> tuple[KeyPath, str] | None:
        """What is wrong between its keys."""
        return explain_window(self.poisson, "poisson")

    def draw(self, u: Sequence[float]) -> Any:
        """The value at a place of the unit cube."""
        return draws.draw_onset(u[0], self.poisson.rate_per_s, self.poisson.from_s, self.poisson.until_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoissonTrain(DrawnAxis):
    """Times of the events of a Poisson process [s]: a list, which may be empty; the first MOST_EVENTS of them."""

    poisson_train: ArrivalShape

    width: ClassVar[int] = 16

    def explain(self) -> tuple[KeyPath, str] | None:
        """What is wrong between its keys."""
        shape = self.poisson_train
        if (expected := shape.rate_per_s * (shape.until_s - shape.from_s)) > 0.25 * self.width:
            return ("poisson_train",), f"{expected:g} events are to be expected; at most {0.25 * self.width:g}"
        return explain_window(shape, "poisson_train")

    def draw(self, u: Sequence[float]) -> Any:
        """The value at a place of the unit cube."""
        shape = self.poisson_train
        return draws.draw_train(u, shape.rate_per_s, shape.from_s, shape.until_s)

    def label(self, value: Any) -> str:
        """What the value is called in tables."""
        return ", ".join(f"{t_s:.4g}" for t_s in value) or "none"


@dataclass(frozen=True, slots=True, kw_only=True)
class Computed(Axis):
    """A number that follows from other axes: an onset some time after another one, a correlation of any strength."""

    formula: Formula  # over other axes, none of them computed


def explain_window(shape: ArrivalShape, at: str) -> tuple[KeyPath, str] | None:
    """What is wrong with the window of a Poisson process."""
    if shape.until_s > shape.from_s:
        return None
    return (at, "until_s"), f"{shape.until_s:g} s is not after from_s, {shape.from_s:g} s"


# key that tells an axis -> what it is; the first that is there counts (`categorical` may have `cases`)
KINDS: Final[dict[str, type[Axis]]] = {
    "values": Values, "range": Range, "categorical": Categorical, "cases": CasesAxis, "uniform": Uniform,
    "log_uniform": LogUniform, "integer": Integer, "normal": Normal, "truncated_normal": TruncatedNormal,
    "attitude": Attitude, "direction": Direction, "poisson": Poisson, "poisson_train": PoissonTrain, "formula": Computed,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Axes:
    """All axes of a campaign, by name."""

    by_name: dict[str, Axis] = field(default_factory=dict)

    @classmethod
    def read_settings(cls, data: object, at: KeyPath, out: Reading) -> Any:
        """The axes of a mapping, INVALID where one is not sound."""
        if not isinstance(data, dict):
            return out.add(at, f"{describe(data)} where a mapping is needed: name of an axis -> its values")
        if len(data) > MOST_AXES:
            return out.add(at, f"has {len(data)} axes; at most {MOST_AXES}")
        found = {str(name): read_axis(name, item, (*at, name), out) for name, item in data.items()}
        return INVALID if any(axis is INVALID for axis in found.values()) else cls(found)

    def plain_settings(self) -> dict[str, Any]:
        """As it was written is what is kept of it; this is only for messages."""
        return {name: json.loads(json.dumps(str(axis))) for name, axis in self.by_name.items()}


MOST_AXES: Final = 60
TAKEN: Final = ("base", "number", "repeat", "run", "seed")  # columns of tables beside the axes
NOT_NAMES: Final = ("and", "or", "not", "in", "is", "if", "else", "for", "lambda", "True", "False", "None")


def read_axis(name: Any, data: object, at: KeyPath, out: Reading) -> Any:
    """One axis, INVALID where it is not sound."""
    if not (isinstance(name, str) and name.isascii() and name.isidentifier() and len(name) <= 40) or name in NOT_NAMES:
        return out.add(at, "is not a name of an axis: letters, digits and underscores, at most 40", at_key=True)
    if name in TAKEN:
        return out.add(at, f"cannot name an axis; these are taken: {', '.join(TAKEN)}", at_key=True)
    if isinstance(data, list):
        data = {"values": data}
        values = Listed.read_settings(data["values"], at, out)
        return INVALID if values is INVALID else Values(values=values)
    if not isinstance(data, dict):
        return out.add(at, f"{describe(data)} where a list of values is needed, or a mapping with: {', '.join(KINDS)}")
    kind = next((word for word in KINDS if word in data), None)
    if kind is None:
        guesses = [(key, guess) for key in data if (guess := out.guess(str(key), KINDS))]
        hint = f' did you mean "{guesses[0][1]}" by {guesses[0][0]}?' if guesses else ""
        return out.add(at, f"does not say what its values are;{hint} there are: {', '.join(KINDS)}")
    chosen: Any = KINDS[kind]
    values = read_keys(fields_of(chosen), data, at, out)
    if any(value is INVALID for value in values.values()):
        return INVALID
    axis: Axis = chosen(**values)
    problem = axis.explain()
    return axis if problem is None else out.add((*at, *problem[0]), problem[1])
