"""Carries out what the plant is told to do while it runs: faults are added and cleared, on a tick boundary.

| verb        | arguments |
|---|---|
| fault.add   | a fault, as in a scenario file |
| fault.clear | `id` of one, `unit` for all of one, nothing for all |

Each command is logged with the tick at which it was applied; one that is refused, with the reason.
"""

from __future__ import annotations

import json
from typing import Any

from bus.commands import Command
from bus.errors import ConfigError
from bus.settings import build
from plant_server.faults import Fault
from plant_server.plant import Plant
from plant_server.plant_log import PlantLog

VERBS = ("fault.add", "fault.clear")


class Injector:
    """Applies commands to one plant."""

    def __init__(self, plant: Plant, log: PlantLog) -> None:
        self._plant = plant
        self._log = log

    def carry_out(self, command: Command, tick: int) -> None:
        """Apply a command before the work of this tick, and log what became of it. Never raises for a wrong one."""
        try:
            done = self._apply(command)
        except ConfigError as error:
            self._log.note_refusal(command, tick, str(error))
        else:
            self._log.note_command(command, tick, done)

    def _apply(self, command: Command) -> str:
        """Do it; return what was done, as a phrase."""
        if command.verb == "fault.add":
            fault = build(Fault, command.arguments, "fault.add")
            return f"{self._plant.add_fault(fault)}: {fault.describe()}"
        if command.verb == "fault.clear":
            cleared = self._plant.clear_faults(**_read_selection(command.arguments))
            return f"cleared {', '.join(cleared) or 'nothing: no fault waits or acts'}"
        raise ConfigError(f"{json.dumps(command.verb)} is not a command of the plant; there are: {', '.join(VERBS)}")


def _read_selection(arguments: dict[str, Any]) -> dict[str, str]:
    """Return id or unit as `Plant.clear_faults` takes it. Raises ConfigError for anything else."""
    known = ("id", "unit")
    if len(arguments) > 1 or any(key not in known or not isinstance(item, str) for key, item in arguments.items()):
        raise ConfigError("fault.clear takes one of id and unit, as text, or nothing for all faults")
    return dict(arguments)
