"""MAV_CMD_INJECT_FAILURE, and the parameters FLT_* that have its magnitudes."""

from __future__ import annotations

import math
from typing import Final

from bus.mavlink import words
from bus.mavlink.component import CommandRequest, Component
from bus.mavlink.parameters import Parameter, Parameters
from plant_server.faults import ListedFault, parts_of
from plant_server.ground.desk import NOT_ALLOWED, FaultDesk
from plant_server.ground.failures import INSTANCES, OK, SETTINGS, TABLE, Setting, concerns, name_failure

MASK_BITS: Final = 24  # that a float carries exactly


class FailureCommand:
    """Carries out 420 at a desk; a failure takes the place of what 420 had put on the same instance before."""

    def __init__(self, desk: FaultDesk) -> None:
        self._desk = desk
        self._values = {setting.name: setting.value for setting in SETTINGS}
        self._placed: dict[tuple[int, str], str] = {}  # by MAVLink unit and unit of ours: the fault that is there
        self.component: Component | None = None  # who says why a command was not obeyed

    def list_parameters(self) -> Parameters:
        """Return FLT_ENABLE and the magnitudes as parameters."""
        enabled = 1.0 if self._desk.allowed else 0.0
        gate = Parameter(
            "FLT_ENABLE", lambda: enabled, None, 0.0, 1.0, "1: faults are taken; set by inject: in the scenario"
        )
        return Parameters([gate, *[self._make_parameter(setting) for setting in SETTINGS]])

    def _make_parameter(self, setting: Setting) -> Parameter:
        def write(value: float) -> str:
            if setting.unit == "ticks" and value != round(value):
                return f"{value:g} is not a whole number"
            self._values[setting.name] = value
            return ""

        text = f"{setting.text} [{setting.unit}]"
        return Parameter(setting.name, lambda: self._values[setting.name], write, setting.low, setting.high, text)

    def obey(self, request: CommandRequest) -> int:
        """Do what a command asks; return its MAV_RESULT. Whatever is not ACCEPTED is said with the reason."""
        result, why = self._try(request)
        if why and self.component is not None:
            self.component.say(words.WARNING, f"420: {why}", request.address)
        return result

    def _try(self, request: CommandRequest) -> tuple[int, str]:
        if not self._desk.allowed:
            return words.DENIED, NOT_ALLOWED
        unit, type = request.whole(1, -1), request.whole(2, -1)
        what = name_failure(unit, type)
        instances = INSTANCES.get(-1 if unit is None else unit, ())
        if unit is None or type is None or not instances or (type != OK and (unit, type) not in TABLE):
            return words.UNSUPPORTED, f"{what}: not implemented here"
        parts = _choose(instances, request.params[2], request.params[3])
        if not parts:
            return words.DENIED, f"{what}: no such instance; there are 1 to {len(instances)}, 0 for all"
        origin = f"MAVLink {request.system}/{request.component}"
        why = self._clear(unit, parts, origin) if type == OK else self._set(unit, type, parts, origin)
        return (words.FAILED, f"{what}: {why}") if why else (words.ACCEPTED, "")

    def _set(self, unit: int, type: int, parts: tuple[str, ...], origin: str) -> str:
        """Put a failure on some units, all or none; return why not."""
        desk, failure = self._desk, TABLE[unit, type]
        faults = [failure.make_fault(part, self._values) for part in parts]
        for fault in faults:
            reasons = desk.explain(fault, len(faults))
            if reasons:
                return "; ".join(reasons)
        there = {item.id for item in self._list_present()}
        for part, fault in zip(parts, faults, strict=True):
            before = self._placed.pop((unit, part), None)
            if before in there:
                desk.clear({"id": before}, origin)
            outcome, _ = desk.set(fault, origin)
            self._placed[unit, part] = outcome.ids[0]
        return ""

    def _clear(self, unit: int, parts: tuple[str, ...], origin: str) -> str:
        """End whatever of a MAVLink unit waits or acts on these units, whoever set it; return why not."""
        found = []
        for item in self._list_present():
            its = parts_of(item.fault.unit)
            if not concerns(unit, item.fault.kind) or not set(its) & set(parts):
                continue
            if not set(its) <= set(parts):
                return f"{item.id} is on {', '.join(its)} as one; clear them together, with instance 0"
            found.append(item.id)
        for name in found:
            self._desk.clear({"id": name}, origin)
        return ""

    def _list_present(self) -> list[ListedFault]:
        return [item for item in self._desk.node.plant.list_faults() if item.state != "over"]


def _choose(instances: tuple[str, ...], number: float, mask: float) -> tuple[str, ...]:
    """Return the units that param3, or param4 where param3 is NaN, means; none for what means no unit that is there."""
    count = len(instances)
    if math.isnan(number) and not math.isnan(mask):
        if not (0.0 < mask < 1 << min(count, MASK_BITS)) or mask != int(mask):
            return ()
        return tuple(part for i, part in enumerate(instances) if int(mask) >> i & 1)
    if math.isnan(number):
        return instances
    if not (0.0 <= number <= count) or number != int(number):
        return ()
    return instances if number == 0.0 else (instances[int(number) - 1],)
