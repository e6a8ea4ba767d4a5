"""Expectations: what a run must show to pass. Graded after the run, from its log alone.

Signal
    An expression over logged signals. `truth.attitude.error_deg` is field `error_deg` of topic /truth/attitude. It may
    use numbers, + - * / **, brackets, an index `[0]` into a vector, and the functions in SIGNAL_FUNCTIONS. A vector and
    a number combine element by element. The result must be one number per sample. Signals of one topic share their
    time stamps; where topics of different rates meet, the slower one's stamps are used and the other's last value
    before or at each of them.

Condition
    A signal expression that compares: `fsw.executive.mode == 4`, `abs(x) > 1`, `0 < x < 2`, several joined by `and`, `or`,
    `not`. As a signal it is 1 where it holds and 0 where not; where a number in it is none, so is the condition.

Fault
    NAME is the id, the unit or the kind of faults, or `wheel.*` for every unit of a family. A fault is in force from its
    onset to its end or its clearing, and takes effect where what it does first changes something.

After
    Without it, times count from the start of the run. With `after: fault NAME` they count from the first effect of such a
    fault; with `after: event WORDS` from the first line of /events that has these words in it. What did not happen is
    not executed, never passed.

Window
    Samples with from_s <= t <= until_s, in simulated seconds; `until_s` left out: to the end of the run. `until: fault N`,
    `until: event WORDS` or `until: CONDITION` ends it sooner: before the first effect of such a fault, the first such line
    or the first sample on which the condition holds, at or behind the start of the window. `when: CONDITION` keeps only
    the samples on which it holds: the condition's last value before or at each. A window without a sample is not
    executed, nor one whose end did not come, nor a sample in it that is not a number (NaN). Two samples of a window are
    neighbours when no sample that `when` leaves out lies between them.

Margin
    How far the graded value is from its bound, in the bound's unit, or in seconds where a time is graded; negative:
    failed.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Literal

from bus.texts import SignalText, Text
from bus.units import Ge, Gt, Le, NonNegative, Positive, Seconds

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
Number = Annotated[int, Ge(0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Required:
    """What every expectation says: what it is called, over which window it holds, and where the figure comes from."""

    name: Annotated[str, Text(120)]  # the requirement, as the report shows it
    id: Annotated[str, Text(40)] | None = None  # of a requirement that others refer to, such as ADCS-012
    text: Annotated[str, Text(400)] = ""  # the requirement in full, as its document has it
    severity: Literal["high", "medium", "low"] | None = None  # for reports; whatever it is, a fail is a fail
    from_s: Time = 0.0  # start of the window
    until_s: Duration | None = None  # end of the window; None: end of the run
    until: Annotated[str, Text(400)] | None = None  # `fault NAME`, `event WORDS` or a condition: what ends the window
    after: Annotated[str, Text(200)] | None = None  # `fault NAME` or `event WORDS`: from when all times here count
    unit: Annotated[str, Text(40)] = ""  # of the signal and of what it is compared with, for the report
    source: Annotated[str, Text(400)] = ""  # where the figure comes from, as a paper is cited


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged(Required):
    """What an expectation of a signal says beside that."""

    signal: SignalText  # expression, see docs/scenarios.md
    when: SignalText | None = None  # condition: only the samples on which it holds count


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Percentile(Judged):
    """`share` percent of the samples are <= bound, for latencies.

    Graded: the smallest sample that at least that share of the samples of the window do not exceed (nearest rank, so that
    it is always one that was measured; of too few samples it is the largest). Margin = bound - that value.
    """

    check: Literal["percentile"]
    share: Annotated[float, Gt(0), Le(100)]  # percent of the samples
    bound: float  # which they do not exceed


@dataclass(frozen=True, slots=True, kw_only=True)
class Count(Judged):
    """How often the signal rises over `bound`, or on how many samples it is over it.

    A rise is a sample of the window over the bound whose neighbour before is not; the first sample counts as one when it
    is over it. Passes when the number is <= at_most and >= at_least (one of them must be given). Margin = the smaller
    distance to either.
    """

    check: Literal["count"]
    bound: float = 0.5  # a condition or a flag needs no other
    of: Literal["rises", "samples"] = "rises"  # what is counted
    at_most: Number | None = None  # how many there may be
    at_least: Number | None = None  # how many there must be


@dataclass(frozen=True, slots=True, kw_only=True)
class Monotonic(Judged):
    """The signal only rises, or only falls: at no sample is it further than `tolerance` behind the best so far.

    Margin = tolerance - the largest way back.
    """

    check: Literal["monotonic"]
    direction: Literal["rising", "falling"]  # staying where it is counts as either
    tolerance: NonNegative = 0.0  # how far back it may go


@dataclass(frozen=True, slots=True, kw_only=True)
class Integral(Judged):
    """Time integral of the signal <= bound: control effort, with `sum(abs(fsw.control.tau_rw_cmd_nm))`.

    Trapezoids between neighbours: what `when` leaves out adds nothing. In the signal's unit times seconds. Margin = bound -
    integral.
    """

    check: Literal["integral"]
    bound: float  # largest integral


@dataclass(frozen=True, slots=True, kw_only=True)
class Mean(Judged):
    """lower <= mean of the samples <= upper, at least one of them given. Of a condition: the share of its samples.

    Margin = the smaller distance to either.
    """

    check: Literal["mean"]
    lower: float | None = None  # smallest mean
    upper: float | None = None  # largest mean


@dataclass(frozen=True, slots=True, kw_only=True)
class Variation(Judged):
    """Total variation of the signal for each second <= bound: how much a torque is moved about.

    Sum of the magnitudes of the changes between neighbours over the sum of the times between them. Margin = bound - that.
    """

    check: Literal["variation"]
    bound: NonNegative  # per second, in the signal's unit


@dataclass(frozen=True, slots=True, kw_only=True)
class EventCount(Required):
    """How many lines of /events within the window have these words in them.

    Passes when the number is <= at_most and >= at_least (one of them must be given). Not executed where the log lacks a
    part of the window. Margin = the smaller distance to either.
    """

    check: Literal["event_count"]
    event: Annotated[str, Text(200)]  # words of the line, as they stand in it
    at_most: Number | None = None  # how many there may be
    at_least: Number | None = None  # how many there must be


@dataclass(frozen=True, slots=True, kw_only=True)
class Detects(Judged):
    """The alarm comes within `within_s` of each fault: no missed detection, and the longest delay.

    The alarm is up where the signal is over `bound`. A fault is detected by the first rise of the alarm at or behind its
    effect; where the alarm is up already because an earlier such fault is in force, at once. An alarm that was up before
    without one has not detected it. Every fault of that name whose effect is in the window counts. Graded: the longest
    delay [s]; a miss fails. Not executed where there was none, where one came on without effect, and where the log ends
    within the delay allowed. Margin = within_s - longest delay.
    """

    check: Literal["detects"]
    fault: Annotated[str, Text(200)]  # id, unit or kind of the faults, or wheel.* for a family
    within_s: Duration  # longest delay
    bound: float = 0.5  # over which the alarm is up


@dataclass(frozen=True, slots=True, kw_only=True)
class Isolates(Judged):
    """The alarm of the unit that is broken comes within `within_s` of each fault, and that of no other unit does.

    The signal is a vector with an alarm a unit, in the order of the units: `fsw.fdi.wheel_alarm`, `fsw.fdi.gyro_state`. The
    faulty unit's element as for `detects`. Another's must not be up from the effect to within_s behind it, or, where that
    is longer, while the fault is in force, unless a fault of that other unit itself is in force or ended less than
    within_s ago. Graded and margin as for `detects`; an alarm of another unit fails.
    """

    check: Literal["isolates"]
    fault: Annotated[str, Text(200)]  # id, unit or kind of the faults, or wheel.* for a family
    within_s: Duration  # longest delay
    bound: float = 0.5  # over which an alarm is up


@dataclass(frozen=True, slots=True, kw_only=True)
class NoFalseAlarm(Judged):
    """The alarm is up only while such a fault is in force, or ended not more than `margin_s` ago.

    Graded: how many samples of the window are over `bound` outside of that; any fails. With `fault` left out every fault
    of the run excuses an alarm. A named fault that did not take effect is not executed. Margin = minus the number.
    """

    check: Literal["no_false_alarm"]
    fault: Annotated[str, Text(200)] | None = None  # id, unit or kind of the faults that excuse an alarm, or wheel.*
    margin_s: Time = 0.0  # how long the alarm may stay when the fault is gone
    bound: float = 0.5  # over which the alarm is up


@dataclass(frozen=True, slots=True, kw_only=True)
class Matches(Judged):
    """The signal differs from that of a reference log, `hilsat grade LOG --against LOG2`, by no more than `tolerance`.

    Sample by sample: both logs must have the same stamps in the window, else it is not executed; nor without a reference
    log. What `when` and `until` say is taken from the graded log. Margin = tolerance - largest difference.
    """

    check: Literal["matches"]
    tolerance: NonNegative = 0.0  # largest |difference|


Holding = Below | Above | Within | Equals  # those that know by_s and for_s
Measuring = (
    RmsBelow | RmsEquals | Percentile | Count | Monotonic | Integral | Mean | Variation
)  # one figure of a window
Alarming = Detects | Isolates | NoFalseAlarm  # those that hold an alarm against the faults
Judging = Settles | Holding | Measuring | Alarming | Matches  # those of a signal
Expectation = Judging | EventCount


def is_name_of(name: str, words: Iterable[str]) -> bool:
    """Whether a fault's id, unit and kind, or those of several, are meant by a name that expectations give."""
    return any(name == word or (name.endswith(".*") and word.startswith(name[:-1])) for word in words)


def condition_of(until: str | None) -> str | None:
    """The condition that ends a window, or None: a fault, an event or nothing does."""
    return None if until is None or until.partition(" ")[0] in ("fault", "event") else until


def expressions_of(item: Expectation) -> list[str]:
    """Every expression over logged signals that an expectation needs."""
    found = [] if isinstance(item, EventCount) else [item.signal, item.when]
    return [expression for expression in (*found, condition_of(item.until)) if expression is not None]
