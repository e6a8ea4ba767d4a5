"""Faults of the plant's units: what there is (`CATALOGUE`), what a fault must say, and when which one is active.

Each unit has a chain of faults, in the order of their onset. None replaces an older one; each has an onset, an optional
end and an optional linear rise. The timeline announces every onset and end with the tick at which it took effect.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from bus.errors import ConfigError
from bus.settings import Problem
from plant_server.config import FaultConfig
from plant_server.noise import Draw, open_uniforms

NEVER = 1 << 62  # step of an edge that does not come
WHEELS = ("wheel.1", "wheel.2", "wheel.3", "wheel.4")
GYRO_AXES = ("gyro.x", "gyro.y", "gyro.z")
STAR_TRACKER = "star_tracker"
SIMPLE_UNITS = (*WHEELS, *GYRO_AXES, STAR_TRACKER)  # `gyro` stands for its three axes
UNITS = (*WHEELS, "gyro", *GYRO_AXES, STAR_TRACKER)

MAGNITUDES = ("effectiveness", "torque_nm", "rate_rad_s", "slope_rad_s2", "frequency_rad_s", "factor", "probability")


@dataclass(frozen=True, slots=True)
class FaultKind:
    """What a kind of fault does, and which magnitudes it takes."""

    meaning: str
    needs: tuple[str, ...] = ()
    may: tuple[tuple[str, str], ...] = ()  # optional magnitudes, each with what happens when it is left out
    rise: bool = True  # whether a linear rise means anything
    random: bool = False  # draws from a stream of its own


CATALOGUE: dict[str, dict[str, FaultKind]] = {
    "wheel": {
        "loss": FaultKind("torque is `effectiveness` times the command", ("effectiveness",)),
        "bias": FaultKind("`torque_nm` is added to the torque", ("torque_nm",)),
        "stuck_torque": FaultKind("torque is `torque_nm` whatever the command", ("torque_nm",)),
        "dead": FaultKind("no motor torque; the rotor coasts and the tachometer still reports"),
        "silent": FaultKind("no telemetry frames; the wheel still obeys", rise=False),
    },
    "gyro": {
        "constant": FaultKind("`rate_rad_s` is added to the rate", ("rate_rad_s",)),
        "periodic": FaultKind(
            "`rate_rad_s` sin(`frequency_rad_s` t) is added, t from the onset or absolute (`phase`)",
            ("rate_rad_s", "frequency_rad_s"),
        ),
        "ramp": FaultKind("`slope_rad_s2` times the time since onset is added", ("slope_rad_s2",), rise=False),
        "stuck": FaultKind(
            "the output does not move", may=(("rate_rad_s", "freezes at the last output before onset"),)
        ),
        "dead": FaultKind("no frames", rise=False),
        "noise": FaultKind("the angle random walk is `factor` times as large", ("factor",)),
        "scale": FaultKind("the rate, as disturbed so far, is multiplied by 1 + `factor`", ("factor",)),
        "spikes": FaultKind(
            "with `probability` per tick, +-`rate_rad_s` is added, sign at random",
            ("rate_rad_s", "probability"),
            random=True,
        ),
        "intermittent": FaultKind("with `probability` per tick, no frame", ("probability",), random=True),
    },
    "star_tracker": {
        "dropout": FaultKind(
            "with `probability` per frame, no frame", may=(("probability", "1: every frame is lost"),), random=True
        ),
    },
}


def name_family(unit: str) -> str:
    """Return the family of a known unit: wheel, gyro or star_tracker."""
    return unit.partition(".")[0]


# -- checking ------------------------------------------------------------------------------------------------------


def _suggest(word: str, choices: Iterable[str]) -> str:
    near = difflib.get_close_matches(word, list(choices), n=1)
    return f"; did you mean {near[0]}?" if near else ""


def check_fault(fault: FaultConfig) -> list[Problem]:
    """Return everything wrong with one fault, with key paths relative to it."""
    problems = _check_times(fault)
    if fault.unit not in UNITS:
        text = f'unit "{fault.unit}" is not known; there are: {", ".join(UNITS)}{_suggest(fault.unit, UNITS)}'
        return [*problems, Problem(("unit",), text)]
    family = name_family(fault.unit)
    kinds = CATALOGUE[family]
    if fault.kind not in kinds:
        text = f'"{fault.kind}" is not a fault of a {family}; there are: {", ".join(kinds)}'
        return [*problems, Problem(("kind",), text + _suggest(fault.kind, kinds))]
    return problems + _check_magnitudes(fault, family, kinds[fault.kind])


def _check_times(fault: FaultConfig) -> list[Problem]:
    problems = []
    for key in ("at_s", "rise_s"):
        value = getattr(fault, key)
        if not 0.0 <= value < math.inf:
            problems.append(Problem((key,), f"{value} s is not a time; give 0 or more"))
    if fault.until_s is not None and not fault.at_s < fault.until_s < math.inf:
        text = f"{fault.until_s} s is not after the onset at {fault.at_s} s; give a later time or leave it out"
        problems.append(Problem(("until_s",), text))
    return problems


def _check_magnitudes(fault: FaultConfig, family: str, kind: FaultKind) -> list[Problem]:
    problems = []
    name = f"{family} fault {fault.kind}"
    optional = tuple(key for key, _ in kind.may)
    for key in MAGNITUDES:
        value = getattr(fault, key)
        if value is None:
            if key in kind.needs:
                problems.append(Problem((), f"{name} needs {key}: {kind.meaning}"))
        elif key not in kind.needs and key not in optional:
            takes = ", ".join((*kind.needs, *optional)) or "no magnitude"
            problems.append(Problem((key,), f"{name} has no use for {key}; it takes {takes}", at_key=True))
        elif not math.isfinite(value):
            problems.append(Problem((key,), f"{value} is not a finite number"))
        elif key in ("effectiveness", "probability") and not 0.0 <= value <= 1.0:
            problems.append(Problem((key,), f"{value} is outside 0..1"))
        elif key == "frequency_rad_s" and value <= 0.0:
            problems.append(Problem((key,), f"{value} rad/s is not a frequency; give one above 0"))
        elif key == "factor" and fault.kind == "noise" and value < 0.0:
            problems.append(Problem((key,), f"{value} is not a multiple of a noise; give 0 or more"))
    if fault.phase != "onset" and fault.kind != "periodic":
        problems.append(Problem(("phase",), f"{name} has no use for phase; only periodic has one", at_key=True))
    if fault.rise_s > 0.0 and not kind.rise:
        problems.append(Problem(("rise_s",), f"{name} has no rise: {kind.meaning}; leave rise_s out", at_key=True))
    return problems


def check_faults(faults: Iterable[FaultConfig]) -> list[Problem]:
    """Return everything wrong with a list of faults, key paths starting with its index."""
    return [
        Problem((i, *problem.path), problem.message, problem.at_key)
        for i, fault in enumerate(faults)
        for problem in check_fault(fault)
    ]


# -- running -------------------------------------------------------------------------------------------------------


class FaultEvent(NamedTuple):
    """A fault took effect or ended."""

    tick: int  # wheels: the tick during which it bit; sensors: the first sample that shows it
    t_s: float  # start of the integration step (wheels) or the sample (sensors) of the change
    number: int  # which fault, in the order of the scenario, then of commands
    unit: str
    kind: str
    active: bool  # True: took effect; False: ended
    magnitude: float  # the first magnitude that the fault gives; 0.0 when it takes none
    magnitudes: str  # all of them, as text

    def describe(self) -> str:
        """Return unit, kind and magnitudes as a phrase for a log."""
        return " ".join(word for word in (self.unit, self.kind, self.magnitudes) if word)


class ActiveFault:
    """One fault on one unit, in integration steps."""

    __slots__ = ("config", "draw", "held_rad_s", "index", "kind", "off", "on", "start_s")

    def __init__(self, config: FaultConfig, index: int, start_s: float, on: int, off: int, draw: Draw | None) -> None:
        self.config = config
        self.kind = config.kind
        self.index = index
        self.start_s = start_s
        self.on = on  # first step on which it acts
        self.off = off  # first step on which it no longer acts
        self.draw = draw
        self.held_rad_s: float | None = None  # gyro stuck: where it froze

    def measure_level(self, t_s: float) -> float:
        """Return how far it has come on, 0..1, at the time t_s."""
        rise_s = self.config.rise_s
        elapsed_s = t_s - self.start_s
        if elapsed_s >= rise_s:
            return 1.0
        return elapsed_s / rise_s if elapsed_s > 0.0 else 0.0

    def is_rising(self, t_s: float) -> bool:
        """Return whether its level still changes at the time t_s."""
        return t_s - self.start_s < self.config.rise_s


class FaultChain:
    """The faults of one unit in the order of their onset, and which are active now."""

    __slots__ = ("active", "entries", "next_edge")

    def __init__(self) -> None:
        self.entries: list[ActiveFault] = []
        self.active: tuple[ActiveFault, ...] = ()
        self.next_edge = NEVER

    def add(self, entry: ActiveFault) -> None:
        """Put a fault in its place; the chain is looked at afresh on the next step."""
        self.entries.append(entry)
        self.entries.sort(key=lambda e: (e.on, e.index))
        self.next_edge = -1

    def refresh(self, step: int) -> None:
        """Find what is active from `step` on, and the step of the next change."""
        self.active = tuple(e for e in self.entries if e.on <= step < e.off)
        self.next_edge = min((edge for e in self.entries for edge in (e.on, e.off) if edge > step), default=NEVER)


def compose_torque(active: tuple[ActiveFault, ...], t_s: float) -> tuple[float, float]:
    """Return (e, b) of tau = e tau_motor + b [1, N m]: a wheel's faults, applied one after the other.

    Zhang, Ye & Sun 2018, eq (8), for each; a fault that has not fully risen is blended with what was there before it.
    """
    gain, offset = 1.0, 0.0
    for fault in active:
        level = fault.measure_level(t_s)
        config = fault.config
        if fault.kind == "loss":
            scale = 1.0 - level * (1.0 - (config.effectiveness or 0.0))
            gain, offset = gain * scale, offset * scale
        elif fault.kind == "bias":
            offset += level * (config.torque_nm or 0.0)
        elif fault.kind in ("stuck_torque", "dead"):
            rest = 1.0 - level
            gain, offset = gain * rest, offset * rest + level * (config.torque_nm or 0.0)
    return gain, offset


class FaultTimeline:
    """All faults of a run: a chain for every unit, and the events that tell of onset and end.

    Times are rounded up to whole integration steps; sensors are disturbed from their first sample at or after that.
    Raises ConfigError with everything that is wrong with the faults.
    """

    def __init__(self, faults: tuple[FaultConfig, ...], *, step_s: float, steps_per_tick: int, seed: int) -> None:
        problems = check_faults(faults)
        if problems:
            raise ConfigError(*(f"faults{format_path(p.path)}: {p.message}" for p in problems))
        self.chains: dict[str, FaultChain] = {unit: FaultChain() for unit in SIMPLE_UNITS}
        self._step_s = step_s
        self._steps_per_tick = steps_per_tick
        self._seed = seed
        self._count = 0
        self._edges: list[tuple[int, int, FaultConfig, bool]] = []  # soonest last
        self.next_edge = NEVER  # step of the next onset or end
        for fault in faults:
            self._enter(fault, 0)

    def add(self, fault: FaultConfig, step: int) -> int:
        """Return the index of a fault that was commanded during the run, before the integration step `step`.

        An onset in the past takes effect now. Raises ConfigError when the fault is wrong or already over.
        """
        problems = check_fault(fault)
        if not problems and fault.until_s is not None and self._count_steps(fault.until_s) <= step:
            text = f"{fault.until_s} s has passed: it is {step * self._step_s:g} s, the fault would never take effect"
            problems = [Problem(("until_s",), text)]
        if problems:
            raise ConfigError(*(f"fault{format_path(p.path)}: {p.message}" for p in problems))
        return self._enter(fault, step)

    def take_events(self, step: int) -> tuple[FaultEvent, ...]:
        """Return the onsets and ends up to and including `step` that were not returned before."""
        events = []
        while self._edges and self._edges[-1][0] <= step:
            edge, index, fault, active = self._edges.pop()
            tick = edge // self._steps_per_tick
            given = [(key, getattr(fault, key)) for key in MAGNITUDES if getattr(fault, key) is not None]
            text = ", ".join(f"{key} {value:g}" for key, value in given)
            value = given[0][1] if given else 0.0
            events.append(FaultEvent(tick, edge * self._step_s, index, fault.unit, fault.kind, active, value, text))
        self.next_edge = self._edges[-1][0] if self._edges else NEVER
        return tuple(events)

    def _count_steps(self, time_s: float) -> int:
        return math.ceil(time_s / self._step_s - 1e-6)

    def _enter(self, fault: FaultConfig, step: int) -> int:
        index = self._count
        self._count += 1
        on = max(self._count_steps(fault.at_s), step)
        off = NEVER if fault.until_s is None else max(self._count_steps(fault.until_s), on + 1)
        if name_family(fault.unit) != "wheel":
            on, off = self._round_to_tick(on), self._round_to_tick(off)
        start_s = max(fault.at_s, step * self._step_s)
        random = CATALOGUE[name_family(fault.unit)][fault.kind].random
        for unit in GYRO_AXES if fault.unit == "gyro" else (fault.unit,):
            chain = self.chains[unit]
            order = sum(entry.kind == fault.kind for entry in chain.entries)
            draw = open_uniforms(self._seed, f"fault/{unit}/{fault.kind}/{order}") if random else None
            chain.add(ActiveFault(fault, index, start_s, on, off, draw))
        self._edges.append((on, index, fault, True))
        if off < NEVER:
            self._edges.append((off, index, fault, False))
        self._edges.sort(key=lambda edge: (edge[0], edge[3], edge[1]), reverse=True)
        self.next_edge = self._edges[-1][0]
        return index

    def _round_to_tick(self, step: int) -> int:
        n = self._steps_per_tick
        return step if step == NEVER else -(-step // n) * n


def format_path(path: tuple[str | int, ...]) -> str:
    """Return a key path as text: (0, 'kind') is [0].kind."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path)
