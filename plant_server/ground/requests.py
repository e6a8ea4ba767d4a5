"""Requests in JSON (HILSAT_REQUEST) to the plant: set, clear, list, catalogue, status.

set        `fault`, keys as in a scenario (`at_s` may be left out), `at_tick`, `for_s` [s], `wait`
           -> `accepted` with `id` and the `tick` from which it acts; with `wait`, then `bit` at its first effect, or
           `ended`, `cleared`, `closing` where it ends without
clear      `id` or `unit` or neither -> `accepted` with the `ids` that ended
list       -> `done` with `faults`, each as it stands
catalogue  `unit` -> `done` with the `kinds` that can act on this plant
status     -> `done` with the name of the run, its tick, and whether it takes faults

What is refused is answered with `refused` and all `reasons`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from bus.mavlink.component import Asked
from plant_server.faults import FaultEvent, ListedFault
from plant_server.ground.catalogue import list_kinds
from plant_server.ground.desk import FaultDesk

ORIGIN: Final = "hilsat inject"
MOST_WAITS: Final = 256
ROOM: Final = 50_000  # bytes of a list of faults
KEYS: Final = {
    "set": ("fault", "at_tick", "for_s", "wait"), "clear": ("id", "unit"), "list": (), "catalogue": ("unit",),
    "status": (),
}  # fmt: skip


class Requests:
    """Answers requests at a desk, and tells those who wait what has become of their faults."""

    def __init__(self, desk: FaultDesk, name: str) -> None:
        """name : of the run"""
        self._desk = desk
        self._name = name
        self._waits: dict[str, Asked] = {}  # who waits for the effect of which fault
        self._doers: dict[str, Callable[[Asked], None]] = {
            "set": self._set, "clear": self._clear, "list": self._list, "catalogue": self._tell_kinds,
            "status": self._tell_status,
        }  # fmt: skip

    def take(self, asked: Asked) -> None:
        """Do what is asked, and answer."""
        do = asked.what.get("do")
        doer = self._doers.get(do) if isinstance(do, str) else None
        if doer is None or not isinstance(do, str):
            asked.reply("refused", reasons=[f"do: must be one of {', '.join(self._doers)}"])
            return
        foreign = [key for key in asked.what if key != "do" and key not in KEYS[do]]
        if foreign:
            known = ", ".join(KEYS[do]) or "no other key"
            asked.reply(
                "refused", reasons=[f"{key[:80]!r}: not a key of {do}; it takes {known}" for key in foreign[:8]]
            )
            return
        doer(asked)

    def report(self, events: tuple[FaultEvent, ...]) -> None:
        """Tell those who wait."""
        for event in events:
            if event.phase == "onset" or event.id not in self._waits:
                continue
            asked = self._waits.pop(event.id)
            state = {"effect": "bit", "end": "ended"}.get(event.phase, event.phase)
            asked.reply(state, id=event.id, tick=event.tick, t_s=event.t_s, text=event.by)

    def close(self) -> None:
        """Tell those who still wait that the run is over."""
        for name, asked in self._waits.items():
            asked.reply("closing", id=name, tick=self._desk.tick, t_s=self._desk.t_s)
        self._waits.clear()

    # -- what can be asked -----------------------------------------------------------------------------------------

    def _set(self, asked: Asked) -> None:
        what = asked.what
        fault, wait = what.get("fault"), what.get("wait", False)
        reasons = []
        if not isinstance(fault, dict):
            reasons.append("fault: must be a mapping, keys as of a fault in a scenario")
        if not isinstance(wait, bool):
            reasons.append("wait: must be true or false")
        elif wait and len(self._waits) >= MOST_WAITS:
            reasons.append(f"wait: {MOST_WAITS} requests wait already")
        if reasons or not isinstance(fault, dict):
            asked.reply("refused", reasons=reasons)
            return
        outcome, item = self._desk.set(fault, ORIGIN, at_tick=what.get("at_tick"), for_s=what.get("for_s"))
        if item is None:
            asked.reply("refused", reasons=list(outcome.reasons))
            return
        t_s = item.tick * self._desk.node.tick_s
        asked.reply("accepted", id=item.id, tick=item.tick, t_s=t_s, text=item.fault.describe(), final=not wait)
        if wait:
            self._waits[item.id] = asked

    def _clear(self, asked: Asked) -> None:
        which = {key: value for key, value in asked.what.items() if key != "do" and value is not None}
        outcome = self._desk.clear(which, ORIGIN)
        if outcome.reasons:
            asked.reply("refused", reasons=list(outcome.reasons))
        else:
            asked.reply("accepted", tick=self._desk.tick, t_s=self._desk.t_s, ids=list(outcome.ids), text=outcome.text)

    def _list(self, asked: Asked) -> None:
        """Tell all faults; where they do not fit into an answer, those that are over are left out first, oldest first."""
        items = [_describe(item) for item in self._desk.node.plant.list_faults()]
        sizes = [len(repr(item)) for item in items]
        excess, left_out = sum(sizes) - ROOM, set()
        for i in sorted(range(len(items)), key=lambda i: (items[i]["state"] != "over", i)):
            if excess <= 0:
                break
            left_out.add(i)
            excess -= sizes[i]
        faults = [item for i, item in enumerate(items) if i not in left_out]
        asked.reply("done", tick=self._desk.tick, t_s=self._desk.t_s, faults=faults, left_out=len(left_out))

    def _tell_kinds(self, asked: Asked) -> None:
        unit = asked.what.get("unit")
        kinds = list_kinds(self._desk.node.plant.config, unit)
        if isinstance(kinds, str):
            asked.reply("refused", reasons=[kinds])
        else:
            asked.reply("done", kinds=kinds)

    def _tell_status(self, asked: Asked) -> None:
        desk = self._desk
        asked.reply("done", name=self._name, tick=desk.tick, t_s=desk.t_s, ticks=desk.ticks, inject=desk.allowed)


def _describe(item: ListedFault) -> dict[str, Any]:
    return {
        "id": item.id, "unit": item.fault.unit, "kind": item.fault.kind, "state": item.state,
        "had_effect": item.had_effect, "tick": item.tick, "definition": item.fault.plain_settings(),
    }  # fmt: skip
