"""Expectations: what a run must show to pass. Graded after the run, from its log alone.

Signal
    An expression over logged signals. `truth.attitude.error_deg` is field `error_deg` of topic /truth/attitude. It may
    use numbers, + - * / **, brackets, an index `[0]` into a vector, and the functions in SIGNAL_FUNCTIONS. A vector and
    a number combine element by element. The result must be one number per sample. Signals of one topic share their
    time stamps; where topics of different rates meet, the slower one's stamps are used and the other's last value
    before or at each of them.

After
    Without it, times count from the start of the run. With `after: fault NAME` they count from the first effect of the fault
    with that id, or of the first fault of that unit or kind to have one; with `after: event WORDS` from the first line of
    /events that has these words in it. What did not happen is not executed, never passed.

Window
    Samples with from_s <= t <= until_s, in simulated seconds; `until_s` left out: to the end of the run. A window
    without a sample fails. A sample that is not a number (NaN) fails.

Margin
    How far the graded value is from its bound, in the bound's unit, or in seconds where a time is graded; negative:
    failed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from bus.texts import SignalText, Text
from bus.units import Ge, Gt, NonNegative, Positive, Seconds

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
Duration = Annotated[Seconds, Gt(0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """What every expectation says: which signal, over which window, and where the figure comes from."""

    name: Annotated[str, Text(120)]  # the requirement, as the report shows it
    id: Annotated[str, Text(40)] | None = None  # of a requirement that others refer to, such as ADCS-012
    text: Annotated[str, Text(400)] = ""  # the requirement in full, as its document has it
    severity: Literal["high", "medium", "low"] | None = None  # for reports; whatever it is, a fail is a fail
    signal: SignalText  # expression, see docs/scenarios.md
    from_s: Time = 0.0  # start of the window
    until_s: Duration | None = None  # end of the window; None: end of the run
    after: Annotated[str, Text(200)] | None = None  # `fault NAME` or `event WORDS`: from when all times here count
    unit: Annotated[str, Text(40)] = ""  # of the signal and of what it is compared with, for the report
    source: Annotated[str, Text(400)] = ""  # where the figure comes from, as a paper is cited


@dataclass(frozen=True, slots=True, kw_only=True)
class Held(Judged):
    """What a condition that may have to hold for a while says beside that."""

    by_s: Time | None = None  # the hold starts at the latest
    for_s: Duration | None = None  # the hold lasts at least


@dataclass(frozen=True, slots=True, kw_only=True)
class Settles(Judged):
    """|signal| comes to stay within `bound`.

    Settling time: the time of the last sample of the window with |signal| > bound; from_s if there is none. A window
    whose very last sample is above the bound has not settled, which fails. Passes when the settling time is
    <= by_s and >= not_before_s (each if given), and within tolerance_s of at_s (if given). Margin in seconds.
    At least one of by_s, not_before_s, at_s must be given; at_s and tolerance_s go together.
    """

    check: Literal["settles"]
    bound: Positive  # largest |signal| that counts as settled
    by_s: Duration | None = None  # settled at the latest
    not_before_s: Time | None = None  # settled at the earliest
    at_s: Time | None = None  # a published settling time to reproduce
    tolerance_s: Annotated[Seconds, Gt(0)] | None = None  # how far from at_s it may be


@dataclass(frozen=True, slots=True, kw_only=True)
class Below(Held):
    """signal <= bound (the signed value: write abs(...) for a magnitude).

    Without by_s and for_s: at every sample of the window; margin = bound - largest value.
    With by_s and/or for_s: from some sample at t0 on, from_s <= t0 <= by_s (by_s left out: until_s), the condition
    holds at every sample up to t0 + for_s (for_s left out: up to until_s). A hold that the window cuts short does
    not count. Margin in seconds: by_s - earliest t0 when by_s is given, else longest hold - for_s.
    """

    check: Literal["below"]
    bound: float  # signal <= bound


@dataclass(frozen=True, slots=True, kw_only=True)
class Above(Held):
    """signal >= bound. Holds, windows and margins as for `below`, with the sign turned."""

    check: Literal["above"]
    bound: float  # signal >= bound


@dataclass(frozen=True, slots=True, kw_only=True)
class Within(Held):
    """lower <= signal <= upper. Holds and windows as for `below`; margin = the smaller distance to either bound."""

    check: Literal["within"]
    lower: float  # smallest allowed value
    upper: float  # largest allowed value


@dataclass(frozen=True, slots=True, kw_only=True)
class Equals(Held):
    """|signal - value| <= tolerance. Holds and windows as for `below`; margin = tolerance - largest difference."""

    check: Literal["equals"]
    value: float  # what the signal must be
    tolerance: NonNegative = 0.0  # how far from it the signal may be


@dataclass(frozen=True, slots=True, kw_only=True)
class RmsBelow(Judged):
    """Root mean square of the signal over the samples of the window <= bound. Margin = bound - rms."""

    check: Literal["rms_below"]
    bound: Positive  # largest rms


@dataclass(frozen=True, slots=True, kw_only=True)
class RmsEquals(Judged):
    """|rms - value| <= tolerance, for a published rms to reproduce. Margin = tolerance - |rms - value|."""

    check: Literal["rms_equals"]
    value: Positive  # the published rms
    tolerance: Positive  # how far from it the rms may be


Expectation = Settles | Below | Above | Within | Equals | RmsBelow | RmsEquals
Holding = Below | Above | Within | Equals  # those that know by_s and for_s
