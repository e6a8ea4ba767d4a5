"""A recorded run beside other flight software on the same inputs: an open loop, for nothing that it says reaches the plant.

What a changed setting or a changed algorithm would have said, signal by signal: when it first says something else, and
how far it goes off. Whether the run would have ended better is not in this: the inputs are those of the run as it was.
"""

from __future__ import annotations

from collections import deque
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bus.errors import RecordError
from fsw.telemetry import INPUT_TOPIC
from tools.log.mcap_reader import ENCAPSULATION_SIZE, LogRecord, Run, parse_layout
from tools.replay.flight_again import Flown
from tools.replay.heard import BUS, HeardFrames
from tools.replay.inputs import parse_input

BATCH: Final = 4096  # records of a topic that are compared at once


@dataclass(slots=True)
class SignalChange:
    """One signal that the replay has otherwise. Vectors: the element that differs most."""

    signal: str
    unit: str
    differing: int = 0  # samples
    samples: int = 0
    first_s: float = 0.0
    largest: float = 0.0  # difference, in the unit
    largest_s: float = 0.0
    recorded: float = 0.0  # there
    replayed: float = 0.0
    peak: float = 0.0  # largest size on either side

    @property
    def relative(self) -> float:
        """The largest difference against the signal's size, 0 to 2."""
        return self.largest / self.peak if self.peak and np.isfinite(self.largest) else 2.0

    def describe(self) -> str:
        """One line for people."""
        return (
            f"{self.signal}: {self.differing} of {self.samples} samples, first at {self.first_s:g} s, largest "
            f"{self.largest:.3g} {self.unit} at {self.largest_s:g} s ({self.recorded:.6g} recorded, {self.replayed:.6g} now)"
        )


@dataclass(slots=True)
class OpenLoop:
    """What an open-loop replay found."""

    ticks: int = 0
    signals: int = 0  # compared
    changes: list[SignalChange] = field(default_factory=list)  # those that differ, in the order in which they first do
    frames: int = 0  # compared, of those that the flight software sent
    frames_differing: int = 0
    first_frame: str = ""  # that differs, and when
    only_recorded: list[str] = field(default_factory=list)  # topics or fields of one side alone
    only_replayed: list[str] = field(default_factory=list)

    @property
    def same(self) -> bool:
        """Whether something was compared and nothing differed."""
        differs = self.changes or self.only_recorded or self.only_replayed or self.frames_differing
        return bool(self.ticks and self.signals and not differs)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self) | {"same": self.same}


class _Topic:
    """Records of one topic from both sides, compared a batch at a time."""

    def __init__(self, run: Run, name: str, replayed_schema: str) -> None:
        info = run.topics[name]
        self.name = name
        self._a = parse_layout(info.schema, name)
        self._b = parse_layout(replayed_schema, name)
        shared = [f for f in self._a.names or () if f != "stamp" and self._b.names and f in self._b.names]
        self.fields = [f for f in shared if self._a[f].shape == self._b[f].shape]
        self.only_a = [f"{name[1:]}.{f}" for f in self._a.names or () if f != "stamp" and f not in self.fields]
        self.only_b = [f"{name[1:]}.{f}" for f in self._b.names or () if f != "stamp" and f not in self.fields]
        prefix = name[1:].replace("/", ".")
        self.changes = {f: SignalChange(f"{prefix}.{f}", info.units.get(f, "")) for f in self.fields}
        self._ticks: list[int] = []
        self._recorded: list[bytes] = []
        self._replayed: list[bytes] = []

    def add(self, tick: int, recorded: bytes, replayed: bytes, tick_s: float) -> None:
        """Keep one record of each side."""
        self._ticks.append(tick)
        self._recorded.append(recorded[ENCAPSULATION_SIZE:])
        self._replayed.append(replayed[ENCAPSULATION_SIZE:])
        if len(self._ticks) >= BATCH:
            self.compare(tick_s)

    def compare(self, tick_s: float) -> None:
        """Compare what is kept."""
        if not self._ticks:
            return
        a = np.frombuffer(b"".join(self._recorded), self._a)
        b = np.frombuffer(b"".join(self._replayed), self._b)
        t_s = np.array(self._ticks) * tick_s
        for name, change in self.changes.items():
            _compare_field(change, a[name].reshape(len(a), -1), b[name].reshape(len(b), -1), t_s)
        self._ticks, self._recorded, self._replayed = [], [], []


