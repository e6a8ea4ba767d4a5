"""Expectations: what a run must show to pass. Graded after the run, from its log alone.

Signal
    An expression over logged signals. `truth.attitude.error_deg` is field `error_deg` of topic /truth/attitude. It may
    use numbers, + - * / **, brackets, an index `[0]` into a vector, and the functions in SIGNAL_FUNCTIONS. A vector and
    a number combine element by element. The result must be one number per sample. Signals of one topic share their
    time stamps; where topics of different rates meet, the slower one's stamps are used and the other's last value
    before or at each of them.

Window
    Samples with from_s <= t <= until_s, in simulated seconds; `until_s` left out: to the end of the run. A window
    without a sample fails. A sample that is not a number (NaN) fails.

Margin
    How far the graded value is from its bound, in the bound's unit, or in seconds where a time is graded; negative:
    failed.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass
from typing import Annotated, Literal

from bus.units import Ge, Gt, NonNegative, Positive, Seconds
from tools.config.signal_names import check_names

# name -> what it gives, for messages and documents; the grader implements exactly these
SIGNAL_FUNCTIONS: dict[str, str] = {
    "norm": "length of a vector (square root of the sum of squares)",
    "abs": "magnitude, element by element",
    "min": "smallest element of a vector",
    "max": "largest element of a vector",
    "sum": "sum of the elements of a vector",
    "deg": "radians to degrees",
    "rad": "degrees to radians",
    "sqrt": "square root, element by element",
    "rate": "change per second from the sample before (0 at the first)",
}

Time = Annotated[Seconds, Ge(0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Settles:
    """|signal| comes to stay within `bound`.

    Settling time: the time of the last sample of the window with |signal| > bound; from_s if there is none. A window
    whose very last sample is above the bound has not settled, which fails. Passes when the settling time is
    <= by_s and >= not_before_s (each if given), and within tolerance_s of at_s (if given). Margin in seconds.
    At least one of by_s, not_before_s, at_s must be given; at_s and tolerance_s go together.
    """

    check: Literal["settles"]
    name: str  # the requirement, as the report shows it
    signal: str  # expression, see docs/scenarios.md
    bound: Positive  # largest |signal| that counts as settled
    by_s: Annotated[Seconds, Gt(0)] | None = None  # settled at the latest
    not_before_s: Time | None = None  # settled at the earliest
    at_s: Time | None = None  # a published settling time to reproduce
    tolerance_s: Positive | None = None  # how far from at_s it may be [s]
    from_s: Time = 0.0  # start of the window
    until_s: Annotated[Seconds, Gt(0)] | None = None  # end of the window; None: end of the run
    unit: str = ""  # of signal and bound, for the report
    source: str = ""  # where the figure comes from, as a paper is cited


@dataclass(frozen=True, slots=True, kw_only=True)
class Below:
    """signal <= bound (the signed value: write abs(...) for a magnitude).

    Without by_s and for_s: at every sample of the window; margin = bound - largest value.
    With by_s and/or for_s: from some sample at t0 on, from_s <= t0 <= by_s (by_s left out: until_s), the condition
    holds at every sample up to t0 + for_s (for_s left out: up to until_s). A hold that the window cuts short does
    not count. Margin in seconds: by_s - earliest t0 when by_s is given, else longest hold - for_s.
    """

    check: Literal["below"]
    name: str  # the requirement, as the report shows it
    signal: str  # expression, see docs/scenarios.md
    bound: float  # signal <= bound
    by_s: Time | None = None  # the hold starts at the latest
    for_s: Annotated[Seconds, Gt(0)] | None = None  # the hold lasts at least
    from_s: Time = 0.0  # start of the window
    until_s: Annotated[Seconds, Gt(0)] | None = None  # end of the window; None: end of the run
    unit: str = ""  # of signal and bound, for the report
    source: str = ""  # where the figure comes from, as a paper is cited


@dataclass(frozen=True, slots=True, kw_only=True)
class Above:
    """signal >= bound. Holds, windows and margins as for `below`, with the sign turned."""

    check: Literal["above"]
    name: str  # the requirement, as the report shows it
    signal: str  # expression, see docs/scenarios.md
    bound: float  # signal >= bound
    by_s: Time | None = None  # the hold starts at the latest
    for_s: Annotated[Seconds, Gt(0)] | None = None  # the hold lasts at least
    from_s: Time = 0.0  # start of the window
    until_s: Annotated[Seconds, Gt(0)] | None = None  # end of the window; None: end of the run
    unit: str = ""  # of signal and bound, for the report
    source: str = ""  # where the figure comes from, as a paper is cited


@dataclass(frozen=True, slots=True, kw_only=True)
class Within:
    """lower <= signal <= upper. Holds and windows as for `below`; margin = the smaller distance to either bound."""

    check: Literal["within"]
    name: str  # the requirement, as the report shows it
    signal: str  # expression, see docs/scenarios.md
    lower: float  # smallest allowed value
    upper: float  # largest allowed value
    by_s: Time | None = None  # the hold starts at the latest
    for_s: Annotated[Seconds, Gt(0)] | None = None  # the hold lasts at least
    from_s: Time = 0.0  # start of the window
    until_s: Annotated[Seconds, Gt(0)] | None = None  # end of the window; None: end of the run
    unit: str = ""  # of signal and bounds, for the report
    source: str = ""  # where the figure comes from, as a paper is cited


@dataclass(frozen=True, slots=True, kw_only=True)
class Equals:
    """|signal - value| <= tolerance. Holds and windows as for `below`; margin = tolerance - largest difference."""

    check: Literal["equals"]
    name: str  # the requirement, as the report shows it
    signal: str  # expression, see docs/scenarios.md
    value: float  # what the signal must be
    tolerance: NonNegative = 0.0  # how far from it the signal may be
    by_s: Time | None = None  # the hold starts at the latest
    for_s: Annotated[Seconds, Gt(0)] | None = None  # the hold lasts at least
    from_s: Time = 0.0  # start of the window
    until_s: Annotated[Seconds, Gt(0)] | None = None  # end of the window; None: end of the run
    unit: str = ""  # of signal and value, for the report
    source: str = ""  # where the figure comes from, as a paper is cited


@dataclass(frozen=True, slots=True, kw_only=True)
class RmsBelow:
    """Root mean square of the signal over the samples of the window <= bound. Margin = bound - rms."""

    check: Literal["rms_below"]
    name: str  # the requirement, as the report shows it
    signal: str  # expression, see docs/scenarios.md
    bound: Positive  # largest rms
    from_s: Time = 0.0  # start of the window
    until_s: Annotated[Seconds, Gt(0)] | None = None  # end of the window; None: end of the run
    unit: str = ""  # of signal and bound, for the report
    source: str = ""  # where the figure comes from, as a paper is cited


@dataclass(frozen=True, slots=True, kw_only=True)
class RmsEquals:
    """|rms - value| <= tolerance, for a published rms to reproduce. Margin = tolerance - |rms - value|."""

    check: Literal["rms_equals"]
    name: str  # the requirement, as the report shows it
    signal: str  # expression, see docs/scenarios.md
    value: Positive  # the published rms
    tolerance: Positive  # how far from it the rms may be
    from_s: Time = 0.0  # start of the window
    until_s: Annotated[Seconds, Gt(0)] | None = None  # end of the window; None: end of the run
    unit: str = ""  # of signal and value, for the report
    source: str = ""  # where the figure comes from, as a paper is cited


Expectation = Settles | Below | Above | Within | Equals | RmsBelow | RmsEquals
Holding = Below | Above | Within | Equals  # those that know by_s and for_s


def check_expectation(item: Expectation, duration_s: float | None) -> list[tuple[str, str]]:
    """What is wrong with an expectation beyond its single values: (key, message) for each."""
    problems = check_signal(item.signal)
    if isinstance(item, Settles):
        if item.by_s is None and item.not_before_s is None and item.at_s is None:
            problems.append(("check", "settles needs by_s, not_before_s or at_s"))
        if (item.at_s is None) != (item.tolerance_s is None):
            problems.append(("at_s", "at_s and tolerance_s go together"))
    if isinstance(item, Within) and item.lower > item.upper:
        problems.append(("lower", f"{item.lower} is above upper, {item.upper}"))
    return problems + _check_times(item, duration_s)


def _check_times(item: Expectation, duration_s: float | None) -> list[tuple[str, str]]:
    problems = []
    end_s = item.until_s if item.until_s is not None else duration_s
    if duration_s is not None:
        for key in ("from_s", "until_s", "by_s", "at_s", "not_before_s"):
            value = getattr(item, key, None)
            if value is not None and value > duration_s:
                problems.append((key, f"{value} s is after the end of the run, {duration_s} s"))
    if end_s is not None and item.from_s >= end_s and (duration_s is None or item.from_s <= duration_s):
        problems.append(("from_s", f"the window is empty: it starts at {item.from_s} s and ends at {end_s} s"))
    if isinstance(item, Below | Above | Within | Equals):
        if item.by_s is not None and item.by_s < item.from_s:
            problems.append(("by_s", f"{item.by_s} s is before the window starts, {item.from_s} s"))
        if item.for_s is not None and end_s is not None and item.from_s + item.for_s > end_s > item.from_s:
            problems.append(("for_s", f"{item.for_s} s does not fit into the window, {item.from_s} to {end_s} s"))
    return problems


_ALLOWED_NODES = (
    ast.Expression, ast.BinOp, ast.UnaryOp, ast.Call, ast.Attribute, ast.Name, ast.Load, ast.Constant, ast.Subscript,
    ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow, ast.USub, ast.UAdd,
)  # fmt: skip


def check_signal(signal: str) -> list[tuple[str, str]]:
    """What is wrong with a signal expression: (key, message) for each."""
    try:
        tree = ast.parse(signal.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        return [("signal", f"is not an expression: {getattr(error, 'msg', error)}")]
    problems = []
    functions = set()
    for node in ast.walk(tree):
        if not isinstance(node, _ALLOWED_NODES):
            problems.append(("signal", f"{type(node).__name__} is not allowed; use + - * / ** [index] and functions"))
        elif isinstance(node, ast.Constant) and type(node.value) not in (int, float):
            problems.append(("signal", f"{node.value!r} is not a number"))
        elif isinstance(node, ast.Call):
            if isinstance(node.func, ast.Name) and len(node.args) == 1 and not node.keywords:
                functions.add(node.func.id)
            else:
                problems.append(("signal", "a function is called by its name, with one argument"))
        elif isinstance(node, ast.Subscript) and not (
            isinstance(node.slice, ast.Constant) and type(node.slice.value) is int
        ):
            problems.append(("signal", "an index is a whole number"))
    choices = ", ".join(SIGNAL_FUNCTIONS)
    unknown = sorted(functions - set(SIGNAL_FUNCTIONS))
    problems += [("signal", f"function {name} is not known; there are: {choices}") for name in unknown]
    if not any(isinstance(node, ast.Attribute) for node in ast.walk(tree)):
        problems.append(("signal", "names no logged signal, such as truth.attitude.error_deg"))
    return problems or [("signal", word) for word in check_names(signal)]
