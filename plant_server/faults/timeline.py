"""When which fault acts: a chain for each unit, onsets and ends in integration steps, and the events that tell of them.

None replaces another; each has an onset, an optional end and a profile. Events: `onset` and `end` as the scenario has them,
`cleared` by command, by a reset or a power cycle of the unit or by itself, and `effect`, the first time that a fault really
changes something of its unit's output.

A fault with a latch keeps the highest level that it has reached, whatever its profile does and also beyond its end. Only the
reset or the power cycle of its unit that the latch names takes it away, and only once its cause is gone: its `until_s`, or
the length of its profile, has passed. Without an end the cause is gone at once. One that comes again by itself
(intermittent, poisson) goes back to where its profile stands, and is caught anew by the next spell.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar, cast

from bus.errors import ConfigError
from bus.settings import Problem
from plant_server.config import PlantConfig
from plant_server.faults.effects import Acting, Effect, WheelEffect
from plant_server.faults.fault import Fault, check_faults, fault_ids
from plant_server.faults.profiles import Course
from plant_server.faults.units import SIMPLE_UNITS, STAR_TRACKER, family_of, parts_of
from plant_server.noise import Draw, open_uniforms

NEVER = 1 << 62  # step of an edge that does not come
FARTHEST = 1e15  # step of a time that no run comes to
ORDER = {"end": 0, "cleared": 0, "onset": 1, "effect": 2}  # of events on one step
K = TypeVar("K", bound=Effect)


class FaultEvent(NamedTuple):
    """A fault began, first had an effect, or ended."""

    tick: int  # wheels: the tick during which it happened; sensors: the first sample that shows it
    t_s: float  # start of the integration step (wheels) or the sample (sensors) of the change
    id: str
    number: int  # which fault, in the order of the scenario, then of commands
    fault: Fault
    phase: str  # onset, effect, end, cleared
    by: str = ""  # cleared: by what, when it was no command of the test bench

    @property
    def value(self) -> float:
        """The first magnitude of the fault; 0.0 when it takes none."""
        return float(next(iter(self.fault.magnitudes.values()), 0.0))


class ListedFault(NamedTuple):
    """One fault of the run, as it stands."""

    id: str
    fault: Fault
    state: str  # waiting, active, over
    had_effect: bool
    tick: int  # the first on which it acts


class Occurrence:
    """One fault of the run in integration steps, whatever the number of units it is on."""

    __slots__ = (
        "_course", "_peak", "cause_off", "fault", "find_level", "had_effect", "id", "number", "off", "on", "start_s",
    )  # fmt: skip

    def __init__(self, fault: Fault, name: str, number: int, start_s: float, on: int, off: int, course: Course) -> None:
        self.fault = fault
        self.id = name
        self.number = number
        self.start_s = start_s
        self.on = on  # first step on which it acts
        self.off = NEVER if fault.latch else off  # first step on which it no longer acts
        self.cause_off = off  # first step on which nothing brings it back
        self.had_effect = False
        self._course = course
        self._peak = 0.0  # highest level since the onset or since it was last cleared, of one with a latch
        # how far it has come on, 0..1, so long after its onset [s]
        self.find_level: Callable[[float], float] = self._hold_level if fault.latch else course.level

    def _hold_level(self, elapsed_s: float) -> float:
        self._peak = max(self._course.level(elapsed_s), self._peak)
        return self._peak

    def settled(self, elapsed_s: float) -> bool:
        """Return whether its level stays what it is [s since the onset]."""
        return self._peak == 1.0 or self._course.settled(elapsed_s)

    def let_go(self) -> None:
        """Fall back to where the profile stands."""
        self._peak = 0.0


class ActiveFault(Generic[K]):
    """One fault at work on one unit: its effect, and what that is told."""

    __slots__ = ("_draw", "_find_level", "_goes_on", "_heal", "_is_new", "effect", "now", "occurrence")

    def __init__(
        self, occurrence: Occurrence, draw: Draw | None, heal: Callable[[Occurrence, float, str], None]
    ) -> None:
        self.occurrence = occurrence
        self.effect = cast(K, occurrence.fault.effect)
        self.now = Acting(occurrence.start_s)
        self._draw = draw
        self._find_level = occurrence.find_level
        self._heal = heal
        self._is_new = True
        self._goes_on = self.effect.draws > 0 or self.effect.remembers  # something happens with every step or sample

    def bring_to(self, t_s: float, speed_rad_s: float = 0.0) -> None:
        """Bring what the effect is told to the time t_s; random numbers are drawn when that is another than the last.

        speed_rad_s : of a wheel's rotor relative to the body, at the start of the integration step; needed each step
                      by kinds that are not `steady`
        """
        now = self.now
        passed_s = t_s - now.t_s
        now.t_s = t_s
        now.speed_rad_s = speed_rad_s
        now.elapsed_s = elapsed_s = t_s - now.start_s
        now.level = self._find_level(elapsed_s)
        if self._goes_on and (self._is_new or passed_s != 0.0):
            self._go_on(passed_s)

    def _go_on(self, passed_s: float) -> None:
        """Draw the random numbers of this step or sample; keep what the kind remembers of the time since the last one."""
        now, effect = self.now, self.effect
        self._is_new = False
        now.count += 1
        if self._draw is not None:
            now.drawn = tuple([self._draw() for _ in range(effect.draws)])
        if effect.remembers:
            why = effect.follow(now, passed_s)
            if why is not None:
                self._heal(self.occurrence, now.t_s, why)

    def draw_each(self) -> None:
        """Draw the random numbers of one more frame."""
        if self._draw is not None and self.effect.draws_each:
            self.now.drawn = tuple([self._draw() for _ in range(self.effect.draws_each)])

    def is_settled(self) -> bool:
        """Return whether what it does stays what it is."""
        effect = self.effect
        return effect.steady and not effect.draws and self.occurrence.settled(self.now.elapsed_s)


class FaultChain(Generic[K]):
    """The faults of one unit in the order in which they act, and which are active now."""

    __slots__ = ("active", "entries", "next_edge")

    def __init__(self) -> None:
        self.entries: list[ActiveFault[K]] = []
        self.active: tuple[ActiveFault[K], ...] = ()
        self.next_edge = NEVER  # step on which this must be looked at again

    def add(self, entry: ActiveFault[K]) -> None:
        """Put a fault in its place; the chain is looked at afresh on the next step."""
        self.entries.append(entry)
        self.entries.sort(key=lambda e: (not e.effect.early, e.effect.last, e.occurrence.on, e.occurrence.number))
        self.next_edge = -1

    def refresh(self, step: int) -> None:
        """Find what is active from `step` on, and the step of the next change."""
        spans = [(entry, entry.occurrence.on, entry.occurrence.off) for entry in self.entries]
        self.active = tuple(entry for entry, on, off in spans if on <= step < off)
        self.next_edge = min((edge for _, on, off in spans for edge in (on, off) if edge > step), default=NEVER)

    def without_effect_yet(self) -> tuple[ActiveFault[K], ...]:
        """Return the active faults that have not changed anything so far."""
        return tuple(entry for entry in self.active if not entry.occurrence.had_effect)


class Waiting(NamedTuple):
    """An event that has not been returned yet."""

    step: int
    phase: str
    item: Occurrence
    by: str


class FaultTimeline:
    """All faults of a run, and the events that tell of them.

    Times are rounded up to whole integration steps; sensors are disturbed from their first sample at or after that.
    Raises ConfigError with everything that is wrong with the faults.
    """

    def __init__(
        self,
        faults: tuple[Fault, ...],
        *,
        step_s: float,
        steps_per_tick: int,
        seed: int,
        plant: PlantConfig | None = None,
    ) -> None:
        self._tick_s = step_s * steps_per_tick
        problems = check_faults(faults, plant)
        problems += [
            Problem((i, "kind"), word)
            for i, fault in enumerate(faults)
            if (word := fault.effect.explain_short(self._tick_s)) is not None
        ]
        if problems:
            raise ConfigError(*(f"faults{format_path(p.path)}: {p.message}" for p in problems))
        self.chains: dict[str, FaultChain[Effect]] = {unit: FaultChain() for unit in SIMPLE_UNITS}
        self._plant = plant
        self._step_s = step_s
        self._steps_per_tick = steps_per_tick
        self._seed = seed
        self._all: list[Occurrence] = []
        self._commanded = 0
        self._waiting: list[Waiting] = []  # events that are still to come, soonest first
        self.next_event = NEVER  # step of the next one
        for name, fault in zip(fault_ids(faults), faults, strict=True):
            self._enter(fault, name, 0)

    # -- commands ------------------------------------------------------------------------------------------------------

    def add(self, fault: Fault, step: int) -> str:
        """Return the id of a fault that was commanded during the run, before the integration step `step`.

        An onset in the past takes effect now. Raises ConfigError when the fault is wrong, is already over, can have no
        effect, or has the id of another.
        """
        name = self.check(fault, step)
        self._commanded += 1
        self._enter(fault, name, step)
        return name

    def check(self, fault: Fault, step: int) -> str:
        """Return the id that a fault would get if it were added before the step; raises ConfigError as `add` does."""
        name = self._find_name() if fault.id is None else fault.id
        problems = [f"fault{format_path(p.path)}: {p.message}" for p in fault.check(self._plant)]
        if (word := fault.effect.explain_short(self._tick_s)) is not None:
            problems.append(f"fault.kind: {word}")
        if any(item.id == name for item in self._all):
            problems.append(f'fault.id: "{name}" is the id of another fault of this run; ids are unique')
        if not problems and fault.until_s is not None and self._count_steps(fault.until_s) <= step:
            text = f"{fault.until_s} s has passed: it is {step * self._step_s:g} s, the fault would never take effect"
            problems.append(f"fault.until_s: {text}")
        if not problems and self._falls_between(fault, step):
            text = f"no sample of {fault.unit} falls into it, so it would never take effect; make it longer"
            problems.append(f"fault.until_s: {text}")
        if problems:
            raise ConfigError(*problems)
        return name

    def _falls_between(self, fault: Fault, step: int) -> bool:
        """Return whether a fault is over before its unit is sampled."""
        on, off = self._find_span(fault, step)
        effect, every = fault.effect, self._steps_per_tick
        if fault.latch or (isinstance(effect, WheelEffect) and not effect.reports):
            return False
        if fault.unit == STAR_TRACKER and self._plant is not None:
            every *= round(1.0 / (self._plant.star_tracker.rate_hz * self._tick_s))
        return -(-on // every) * every >= off

    def _find_name(self) -> str:
        """Return the id of the next commanded fault that gives none."""
        taken = {item.id for item in self._all}
        return next(name for i in itertools.count(self._commanded) if (name := f"command[{i}]") not in taken)

    def clear(self, step: int, *, id: str | None = None, unit: str | None = None) -> tuple[str, ...]:
        """End faults before the integration step `step`: that of an id, those of a unit, all when neither is given.

        Returns the ids of those that were waiting or active; `gyro` as unit means its axes too. Raises ConfigError
        when an id or a unit names no such fault.
        """
        over = [item for item in self._all if item.off > step and _is_meant(item, id, unit)]
        if not over and (id is not None or unit is not None):
            there = ", ".join(f"{item.id} ({item.fault.unit})" for item in self._all if item.off > step) or "none"
            what = f'id "{id}"' if id is not None else f'unit "{unit}"'
            raise ConfigError(f"fault.clear: no fault with {what} is waiting or active; there are: {there}")
        for item in over:
            self._end(item, step, "")
        return tuple(item.id for item in over)

    def reset_unit(self, unit: str, step: int) -> tuple[str, ...]:
        """Return the ids of the faults that a reset of a unit takes away, before the integration step `step`.

        Those whose latch is `until_reset`, and those of kinds that a reset heals. The unit's model looks at its faults
        again (`WheelBank.look_again`). Not the same as `clear`, which the test bench does and which always works.
        """
        return self._recover(unit, step, ("until_reset",), "reset")

    def power_cycle_unit(self, unit: str, step: int) -> tuple[str, ...]:
        """Return the ids of the faults that a power cycle of a unit takes away, before the integration step `step`.

        All that a reset does, and those whose latch is `until_power_cycle`.
        """
        return self._recover(unit, step, ("until_reset", "until_power_cycle"), "power cycle")

    def _recover(self, unit: str, step: int, latches: tuple[str, ...], by: str) -> tuple[str, ...]:
        """Return the ids of the active faults that are taken away, each announced."""
        gone = []
        for item in [item for item in self._all if unit in parts_of(item.fault.unit) and item.on <= step < item.off]:
            latch = item.fault.latch
            if latch is None and item.fault.effect.resettable:
                self._end(item, step, by)
            elif latch is None or latch not in latches or (item.cause_off != NEVER and step < item.cause_off):
                continue
            elif item.fault.profile.recurs and item.cause_off == NEVER:
                item.let_go()
                self._look_again(item)
                self._expect(step, "cleared", item, f"{by}, until it comes again")
            else:
                self._end(item, step, by)
            gone.append(item.id)
        return tuple(gone)

    def _end(self, item: Occurrence, step: int, by: str) -> None:
        """End a fault before its time."""
        item.off = step
        self._waiting = [entry for entry in self._waiting if entry.item is not item or entry.step < step]
        self._expect(step, "cleared", item, by)
        self._look_again(item)

    def _heal(self, item: Occurrence, t_s: float, why: str) -> None:
        """End a fault that has healed by itself, after the step or sample of the time t_s."""
        self._end(item, math.floor(t_s / self._step_s + 1e-6) + 1, why)

    def _look_again(self, item: Occurrence) -> None:
        for part in parts_of(item.fault.unit):
            self.chains[part].next_edge = -1

    def list(self, step: int) -> tuple[ListedFault, ...]:
        """Return every fault of the run and how it stands before the integration step `step`."""
        return tuple(
            ListedFault(
                item.id,
                item.fault,
                "over" if item.off <= step else "active" if item.on <= step else "waiting",
                item.had_effect,
                item.on // self._steps_per_tick,
            )
            for item in self._all
        )

    # -- events --------------------------------------------------------------------------------------------------------

    def note_effect(self, entry: ActiveFault[K], step: int) -> None:
        """Keep that a fault has changed something of its unit's output on this step, the first time that it does."""
        if not entry.occurrence.had_effect:
            entry.occurrence.had_effect = True
            self._expect(step, "effect", entry.occurrence)

    def take_events(self, step: int) -> tuple[FaultEvent, ...]:
        """Return what has happened up to and including `step` and was not returned before, in its order."""
        due = [entry for entry in self._waiting if entry.step <= step]
        self._waiting = self._waiting[len(due) :]
        self.next_event = self._waiting[0].step if self._waiting else NEVER
        return tuple(
            FaultEvent(at // self._steps_per_tick, at * self._step_s, item.id, item.number, item.fault, phase, by)
            for at, phase, item, by in due
        )

    def _expect(self, step: int, phase: str, item: Occurrence, by: str = "") -> None:
        self._waiting.append(Waiting(step, phase, item, by))
        self._waiting.sort(key=_find_place)
        self.next_event = self._waiting[0].step

    # -- entering ------------------------------------------------------------------------------------------------------

    def _enter(self, fault: Fault, name: str, step: int) -> None:
        on, off = self._find_span(fault, step)
        start_s = max(fault.at_s, step * self._step_s)
        alike = sum(item.fault.unit == fault.unit and item.fault.kind == fault.kind for item in self._all)
        course = fault.profile.open(self._seed, f"fault/{fault.unit}/{fault.kind}/{alike}/profile")
        item = Occurrence(fault, name, len(self._all), start_s, on, off, course)
        self._all.append(item)
        for unit in parts_of(fault.unit):
            chain = self.chains[unit]
            order = sum(entry.effect.kind == fault.kind for entry in chain.entries)
            stream = f"fault/{unit}/{fault.kind}/{order}"
            draw = open_uniforms(self._seed, stream) if fault.effect.draws or fault.effect.draws_each else None
            chain.add(ActiveFault(item, draw, self._heal))
        self._expect(on, "onset", item)
        if item.off < NEVER:
            self._expect(item.off, "end", item)

    def _find_span(self, fault: Fault, step: int) -> tuple[int, int]:
        """Return the first step on which a fault that is entered before `step` acts, and the first without it."""
        on = max(self._count_steps(fault.at_s), step)
        off = NEVER if fault.until_s is None else max(self._count_steps(fault.until_s), on + 1)
        start_s = max(fault.at_s, step * self._step_s)
        span_s = fault.profile.span_s
        if span_s is not None:
            off = min(off, max(self._count_steps(start_s + span_s), on + 1))
        if family_of(fault.unit) != "wheel":
            return self._round_to_tick(on), self._round_to_tick(off)
        return on, off

    def _count_steps(self, time_s: float) -> int:
        return math.ceil(min(time_s / self._step_s, FARTHEST) - 1e-6)

    def _round_to_tick(self, step: int) -> int:
        n = self._steps_per_tick
        return step if step == NEVER else -(-step // n) * n


def _find_place(entry: Waiting) -> tuple[int, int, int]:
    """Return the order of events: by step, ends ahead of onsets, but that of a fault too short to act behind its own."""
    step, phase, item, _ = entry
    return (step, 3 if phase == "end" and item.on >= step else ORDER[phase], item.number)


def _is_meant(item: Occurrence, id: str | None, unit: str | None) -> bool:
    if id is not None:
        return item.id == id
    return unit is None or item.fault.unit == unit or family_of(item.fault.unit) == unit


def format_path(path: tuple[str | int, ...]) -> str:
    """Return a key path as text: (0, 'kind') is [0].kind."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path)
