"""Carries out what the plant is told to do while it runs: faults are added and cleared, on a tick boundary.

| verb        | arguments |
|---|---|
| fault.add   | a fault, as in a scenario file |
| fault.clear | `id` of one, `unit` for all of one, nothing for all |

Each command is logged with the tick at which it was applied; one that is refused, with the reason. Whoever it comes from
(the timeline of a scenario, a bench in Python, `hilsat inject`, MAVLink), this is its one way to the plant.
"""

from __future__ import annotations

import json
from typing import Any, Final, NamedTuple

from bus.commands import Command
from bus.errors import ConfigError
from bus.settings import build
from plant_server.faults import Fault
from plant_server.plant import Plant
from plant_server.plant_log import PlantLog

VERBS = ("fault.add", "fault.clear")
LOGGED_REFUSALS: Final = 200  # of a run; whoever sends nonsense without end does not fill the log with it


class Outcome(NamedTuple):
    """What became of a command."""

    text: str  # what was done, as a phrase; "" when it was refused
    ids: tuple[str, ...] = ()  # of the faults that it added or cleared
    reasons: tuple[str, ...] = ()  # why it was refused


class Injector:
    """Applies commands to one plant."""

    def __init__(self, plant: Plant, log: PlantLog) -> None:
        self._plant = plant
        self._log = log
        self._refusals = 0

    def carry_out(self, command: Command, tick: int) -> Outcome:
        """Apply a command before the work of this tick, and log what became of it. Never raises for a wrong one."""
        try:
            outcome = self._apply(command)
        except ConfigError as error:
            self._refusals += 1
            if self._refusals <= LOGGED_REFUSALS:
                self._log.note_refusal(command, tick, str(error))
            return Outcome("", (), error.problems)
        self._log.note_command(command, tick, outcome.text)
        return outcome

    def _apply(self, command: Command) -> Outcome:
        """Do it."""
        if command.verb == "fault.add":
            fault = build(Fault, command.arguments, "fault.add")
            name = self._plant.add_fault(fault)
            return Outcome(f"{name}: {fault.describe()}", (name,))
        if command.verb == "fault.clear":
            cleared = self._plant.clear_faults(**_read_selection(command.arguments))
            return Outcome(f"cleared {', '.join(cleared) or 'nothing: no fault waits or acts'}", cleared)
        raise ConfigError(f"{json.dumps(command.verb)} is not a command of the plant; there are: {', '.join(VERBS)}")


def _read_selection(arguments: dict[str, Any]) -> dict[str, str]:
    """Return id or unit as `Plant.clear_faults` takes it. Raises ConfigError for anything else."""
    known = ("id", "unit")
    if len(arguments) > 1 or any(key not in known or not isinstance(item, str) for key, item in arguments.items()):
        raise ConfigError("fault.clear takes one of id and unit, as text, or nothing for all faults")
    return dict(arguments)
