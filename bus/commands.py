"""What comes from outside into a running side: time-tagged commands, each applied on a tick boundary.

Whoever sends one (the scenario's timeline, a Python bench, a tool), it waits in the side's queue, takes effect before the
work of its tick, and is logged with that tick, so that a replay can repeat it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

NEVER = 1 << 62  # tick of a command that does not come


@dataclass(frozen=True, slots=True)
class Command:
    """One thing that a side is told to do."""

    tick: int  # before whose work it is applied; one of the past is applied before the next
    verb: str  # what to do, such as fault.add or target.slew
    arguments: dict[str, Any]  # in JSON types; whoever carries the verb out reads them as its settings
    origin: str = "scenario"  # who said so

    def to_json(self) -> str:
        """One line of JSON, the same for the same command."""
        record = {"tick": self.tick, "verb": self.verb, "arguments": self.arguments, "origin": self.origin}
        return json.dumps(record, sort_keys=True, separators=(",", ":"), allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> Command:
        """The command that `to_json` wrote."""
        return cls(**json.loads(text))


class CommandQueue:
    """The commands that wait for their tick, in the order of their ticks, then of their arrival."""

    __slots__ = ("_waiting", "next_tick")

    def __init__(self, commands: Iterable[Command] = ()) -> None:
        self._waiting: list[Command] = []
        self.next_tick = NEVER  # before this one there is nothing to take
        for command in commands:
            self.add(command)

    def __len__(self) -> int:
        """How many wait."""
        return len(self._waiting)

    def add(self, command: Command) -> None:
        """Queue a command."""
        self._waiting.append(command)
        self._waiting.sort(key=lambda item: item.tick)  # a stable sort: arrivals of one tick keep their order
        self.next_tick = self._waiting[0].tick

    def take(self, tick: int) -> tuple[Command, ...]:
        """The commands due at this tick, no longer waiting."""
        if tick < self.next_tick:
            return ()
        due = tuple(command for command in self._waiting if command.tick <= tick)
        self._waiting = self._waiting[len(due) :]
        self.next_tick = self._waiting[0].tick if self._waiting else NEVER
        return due
