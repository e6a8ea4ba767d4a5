"""A recorded run against the same flown again: bit for bit, in one pass over the log."""

from __future__ import annotations

import json
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Final

from bus.errors import RecordError
from bus.wire.frames import FRAME_SIZE
from fsw.telemetry import INPUT_TOPIC
from fsw.telemetry import SOURCE as FSW_SOURCE
from tools.log.mcap_reader import LogRecord, Run
from tools.replay.flight_again import Cycle, Flown
from tools.replay.heard import BUS, Found, HeardFrames
from tools.replay.inputs import CycleInput, parse_input
from tools.replay.origin import compare_layouts, describe_origin, join_some

SHOWN_FRAMES: Final = 20


@dataclass(frozen=True, slots=True)
class Divergence:
    """Where the run and the replay part, and what was going on there."""

    tick: int
    t_s: float
    where: str  # topic or frame
    signal: str
    recorded: Any
    replayed: Any
    recorded_bits: str
    replayed_bits: str
    mode: str
    inputs: str

    def describe(self) -> str:
        """Several lines for people."""
        return "\n".join((
            f"first divergence at tick {self.tick}, {self.t_s:.6f} s: {self.where}: {self.signal}",
            f"  recorded: {self.recorded}  ({self.recorded_bits})",
            f"  replayed: {self.replayed}  ({self.replayed_bits})",
            f"  mode {self.mode}; the cycle was given {self.inputs}",
        ))  # fmt: skip


@dataclass(slots=True)
class Outcome:
    """What a replay found."""

    ticks: int = 0
    records: int = 0  # compared
    frames: int = 0  # compared
    unheard: int = 0  # frames that the plant did not log: lost on the way, or sent after its last tick
    torn: int = 0  # ticks of the bus behind the last cycle that the log has: it was cut there
    differing_ticks: int = 0
    first: Divergence | None = None

    @property
    def same(self) -> bool:
        """Whether something was compared and nothing differed."""
        return self.ticks > 0 and self.differing_ticks == 0

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self) | {"same": self.same}


Edit = Callable[[int, bytes], bytes]  # tick and data of an input record -> the data to take in its place


def compare_replay(run: Run, again: Flown, tick_ns: int, edit: Edit | None = None) -> Outcome:
    """Fly every recorded cycle again and compare what it says with what is in the log.

    edit : what a forger would have made of each record of an input; for those who ask whether that is found
    Raises RecordError when the log has no inputs, has lost some, or lays a topic out otherwise than this version does.
    """
    return _Comparison(run, again, tick_ns, edit).compare(_list_topics(run, again))


class _Comparison:
    """One pass over a log."""

    def __init__(self, run: Run, again: Flown, tick_ns: int, edit: Edit | None) -> None:
        self._run, self._again, self._tick_ns, self._edit = run, again, tick_ns, edit
        self._outcome = Outcome()
        self._heard = HeardFrames(run)
        self._ahead: deque[LogRecord] = deque()  # of the bus, of ticks whose cycle has not come yet
        self._last_tick, self._slips = -1, 0

    def compare(self, topics: tuple[str, ...]) -> Outcome:
        outcome, ahead = self._outcome, self._ahead
        expected: dict[str, bytes] = {}
        expected_tick = -1
        for topic, record in self._run.iterate_topics(BUS, *topics):
            if topic == BUS:
                ahead.append(record)
                continue
            if record.sequence != expected_tick:
                expected, expected_tick = {}, record.sequence
            expected[topic] = record.data
            if topic == INPUT_TOPIC:  # the last record of a cycle
                self._fly(expected, record)
        if not outcome.ticks:
            raise RecordError(
                f"{self._run.path}: no cycle of the flight software is in the log; there is nothing to replay"
            )
        self._note_rest()
        self._note(self._heard.compare(at_end=True), self._given)
        outcome.frames, outcome.unheard = self._heard.compared, self._heard.unheard
        return outcome

    def _fly(self, expected: dict[str, bytes], record: LogRecord) -> None:
        """Fly a cycle, and compare it and the frames of the bus up to it."""
        if self._edit is not None:
            expected[INPUT_TOPIC] = self._edit(record.sequence, record.data)
        given = self._given = parse_input(record.sequence, expected[INPUT_TOPIC])
        outcome = self._outcome
        if given.tick != self._last_tick + 1 and given.slips == self._slips:
            raise RecordError(
                f"{self._run.path}: the inputs of ticks {self._last_tick + 1} to {given.tick - 1} are not in the log; up to "
                f"there {outcome.differing_ticks} of {outcome.ticks} ticks differ, and beyond it nothing can be said"
            )
        self._last_tick, self._slips = given.tick, given.slips
        cycle = self._again.cycle(given)
        outcome.ticks += 1
        outcome.records += len(expected)
        told = self._heard.match(cycle.frames, self._ahead, given.tick)
        self._note(_compare_records(self._run, expected, cycle) or told, given)

    def _note(self, found: Found | None, given: CycleInput) -> None:
        if found is not None:
            self._outcome.differing_ticks += 1
            self._outcome.first = self._outcome.first or _locate(found, self._again.mode, given, self._tick_ns)

    def _note_rest(self) -> None:
        """Take the frames that the log has behind its last cycle: of a log that was cut there, their cycles are missing."""
        was_cut = not self._run.complete or "recovery" in self._run.metadata
        for record in self._ahead:
            if was_cut and record.sequence > self._last_tick:
                self._outcome.torn += 1
            else:
                self._heard.note_recorded(record)


