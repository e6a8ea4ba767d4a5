"""Which laws and allocators meet, and what flies with each law.

The kinds come from the registries of the flight software: one that is registered flies without a word here, with its
default settings, and with the observer and the wheel health of the scenario. What a law is made for stands in COMPANIONS,
and is said beside its figures.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from bus.errors import UsageError
from bus.settings import plain
from bus.words import suggest
from fsw import allocators, controllers
from tools.config.loader import load_scenario
from tools.config.scenario import Resolved

CHOSEN: Final = ("fsw.controller", "fsw.allocator", "fsw.observer", "fsw.wheel_health")  # keys that a pair sets

CHANGES_PAIR: Final = ("fsw.controller.kind", "fsw.allocator.kind")


@dataclass(frozen=True, slots=True)
class Companions:
    """What a law is flown with where it is not what the scenario has, and what to know of its defaults."""

    observer: str | None = None  # kind; None: the scenario's own, with its settings
    wheel_health: str | None = None
    note: str = ""


NO_OBSERVER: Final = "none"
COMPANIONS: dict[str, Companions] = {
    "braking_profile": Companions(wheel_health="share_learner"),
    "dismc": Companions(observer=NO_OBSERVER, wheel_health="share_kalman"),
    "fuzzy_pid": Companions(
        observer=NO_OBSERVER,
        note="gains of a satellite of 14 kg m^2 that starts 2.7 deg off its target; not scaled to this one",
    ),
    "pid": Companions(observer=NO_OBSERVER, note="gains follow the inertia; meant to hold, not for large turns"),
    "rate_pid": Companions(
        observer=NO_OBSERVER,
        note="gains of a satellite of 14 kg m^2 that starts 2.7 deg off its target; not scaled to this one",
    ),
    "variable_structure": Companions(observer=NO_OBSERVER, note="made for the allocator transpose"),
}
ORDINARY: Final = Companions()


@dataclass(frozen=True, slots=True)
class Pair:
    """A law and an allocator, by their kinds."""

    controller: str
    allocator: str

    @property
    def name(self) -> str:
        """As messages and pictures call it."""
        return f"{self.controller} + {self.allocator}"

    @property
    def companions(self) -> Companions:
        """What flies with the law."""
        return COMPANIONS.get(self.controller, ORDINARY)

    def list_overrides(self) -> list[str]:
        """Return what is set in the scenario: each kind with its defaults, whatever the scenario has there."""
        kinds = {
            "fsw.controller": self.controller,
            "fsw.allocator": self.allocator,
            "fsw.observer": self.companions.observer,
            "fsw.wheel_health": self.companions.wheel_health,
        }
        words = []
        for key, kind in kinds.items():
            if kind is not None:  # a mapping would be merged with one of the same kind: first something that is none
                words += [f"{key}=gone", f"{key}={{kind: {kind}}}"]
        return words


@dataclass(frozen=True, slots=True)
class Contest:
    """The scenario that all pairs fly, and what was set in it on the command line."""

    path: Path
    settings: tuple[str, ...]  # KEY=VALUE, over what a pair sets
    until_s: float | None = None  # instead of the scenario's own duration

    def check(self) -> None:
        """Raises UsageError where a setting would change what a pair is: its row would name what did not fly."""
        for setting in self.settings:
            key, _, value = setting.partition("=")
            if key.strip() in CHANGES_PAIR or (key.strip() in CHOSEN[:2] and "kind" in value):
                option = "--controllers" if "controller" in key else "--allocators"
                raise UsageError(f"--set {setting}: the shootout chooses these kinds itself; take {option}")

    def load(self, pair: Pair) -> Resolved:
        """Return the scenario as this pair flies it. Raises UsageError, mostly ConfigError, where it cannot be flown."""
        return load_scenario(self.path, [*self._list_common(), *pair.list_overrides(), *self.settings])

    def load_common(self) -> Resolved:
        """Return the scenario as it stands, for what all pairs have in common. Raises ConfigError."""
        return load_scenario(self.path, [*self._list_common(), *self._list_other_settings()])

    def _list_other_settings(self) -> list[str]:
        """Settings of everything but what a pair chooses: those can be wrong for one pair and right for another."""
        return [setting for setting in self.settings if not setting.strip().startswith(CHOSEN)]

    def _list_common(self) -> list[str]:
        """No requirements, for they are another law's; one process; faults and commands that come before the end."""
        common = ["expect=[]", "clock.mode=inprocess"]
        if self.until_s is None:
            return common
        scenario = load_scenario(self.path, [*common, *self._list_other_settings()]).scenario
        faults = [plain(fault) for fault in scenario.faults if fault.at_s < self.until_s]
        timeline = [plain(entry) for entry in scenario.fsw.timeline if entry.at_s < self.until_s]
        return [
            *common,
            f"duration_s={self.until_s!r}",
            f"faults={json.dumps(faults)}",
            f"fsw.timeline={json.dumps(timeline)}",
        ]


def choose_pairs(laws: str | None, shares: str | None) -> list[Pair]:
    """Return every law times every allocator, or those of two comma-separated lists, law by law.

    Raises UsageError for a name that is not registered, with the near miss and the choices.
    """
    chosen = _choose("--controllers", laws, controllers.REGISTRY.kinds)
    return [Pair(law, share) for law in chosen for share in _choose("--allocators", shares, allocators.REGISTRY.kinds)]


def _choose(option: str, wanted: str | None, known: Iterable[str]) -> Sequence[str]:
    kinds = list(known)
    if wanted is None:
        return kinds
    words = list(dict.fromkeys(word.strip() for word in wanted.split(",") if word.strip()))
    for word in words:
        if word not in kinds:
            raise UsageError(f"{option}: {word!r} is not known; {suggest(word, kinds)}there are: {', '.join(kinds)}")
    if not words:
        raise UsageError(f"{option}: names nobody; there are: {', '.join(kinds)}")
    return words
