"""What a campaign is made of, between the parts that plan it, fly it and judge it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

from tools.campaign.results import RunResult

SEED_BYTES: Final = 4  # a scenario's seed is a whole number that every reader of JSON holds


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """One place in the space of a campaign's axes, not yet a run."""

    values: Mapping[str, Any]  # axis -> its value, in JSON types
    labels: Mapping[str, str]  # axis -> how the value is called in tables
    repeat: int = 0  # number of the repeat at this place; each has a seed of its own


@dataclass(frozen=True, slots=True, kw_only=True)
class RunPlan:
    """One run: everything that it takes to fly it alone, on any machine, to the bit."""

    number: int  # from 0, in the order of the plan
    point: Point
    base: str  # scenario file, or name of one that ships
    overrides: tuple[str, ...]  # key=value words, as `hilsat run --set` takes them
    seed: int


# Flies a batch and returns what came of each, in the order of the points, whatever the number of workers. Points that a
# resumed campaign has flown already are answered from its results.
Evaluate = Callable[[Sequence[Point]], list[RunResult]]


class Strategy(Protocol):
    """Which points a campaign flies: all of a plan, or batch after batch by what has come out so far.

    It asks the same points whenever it gets the same answers, so that a campaign can be resumed and repeated.
    """

    def run(self, evaluate: Evaluate) -> Mapping[str, Any]:
        """Fly what there is to fly; return what was found, in JSON types, for the report ({}: nothing of its own)."""


def derive_seed(campaign_seed: int, number: int) -> int:
    """The seed of a run, from the campaign's and the run's number alone: the same on any machine and for any worker."""
    words = f"hilsat campaign {campaign_seed} run {number}".encode()
    return int.from_bytes(hashlib.sha256(words).digest()[:SEED_BYTES], "big") >> 1
