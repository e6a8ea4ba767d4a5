"""A scenario tried out: both sides are built from it as a run builds them, and what they refuse is found before the run.

Nothing moves and nothing is opened; building takes a few milliseconds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import numpy as np

from bus.errors import ConfigError, UsageError
from bus.settings import KeyPath, Problem
from tools.config.expect import expressions_of
from tools.config.expect_checks import check_expressions
from tools.config.merge import parse_key
from tools.config.scenario import Scenario
from tools.config.signal_names import OPEN_TOPICS

# package of the flight software -> the key whose choice lives in it
PLACES = {
    "fsw.estimation": ("fsw", "estimator"),
    "fsw.gyro_fdi": ("fsw", "detector"),
    "fsw.observers": ("fsw", "observer"),
    "fsw.controllers": ("fsw", "controller"),
    "fsw.allocators": ("fsw", "allocator"),
    "fsw.wheel_health": ("fsw", "wheel_health"),
    "fsw.guidance": ("fsw", "timeline"),
    "fsw.vehicle": ("fsw", "model"),
    "fsw.wheel_geometry": ("fsw", "model", "wheels"),
    "fsw.modes": ("fsw", "modes"),
    "fsw.null_space": ("fsw", "null_space"),
    "fsw.drive": ("fsw", "drive"),
}
BEYOND = (ArithmeticError, ValueError, MemoryError, np.linalg.LinAlgError)  # what absurd numbers end in


@dataclass(slots=True)
class Rehearsal:
    """What came of it: what the sides refused, and what law and detector will log of their inside."""

    problems: list[Problem]
    inside: dict[str, dict[str, int]] | None  # topic -> field -> numbers; None: the flight software was not built


def rehearse(scenario: Scenario) -> list[Problem]:
    """Everything that keeps a scenario from being run although each of its values is sound."""
    rehearsal = Rehearsal([], None)
    tick_s = 1.0 / scenario.clock.tick_hz
    _try(rehearsal, ("plant",), lambda: _build_plant(scenario, tick_s))
    _try(rehearsal, ("fsw",), lambda: _build_flight(scenario, tick_s, rehearsal))
    if rehearsal.inside is not None:
        words = [topic.rpartition(".")[2] for topic in OPEN_TOPICS]
        for index, item in enumerate(scenario.expect):
            if not any(word in expression for word in words for expression in expressions_of(item)):
                continue
            values = {key: getattr(item, key) for key in item.__dataclass_fields__}
            for key, word in check_expressions(values, rehearsal.inside):
                rehearsal.problems.append(Problem(("expect", index, key), word))
    return rehearsal.problems


def _build_plant(scenario: Scenario, tick_s: float) -> None:
    from plant_server.plant import Plant

    Plant(scenario.plant, scenario.faults, tick_s, scenario.seed)


def _build_flight(scenario: Scenario, tick_s: float, rehearsal: Rehearsal) -> None:
    from fsw.flight import Flight
    from fsw.guidance.timeline import make_command
    from fsw.telemetry import make_diagnostics

    flight = Flight(scenario.fsw, tick_s, 0)
    for index, entry in enumerate(scenario.fsw.timeline):
        command = make_command(entry, tick_s)
        if word := flight.check(command, command.tick):
            rehearsal.problems.append(Problem(("fsw", "timeline", index), word))
    topics = make_diagnostics(flight)
    rehearsal.inside = {
        topic.name.strip("/").replace("/", "."): {field.name: field.count for field in topic.fields} for topic in topics
    }


def _try(rehearsal: Rehearsal, side: KeyPath, build: Callable[[], None]) -> None:
    """Build a side; what it raises becomes a problem at the best key that is known for it."""
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            build()
    except ConfigError as error:
        rehearsal.problems += [_place(word, side) for word in error.problems]
    except UsageError as error:
        rehearsal.problems.append(Problem(_find_place(error.__traceback__, side), str(error)))
    except BEYOND as error:
        word = f"these settings cannot be computed with: {str(error) or type(error).__name__}"
        rehearsal.problems.append(Problem(_find_place(error.__traceback__, side), word))


def _place(word: str, side: KeyPath) -> Problem:
    """A problem from `plant.wheels[2].mount: what is wrong`."""
    head, colon, rest = word.partition(": ")
    path = parse_key(head) if colon else None
    known = path is not None and path[0] in ("plant", "faults", "fsw")
    return Problem(path, rest) if known and path is not None else Problem(side, word)


def _find_place(trace: TracebackType | None, side: KeyPath) -> KeyPath:
    """The key of the algorithm in whose module an error was raised."""
    while trace is not None:
        module: Any = trace.tb_frame.f_globals.get("__name__", "")
        for package, path in PLACES.items():
            if module == package or module.startswith(f"{package}."):
                return path
        trace = trace.tb_next
    return side
