"""Two logs signal by signal: which differ by more than is allowed, where first, and by how much.

What is allowed is a tolerance per unit; where a unit has none, signals must be equal to the bit. Both logs' records of a
topic are compared in their order, up to the first whose stamps are not the same.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bus.errors import RecordError, UsageError
from bus.words import suggest
from tools.log.mcap_reader import Run
from tools.log.topics import TopicInfo

SUFFIXES: Final = (  # of names, as they end where the log says no unit; the longest counts
    "rad_s2", "rad_s", "rad", "deg_s2", "deg_s", "deg", "nms", "nm", "kgm2", "us", "ns", "s", "hz", "v", "a", "w", "k",
)  # fmt: skip
DIMENSIONLESS: Final = "1"


@dataclass(frozen=True, slots=True)
class SignalDifference:
    """How one signal of two logs differs."""

    topic: str
    field: str
    unit: str  # as tolerances name it
    count: int  # records in which it differs by more than is allowed
    row: int  # the first of them; of none: the one that differs most
    t_s: float
    largest: float  # largest |difference|; infinite where one side is no number


@dataclass(frozen=True, slots=True)
class Allowance:
    """What two logs may differ in. Units as in the names of signals: rad_s, nm, deg; 1 for none."""

    tolerances: Mapping[str, float]
    ignored: Sequence[str]  # topics and signals, written fsw.control and fsw.control.margin

    def ignores(self, topic: str, field: str = "") -> bool:
        """Whether a topic, or a signal of it, does not count."""
        dotted = name_topic(topic)
        return dotted in self.ignored or (bool(field) and f"{dotted}.{field}" in self.ignored)


EXACT: Final = Allowance({}, ())


def name_topic(topic: str) -> str:
    """A topic as expressions write it: /fsw/control is fsw.control."""
    return topic.strip("/").replace("/", ".")


def parse_allowance(tolerances: Iterable[str], ignored: Iterable[str], runs: Sequence[Run]) -> Allowance:
    """What the words of the command line allow.

    Raises UsageError for what is no `UNIT=NUMBER`, and for units, topics and signals that neither log has.
    """
    signals: dict[str, list[str]] = {}
    for run in runs:
        for name, info in run.topics.items():
            signals.setdefault(name_topic(name), []).extend(_fields_of(run, info) or _properties_of(info))
    units = {unit_of(info, f) for run in runs for info in run.topics.values() for f in _fields_of(run, info)}
    found: dict[str, float] = {}
    for word in tolerances:
        name, _, number = word.partition("=")
        unit = write_unit(name)
        try:
            value = float(number)
        except ValueError:
            value = -1.0
        if not 0.0 <= value < float("inf"):
            raise UsageError(f"--tolerance {word}: takes UNIT=NUMBER with a number >= 0, such as rad_s=1e-9")
        if unit not in units:
            hint = suggest(unit, units)
            raise UsageError(
                f"--tolerance {word}: no signal has the unit {name}; {hint}there are: {', '.join(sorted(units))}"
            )
        found[unit] = value
    names = [name_topic(word) for word in ignored]
    for name in names:
        topic, _, field = name.rpartition(".")
        if name not in signals and field not in signals.get(topic, ()):
            known = signals.get(topic) or list(signals)
            hint = suggest(field if topic in signals else name, known)
            raise UsageError(f"--ignore {name}: neither log has it; {hint}there are: {', '.join(sorted(set(known)))}")
    return Allowance(found, names)


def _fields_of(run: Run, info: TopicInfo) -> tuple[str, ...]:
    try:
        return run.signals(info.name).fields
    except RecordError:  # JSON, or not of fixed size
        return ()


def _properties_of(info: TopicInfo) -> list[str]:
    """The fields of a topic of JSON objects, as far as its schema names them."""
    try:
        return list(json.loads(info.schema)["properties"])
    except (ValueError, TypeError, KeyError, RecursionError):
        return []


def write_unit(unit: str) -> str:
    """A unit as names of signals end with it: rad/s is rad_s, N m is nm; 1 for none."""
    return unit.replace("/", "_").replace(" ", "").replace("^", "").lower() or DIMENSIONLESS


def unit_of(info: TopicInfo, field: str) -> str:
    """The unit of a signal: what the log says, else how its name ends."""
    unit = write_unit(info.units.get(field, ""))
    if unit != DIMENSIONLESS:
        return unit
    ends = [suffix for suffix in SUFFIXES if field.endswith(f"_{suffix}") or field == suffix]
    return max(ends, key=len, default=DIMENSIONLESS)


def compare_signals(a: Run, b: Run, topic: str, allowed: Allowance) -> list[SignalDifference]:
    """Every signal of a topic that differs at all, also within what is allowed, in the topic's order.

    Raises RecordError where a log's records of it cannot be read.
    """
    mine, theirs = a.signals(topic), b.signals(topic)
    fields = [field for field in mine.fields if field in theirs.fields and not allowed.ignores(topic, field)]
    a.prefetch({topic: fields})
    b.prefetch({topic: fields})
    rows = count_alike(a, b, topic)
    if not rows:
        return []
    stamps_ns = a.t_ns(topic)[:rows]
    found = []
    for field in fields:
        unit = unit_of(a.topics[topic], field)
        one, two = mine[field][:rows], theirs[field][:rows]
        if one.shape[1:] != two.shape[1:] or one.dtype != two.dtype:
            raise RecordError(f"{b.path}: {topic}.{field} is laid out otherwise than in {a.path}")
        differs = _differ(one, two)
        if not differs.any():
            continue
        size = _measure(one, two)
        tolerance = allowed.tolerances.get(unit)
        beyond = differs if tolerance is None else size > tolerance
        row = int(np.argmax(beyond)) if beyond.any() else int(np.argmax(size))
        largest = float(size.max())
        found.append(
            SignalDifference(topic, field, unit, int(beyond.sum()), row, float(stamps_ns[row]) * 1e-9, largest)
        )
    return found


def count_alike(a: Run, b: Run, topic: str) -> int:
    """How many records of a topic have the same stamps in both logs, from the first on."""
    one, two = a.t_ns(topic), b.t_ns(topic)
    rows = min(one.size, two.size)
    other = np.flatnonzero(one[:rows] != two[:rows])
    return int(other[0]) if other.size else rows


def _rows_of(values: NDArray[Any]) -> NDArray[Any]:
    return values.reshape(values.shape[0], -1)


def _differ(one: NDArray[Any], two: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether each record differs in any bit; NaN is NaN whatever its bits."""
    bits = f"u{one.dtype.itemsize}"
    other = _rows_of(np.ascontiguousarray(one).view(bits) != np.ascontiguousarray(two).view(bits))
    if one.dtype.kind == "f":
        other &= ~(_rows_of(np.isnan(one)) & _rows_of(np.isnan(two)))
    return np.asarray(other.any(axis=1))


def _measure(one: NDArray[Any], two: NDArray[Any]) -> NDArray[np.float64]:
    """Largest |difference| of each record; infinite where one side alone is no number."""
    with np.errstate(all="ignore"):
        size = np.abs(_rows_of(one).astype(np.float64) - _rows_of(two).astype(np.float64))
    if one.dtype.kind == "f":
        both = _rows_of(np.isnan(one)) & _rows_of(np.isnan(two))
        size = np.where(both | (_rows_of(one) == _rows_of(two)), 0.0, size)
    return np.asarray(np.where(np.isnan(size), np.inf, size).max(axis=1, initial=0.0))