def _compare_field(change: SignalChange, a: NDArray[Any], b: NDArray[Any], t_s: NDArray[np.floating[Any]]) -> None:
    change.samples += len(a)
    if a.dtype.kind not in "fiub" or a.tobytes() == b.tobytes():
        return
    one, two = a.astype(np.float64), b.astype(np.float64)
    with np.errstate(invalid="ignore"):
        size = np.abs(two - one)
    unlike = (one != two) & ~(np.isnan(one) & np.isnan(two))
    if not unlike.any():  # the sign of a zero
        return
    size = np.where(unlike, np.where(np.isfinite(size), size, np.inf), 0.0)
    rows = np.flatnonzero(unlike.any(axis=1))
    if not change.differing:
        change.first_s = float(t_s[rows[0]])
    change.differing += int(rows.size)
    change.peak = max(
        change.peak, *(float(np.max(np.abs(side), initial=0.0, where=np.isfinite(side))) for side in (one, two))
    )
    row, column = np.unravel_index(int(np.argmax(size)), size.shape)
    if size[row, column] > change.largest:
        change.largest, change.largest_s = float(size[row, column]), float(t_s[row])
        change.recorded, change.replayed = float(one[row, column]), float(two[row, column])


def compare_open_loop(run: Run, again: Flown, tick_ns: int) -> OpenLoop:
    """Fly every recorded cycle with the other software or settings; say how each of its signals differs.

    Raises RecordError when the log has no inputs.
    """
    if INPUT_TOPIC not in run.topics:
        raise RecordError(f"{run.path}: has no {INPUT_TOPIC}, what each cycle was given")
    recorded = {
        name for name, info in run.topics.items()
        if info.encoding == "cdr" and info.deterministic and name.startswith("/fsw/") and name != INPUT_TOPIC
    }  # fmt: skip
    replayed = again.schemas.keys() - {INPUT_TOPIC}
    outcome = OpenLoop(
        only_recorded=[name[1:] for name in sorted(recorded - replayed)],
        only_replayed=[name[1:] for name in sorted(replayed - recorded)],
    )
    topics = {name: _Topic(run, name, again.schemas[name]) for name in sorted(recorded & replayed)}
    for topic in topics.values():
        outcome.only_recorded += topic.only_a
        outcome.only_replayed += topic.only_b
    tick_s = tick_ns * 1e-9
    _fly(run, again, topics, outcome, tick_s)
    for topic in topics.values():
        topic.compare(tick_s)
        outcome.signals += len(topic.changes)
        outcome.changes += [change for change in topic.changes.values() if change.differing]
    outcome.changes.sort(key=lambda change: change.first_s)
    return outcome


def _fly(run: Run, again: Flown, topics: dict[str, _Topic], outcome: OpenLoop, tick_s: float) -> None:
    """Give every input to the flight software and put what it says beside what is in the log."""
    heard = HeardFrames(run)
    expected: dict[str, bytes] = {}
    ahead: deque[LogRecord] = deque()  # of the bus, of ticks whose cycle has not come yet
    expected_tick = -1
    for name, record in run.iterate_topics(*[BUS] * (BUS in run.topics), INPUT_TOPIC, *topics):
        if name == BUS:
            ahead.append(record)
            continue
        if record.sequence != expected_tick:
            expected, expected_tick = {}, record.sequence
        expected[name] = record.data
        if name == INPUT_TOPIC:
            cycle = again.cycle(parse_input(record.sequence, record.data))
            outcome.ticks += 1
            found = heard.match(cycle.frames, ahead, record.sequence)
            if found is not None and not outcome.first_frame:
                outcome.first_frame = f"{found.where} at {record.sequence * tick_s:g} s"
            for topic_name, topic in topics.items():
                if topic_name in expected and topic_name in cycle.records:
                    topic.add(record.sequence, expected[topic_name], cycle.records[topic_name], tick_s)
    outcome.frames, outcome.frames_differing = heard.compared, heard.differing
