"""The schedule table: which rate group runs on which tick.

A rate group runs every `divider`-th tick of the base rate, shifted by `phase`. Groups that are not `essential` are
shed first when the executive degrades.
"""

from __future__ import annotations

from dataclasses import dataclass

from bus.errors import ConfigError


@dataclass(frozen=True, slots=True)
class RateGroup:
    """One row of the table."""

    name: str
    divider: int
    phase: int = 0
    essential: bool = True

    def due(self, tick: int) -> bool:
        """True on the ticks on which this group runs."""
        return tick % self.divider == self.phase


@dataclass(frozen=True, slots=True)
class Schedule:
    """The whole table, in order of execution within a tick."""

    groups: tuple[RateGroup, ...]

    def __post_init__(self) -> None:
        problems = [
            f"schedule: rate group {group.name!r}: divider {group.divider} and phase {group.phase} do not fit; "
            "take divider >= 1 and 0 <= phase < divider"
            for group in self.groups
            if group.divider < 1 or not 0 <= group.phase < group.divider
        ]
        if problems:
            raise ConfigError(*problems)

    def group(self, name: str) -> RateGroup:
        """The row of that name."""
        for group in self.groups:
            if group.name == name:
                return group
        raise ConfigError(f"schedule: no rate group {name!r}; there are: {', '.join(g.name for g in self.groups)}")


def flight_schedule(control_divider: int) -> Schedule:
    """The table of the shipped flight software: sensing and commanding every tick, control slower if asked."""
    return Schedule(
        (
            RateGroup("attitude", 1),  # receive, validate, estimate, detect; send
            RateGroup("control", control_divider),  # observe, guide, control, allocate
            RateGroup("telemetry", 1, essential=False),  # publish
        )
    )
