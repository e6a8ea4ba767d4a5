"""What is missing in a log: which ticks of which topic, and why.

Every topic that a process writes once a tick, or once a control period, has the tick as the sequence number of its
records. Held against the ticks that should have run, that says what the log has not. A run's scenario says how many
there should be; without one, as many count as any topic has.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tools.log.mcap_reader import Run
from tools.log.topics import TopicInfo

PLANT, FSW = "1", "2"  # sources of the recorder, as the channels of a log name their writer
REQUIRED: Final = ("/truth/attitude",)  # without these there is no log of a run
SLIPS: Final = "not run (slips)"
DAMAGED, DROPPED, EARLY = "damaged chunk", "dropped by the recorder", "the log ends early"
UNKNOWN: Final = "for an unknown reason"
SHOWN: Final = 12  # gaps that a warning lists


@dataclass(frozen=True, slots=True)
class Timetable:
    """The ticks that a run should have: what its scenario says."""

    ticks: int
    tick_hz: int
    control_divider: int = 1
    realtime: bool = False  # the flight software may then skip ticks


@dataclass(frozen=True, slots=True)
class Gap:
    """Ticks of a topic that are not in the log: first, first + step, ... last."""

    topic: str
    first: int
    last: int
    count: int
    step: int
    reason: str

    @property
    def run(self) -> bool:
        """Whether the ticks were run, so that their records should be there."""
        return self.reason != SLIPS

    def describe(self) -> str:
        """The gap in words."""
        ticks = f"tick {self.first}" if self.first == self.last else f"ticks {self.first} to {self.last}"
        return f"{self.topic}: {ticks} {'is' if self.first == self.last else 'are'} not in the log ({self.reason})"


@dataclass(frozen=True, slots=True)
class Completeness:
    """What a log has not. `gaps`: by topic and tick; `damage`: what else is wrong with the file, in words."""

    gaps: tuple[Gap, ...]
    damage: tuple[str, ...]

    @property
    def missing(self) -> int:
        """Number of ticks that were run and that some topic has not; ticks that were not run do not count."""
        by_topic: dict[str, int] = {}
        for gap in self.gaps:
            if gap.run:
                by_topic[gap.topic] = by_topic.get(gap.topic, 0) + gap.count * gap.step
        return max(by_topic.values(), default=0)

    def describe(self) -> list[str]:
        """All of it in words, ticks that were not run included; topics with the same gap in one line."""
        alike: dict[tuple[int, int, str], list[str]] = {}
        for gap in self.gaps:
            key = (gap.first // 1, gap.last, gap.reason) if gap.step == 1 else (-gap.first - 1, gap.last, gap.reason)
            alike.setdefault(key, []).append(gap.topic)
        first_of = {gap.topic: gap for gap in self.gaps}
        lines = []
        for (first, last, reason), topics in alike.items():
            gap = next(g for g in self.gaps if g.topic == topics[0] and g.last == last and g.reason == reason)
            lines.append(Gap(", ".join(topics), gap.first, gap.last, gap.count, gap.step, reason).describe())
        del first_of, first
        return lines + list(self.damage)