def _list_topics(run: Run, again: Flown) -> tuple[str, ...]:
    """The topics of the flight software that are compared. Raises RecordError with everything in which they differ."""
    if INPUT_TOPIC not in run.topics:
        raise RecordError(
            f"{run.path}: has no {INPUT_TOPIC}, what each cycle was given; it is of a version that did not log that"
        )
    own = str(FSW_SOURCE)
    recorded = {
        name: info for name, info in run.topics.items()
        if info.deterministic and info.encoding == "cdr" and info.source == own
    }  # fmt: skip
    unlike = [
        words for name in sorted(recorded.keys() | again.schemas.keys())
        if (words := compare_layouts(name, recorded[name].schema if name in recorded else None, again.schemas.get(name)))
    ]  # fmt: skip
    if unlike:
        raise RecordError(
            f"{run.path}: its topics are not those of the flight software here: {join_some(unlike)}; {describe_origin(run)}"
        )
    return tuple(recorded)


def _compare_records(run: Run, expected: dict[str, bytes], cycle: Cycle) -> Found | None:
    """The first thing in which the records of a cycle differ."""
    if expected == cycle.records:
        return None
    for topic in expected | cycle.records:
        one, two = expected.get(topic), cycle.records.get(topic)
        if one == two:
            continue
        if one is None or two is None or topic == INPUT_TOPIC:
            return Found(topic, "whole record", _show(one), _show(two))
        a, b = run.decode(topic, one), run.decode(topic, two)
        for name in a:
            if _bits(a[name]) != _bits(b[name]):
                return Found(topic, name, a[name], b[name])
        return Found(topic, "stamp", _show(one), _show(two))
    return None


def _locate(found: Found, mode: str, given: CycleInput, tick_ns: int) -> Divergence:
    frames = [given.frames[at : at + FRAME_SIZE] for at in range(0, len(given.frames), FRAME_SIZE)]
    words = [f"{int.from_bytes(f[:4], 'little'):03X}#{f[8 : 8 + min(f[4], 8)].hex().upper()}" for f in frames]
    shown = " ".join(words[:SHOWN_FRAMES]) + (
        f" and {len(words) - SHOWN_FRAMES} more" if len(words) > SHOWN_FRAMES else ""
    )
    commands = "; ".join(command.to_json() for command in given.commands)
    return Divergence(
        given.tick, given.tick * tick_ns * 1e-9, found.where, found.signal, found.recorded, found.replayed,
        _bits(found.recorded), _bits(found.replayed), mode,
        f"slips {given.slips}, flags {given.flags}, {commands + '; ' if commands else ''}frames {shown or 'none'}",
    )  # fmt: skip


def _bits(value: Any) -> str:
    """The bits of a value, hexadecimal."""
    if isinstance(value, float):
        return struct.pack(">d", value).hex()
    if isinstance(value, list):
        return " ".join(map(_bits, value))
    return json.dumps(value)


def _show(data: bytes | None) -> str:
    return "no record" if data is None else data.hex()
