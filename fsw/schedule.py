"""The schedule table: which rate group runs on which tick, where that is not every one.

A rate group runs every `divider`-th tick of the base rate, shifted by `phase`. Where that tick is lost to a late cycle, the
group runs on the first one after it and is told how many ticks have passed; its later slots stay where they are. Groups
that are not `essential` are shed first when the executive degrades.
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


class Slot:
    """A rate group as it runs."""

    __slots__ = ("_divider", "_essential", "_last_tick", "_phase", "group", "next_tick", "shed")

    def __init__(self, group: RateGroup) -> None:
        self.group = group
        self.shed = 0  # times it was due and left out
        self._divider = group.divider
        self._phase = group.phase
        self._essential = group.essential
        self.next_tick = group.phase  # before this one it is not due
        self._last_tick = group.phase - group.divider

    def take(self, tick: int, shedding: bool = False) -> int:
        """Ticks since the group last ran where it is to run on this one, 0 where it is not."""
        if tick < self.next_tick:
            return 0
        self.next_tick = tick - (tick - self._phase) % self._divider + self._divider
        if shedding and not self._essential:
            self.shed += 1
            return 0
        elapsed = tick - self._last_tick
        self._last_tick = tick
        return elapsed


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

    def open_slots(self) -> tuple[Slot, ...]:
        """A slot for each row, in the table's order."""
        return tuple(Slot(group) for group in self.groups)


def flight_schedule(control_divider: int) -> Schedule:
    """The table of the shipped flight software, beside what runs in every cycle (sensing, detection, sending, telemetry)."""
    return Schedule(
        (
            RateGroup("control", control_divider),  # observe, judge the wheels, guide, control, allocate
            RateGroup("diagnostics", control_divider, essential=False),  # publish what the algorithms hold inside
        )
    )
