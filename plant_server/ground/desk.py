"""The desk where faults are set, cleared and listed while the plant runs, whoever asks: a request in JSON or MAVLink's own
command. What it takes goes to the plant at once as a command of the present tick, and is logged as all commands are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

from bus.errors import ConfigError
from bus.settings import build
from plant_server.faults import Fault, ListedFault
from plant_server.injector import Outcome
from plant_server.node import PlantNode

NOT_ALLOWED: Final = "this run does not take faults by command: inject: allowed in the scenario, or hilsat run --inject"
MOST_FAULTS: Final = 1000  # of a run: each is looked at with every command
LONGEST_TEXT: Final = 200
Scalar = str | int | float | bool | None


class FaultDesk:
    """Sets, clears and lists the faults of one plant."""

    def __init__(self, node: PlantNode, ticks: int | None, allowed: bool) -> None:
        """ticks : of the whole run; None: it has no end that is known"""
        self.node = node
        self.ticks = ticks
        self.allowed = allowed

    @property
    def tick(self) -> int:
        """The next tick to run: what is done now acts from it on."""
        return self.node.tick_number

    @property
    def t_s(self) -> float:
        """Its time [s]."""
        return self.tick * self.node.tick_s

    # -- setting ---------------------------------------------------------------------------------------------------

    def set(
        self, fault: dict[str, Any], origin: str, *, at_tick: object = None, for_s: object = None
    ) -> tuple[Outcome, ListedFault | None]:
        """Set a fault, keys as in a scenario; return what became of that, and the fault as it then stands.

        at_tick : its onset; None: its own at_s, or the next tick
        for_s   : how long it stays [s]; None: its own until_s, or to the end
        """
        reasons = list(self._explain_request(fault, at_tick, for_s))
        if reasons:
            return Outcome("", (), tuple(reasons)), None
        arguments = self._complete(fault, at_tick, for_s)
        late = self._explain_onset(arguments["at_s"])
        if late:
            return Outcome("", (), (late,)), None
        outcome = self.node.obey("fault.add", arguments, origin)
        if outcome.reasons:
            return outcome._replace(reasons=tuple(shorten(reason) for reason in outcome.reasons)), None
        return outcome, next(item for item in self.node.plant.list_faults() if item.id == outcome.ids[0])

    def explain(self, fault: dict[str, Any], count: int = 1) -> tuple[str, ...]:
        """Return why a fault that is to begin now, one of so many, would be refused; nothing when it would not."""
        reasons = tuple(self._explain_request(fault, None, None, count))
        if reasons:
            return reasons
        arguments = self._complete(fault, None, None)
        late = self._explain_onset(arguments["at_s"])
        if late:
            return (late,)
        try:
            self.node.plant.check_fault(build(Fault, arguments, "fault.add"))
        except ConfigError as error:
            return tuple(shorten(problem) for problem in error.problems)
        return ()

    def _complete(self, fault: dict[str, Any], at_tick: Any, for_s: Any) -> dict[str, Any]:
        """Return a sound fault with its onset and its end."""
        arguments = {**fault}
        if arguments.get("at_s") is None:
            arguments["at_s"] = (self.tick if at_tick is None else at_tick) * self.node.tick_s
        if for_s is not None and _is_number(arguments["at_s"]):
            arguments["until_s"] = arguments["at_s"] + for_s
        return arguments

    def _explain_request(self, fault: dict[str, Any], at_tick: object, for_s: object, count: int = 1) -> Iterator[str]:
        if not self.allowed:
            yield NOT_ALLOWED
            return
        if len(self.node.plant.list_faults()) + count > MOST_FAULTS:
            yield f"this run has had {MOST_FAULTS} faults; it takes no more"
        yield from _explain_values(fault)
        if at_tick is not None:
            if isinstance(at_tick, bool) or not isinstance(at_tick, int):
                yield "at_tick: must be a whole number"
            elif at_tick < self.tick:
                yield f"at_tick: {at_tick} has passed; the next tick is {self.tick}"
            elif self.ticks is not None and at_tick >= self.ticks:
                yield f"at_tick: {at_tick} is beyond the end of the run; its last tick is {self.ticks - 1}"
            if fault.get("at_s") is not None:
                yield "at_tick: the fault has an at_s; give one of both"
        if for_s is not None:
            if not (_is_number(for_s) and math.isfinite(for_s) and for_s > 0.0):  # type: ignore[arg-type, operator]
                yield "for_s: must be a number of seconds above 0"
            if fault.get("until_s") is not None:
                yield "for_s: the fault has an until_s; give one of both"

    def _explain_onset(self, at_s: object) -> str:
        """Return why a fault cannot begin at at_s, "" when it can."""
        if not _is_number(at_s):
            return ""  # said with all else that is wrong with it
        if at_s < self.t_s - 1e-6 * self.node.tick_s:  # type: ignore[operator]
            return f"at_s: {at_s:g} s has passed; it is {self.t_s:g} s"
        if self.ticks is not None and at_s > (self.ticks - 1 + 1e-6) * self.node.tick_s:  # type: ignore[operator]
            end_s = self.ticks * self.node.tick_s
            return f"at_s: {at_s:g} s is beyond the last tick of the run, which ends at {end_s:g} s"
        return ""

    # -- clearing --------------------------------------------------------------------------------------------------

    def clear(self, which: dict[str, Any], origin: str) -> Outcome:
        """End the fault of an `id`, those of a `unit`, or all; return what became of that."""
        reasons = tuple(_explain_values(which)) if self.allowed else (NOT_ALLOWED,)
        if reasons:
            return Outcome("", (), reasons)
        outcome = self.node.obey("fault.clear", which, origin)
        return outcome._replace(reasons=tuple(shorten(reason) for reason in outcome.reasons))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _explain_values(mapping: dict[str, Any]) -> Iterator[str]:
    """Say what in a mapping from outside is no plain value, or cannot be logged."""
    for key, value in mapping.items():
        if not isinstance(value, Scalar):
            yield f"{key[:LONGEST_TEXT]!r}: must be a number or a text"
        elif isinstance(value, int | float) and not abs(value) <= 1e300:
            yield f"{key[:LONGEST_TEXT]!r}: must be a finite number"
        elif not all(text.isprintable() and len(text) <= LONGEST_TEXT for text in (key, str(value))):
            yield f"{key[:LONGEST_TEXT]!r}: must be at most {LONGEST_TEXT} printable characters"


def shorten(reason: str) -> str:
    """Return a reason without the name of the command that it was given by."""
    for prefix in ("fault.add: ", "fault.clear: ", "fault.", "fault: "):
        reason = reason.removeprefix(prefix)
    return reason
