"""What is missing in a log: which ticks of which topic, and why.

Every topic that a process writes once a tick, or once a control period, has the tick as the sequence number of its
records. Held against the ticks that should have run, that says what the log has not. The scenario that a log carries says
how many there should be; without one, there should be as many as any topic has.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bus.errors import RecordError
from bus.telemetry.cdr import FRAMES_SCHEMA
from tools.config.findings import Source
from tools.config.yaml_nodes import read_yaml
from tools.log.mcap_reader import Run
from tools.log.topics import TopicInfo

PLANT, FSW = "1", "2"  # sources of the recorder, as the channels of a log name their writer
REQUIRED: Final = "/truth/attitude"  # without it there is no log of a run
SLIPS, ENDED, SHED = "not run (slips)", "not run (the plant had ended)", "shed by the executive"
DAMAGED, DROPPED, EARLY, UNKNOWN = "damaged chunk", "dropped by the recorder", "log ends early", "unknown why"
SHOWN: Final = 12  # lines of a warning
MOST_TICKS: Final = 10**9
LONGEST_SCENARIO: Final = 64 * 1024  # bytes that are read for no more than three numbers
END_S: Final = 1.0  # real time: how much earlier than the plant the flight software may end


@dataclass(frozen=True, slots=True)
class Timetable:
    """The ticks that a run should have: what its scenario says."""

    ticks: int
    tick_hz: float
    control_divider: int = 1
    realtime: bool = False  # the flight software may then skip ticks


@dataclass(frozen=True, slots=True)
class Gap:
    """Ticks of a topic that are not in the log: first, first + step, ... last."""

    topic: str
    first: int
    last: int
    step: int
    reason: str

    @property
    def ran(self) -> bool:
        """Whether the ticks ran, so that their records should be there."""
        return self.reason not in (SLIPS, ENDED, SHED)

    def describe(self, topics: str = "") -> str:
        """The gap in words; `topics`: what to call them."""
        ticks = f"tick {self.first} is" if self.first == self.last else f"ticks {self.first} to {self.last} are"
        return f"{topics or self.topic}: {ticks} not in the log ({self.reason})"


@dataclass(frozen=True, slots=True)
class Completeness:
    """What a log has not. `gaps`: by topic and tick; `damage`: what else is wrong with the file, in words."""

    gaps: tuple[Gap, ...]
    damage: tuple[str, ...]

    @property
    def missing(self) -> int:
        """Number of ticks that ran and that some topic lacks."""
        count, reached = 0, 0
        for gap in sorted((gap for gap in self.gaps if gap.ran), key=lambda gap: gap.first):
            count += max(0, gap.last + 1 - max(reached, gap.first))
            reached = max(reached, gap.last + 1)
        return count

    @property
    def whole(self) -> bool:
        """True when nothing that ran is missing and nothing is damaged."""
        return not self.missing and not self.damage

    def describe(self) -> list[str]:
        """All of it in words, a line each; topics that lack the same ticks share one."""
        alike: dict[tuple[int, int, str], list[Gap]] = {}
        for gap in self.gaps:
            alike.setdefault((gap.first, gap.last, gap.reason), []).append(gap)
        lines = [gaps[0].describe(", ".join(gap.topic for gap in gaps)) for gaps in alike.values()]
        return lines + list(self.damage)


def check_completeness(run: Run, timetable: Timetable | None = None) -> Completeness:
    """What the log lacks of the ticks in `timetable`; without one: in the attached scenario."""
    graded = timetable is not None
    timetable = timetable or _find_timetable(run)
    slipped = timetable.realtime and _read_last(run, "/fsw/executive", "slips") > 0
    gaps = []
    damage = [_count(count, f"damaged {what}") for what, count in sorted(run.damage.items())]
    for info in _list_tick_topics(run):
        ticks = np.sort(run.ticks(info.name))
        unique = ticks[np.diff(ticks, prepend=-1) > 0]
        if unique.size < ticks.size:
            damage.append(f"{info.name}: {_count(ticks.size - unique.size, 'record')} of a tick that has one already")
        step = _find_step(info, unique, timetable)
        for first, last in _find_gaps(unique[unique < timetable.ticks], step, timetable.ticks):
            gaps.append(Gap(info.name, first, last, step, _explain(run, info, first, last, step, timetable, slipped)))
    if REQUIRED not in run.topics and graded:
        gaps.append(Gap(REQUIRED, 0, timetable.ticks - 1, 1, "the log has no such topic"))
    refused = run.metadata.get("recording", {}).get("refused")
    if refused:
        damage.append(f"frames that the log has no room for: {refused}")
    if run.lost_chunks:
        why = sorted({chunk.why for chunk in run.lost_chunks})
        damage.insert(0, f"{_count(len(run.lost_chunks), 'damaged chunk')}: {'; '.join(why[:3])}")
    return Completeness(tuple(gaps), tuple(damage))


def warn_of_missing(run: Run, verb: str) -> None:
    """Say on stderr what the log lacks, if anything."""
    lines = check_completeness(run).describe()
    if not run.complete:
        lines.append("the log has no end: it was not closed, or was cut")
    for line in lines[:SHOWN]:
        print(f"hilsat {verb}: {run.path}: {line}", file=sys.stderr)
    if len(lines) > SHOWN:
        print(f"hilsat {verb}: {run.path}: and {len(lines) - SHOWN} more holes", file=sys.stderr)


def _count(count: int, what: str) -> str:
    head, of, tail = what.partition(" (") if " (" in what else what.partition(" that ")
    return f"{count} {head}{'' if count == 1 else 's'}{of}{tail}"


def _find_timetable(run: Run) -> Timetable:
    """What the attached scenario says, unchecked; without one that can be read: the ticks that any topic has."""
    scenario = _read_scenario(run)
    try:
        tick_hz = int(scenario["clock"]["tick_hz"])
        divider = int(scenario["fsw"]["executive"]["control_divider"])
        ticks = round(float(scenario["duration_s"]) * tick_hz)
        if 0 < ticks <= MOST_TICKS and 0 < divider <= ticks:
            return Timetable(ticks, tick_hz, divider, scenario["clock"]["mode"] == "realtime")
    except (KeyError, TypeError, ValueError, OverflowError):
        pass
    last = max((int(run.ticks(info.name).max()) for info in _list_tick_topics(run) if run.has(info.name)), default=-1)
    ours = any(info.source for info in run.topics.values())
    return Timetable(
        last + 1 if ours else 0, _read_rate(run), 1, run.metadata.get("run", {}).get("clock") == "realtime"
    )


def _read_scenario(run: Run) -> dict[str, Any]:
    try:
        data = run.attachment("scenario.yaml")
        if data is None or len(data) > LONGEST_SCENARIO:
            return {}
        node, _ = read_yaml(Source("scenario.yaml", data.decode()))
    except (RecordError, ValueError, RecursionError):
        return {}
    plain = node.plain() if node is not None else None
    return plain if isinstance(plain, dict) else {}


def _read_rate(run: Run) -> float:
    try:
        return float(run.metadata.get("run", {}).get("tick_hz", "0"))
    except ValueError:
        return 0.0


def _list_tick_topics(run: Run) -> list[TopicInfo]:
    """The topics that a process of a run writes once a tick or once a control period."""
    return [
        info for name, info in run.topics.items()
        if info.encoding == "cdr"
        and info.every != "irregular"
        and (info.source in (PLANT, FSW) or name.startswith(("/truth/", "/fsw/")))
        and (info.schema_name == FRAMES_SCHEMA or not name.startswith("/can/"))
    ]  # fmt: skip


def _find_step(info: TopicInfo, ticks: NDArray[np.int64], timetable: Timetable) -> int:
    """Ticks from one record of the topic to the next, as its channel says; of other logs: as it is at most places."""
    steps = {"tick": 1, "control": timetable.control_divider, "diagnostic": timetable.control_divider}
    if info.every == "second":
        return max(1, round(timetable.tick_hz))
    if info.every in steps:
        return steps[info.every]
    return int(np.median(np.diff(ticks))) if ticks.size > 2 else 1


def _find_gaps(ticks: NDArray[np.int64], step: int, count: int) -> Iterator[tuple[int, int]]:
    """First and last of every run of missing ticks among 0 to count - 1."""
    if not ticks.size:
        if count:
            yield 0, (count - 1) // step * step
        return
    if ticks[0] >= step:
        yield int(ticks[0]) % step, int(ticks[0]) - step
    after = np.flatnonzero(np.diff(ticks) > step)
    for before, behind in zip(ticks[after].tolist(), ticks[after + 1].tolist(), strict=True):
        yield before + step, before + (behind - before - 1) // step * step
    end = int(ticks[-1])
    if end + step < count:
        yield end + step, end + (count - 1 - end) // step * step


def _explain(run: Run, info: TopicInfo, first: int, last: int, step: int, timetable: Timetable, slipped: bool) -> str:
    """Why these ticks are not in the log, as far as it tells."""
    at_end = last + step >= timetable.ticks
    flight = info.source == FSW or info.name.startswith("/fsw/")
    dropped = run.metadata.get("recording", {}).get(f"dropped_ticks_{FSW if flight else PLANT}", "0") != "0"
    if timetable.tick_hz and any(
        chunk.start_ns * 1e-9 * timetable.tick_hz <= last + step
        and first - step <= chunk.end_ns * 1e-9 * timetable.tick_hz
        for chunk in run.lost_chunks
    ):
        return DAMAGED
    if at_end and not run.complete:
        return EARLY
    if dropped:
        return DROPPED
    if info.every == "diagnostic" and _read_last(run, "/fsw/executive", "shed") > 0:
        return SHED
    if timetable.realtime and flight and not run.lost_chunks and run.complete:
        if slipped:
            return SLIPS
        if at_end and (last - first + step) <= END_S * timetable.tick_hz:
            return ENDED
    if at_end:
        return EARLY
    return DAMAGED if run.lost_chunks else UNKNOWN


def _read_last(run: Run, topic: str, field: str) -> int:
    """The last value of a counter; 0 where the log has none."""
    if not run.has(topic):
        return 0
    try:
        values = run.signals(topic)[field]
    except (RecordError, KeyError):
        return 0
    return int(values[-1]) if values.ndim == 1 and np.isfinite(values[-1]) else 0
