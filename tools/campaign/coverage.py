"""Which faults a campaign tried: kinds x units x phases, read from what its runs set."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import yaml

from tools.campaign.results import Outcome, RunResult
from tools.campaign.statistics import Tally
from tools.campaign.strategies.answers import tally_outcomes
from tools.config.merge import parse_key

PHASES: Final = 4  # stretches of equal length that onsets are counted in
FAULTS: Final = "faults"


@dataclass(frozen=True, slots=True)
class Coverage:
    """How often each fault was tried in each phase, and what came of it."""

    kinds: tuple[str, ...]
    units: tuple[str, ...]
    phases: tuple[str, ...]  # in words
    cells: Mapping[tuple[str, str, str], Tally]  # kind, unit, phase
    without: int  # runs that set no fault

    @property
    def possible(self) -> int:
        """How many combinations there are of what was tried."""
        return len(self.kinds) * len(self.units) * len(self.phases)


def cover(results: Sequence[RunResult]) -> Coverage:
    """Count the faults that runs set beside their base scenario. A run with several counts for each of them."""
    onsets: list[tuple[str, str, float, Outcome]] = []
    without = 0
    for result in results:
        faults = list(list_faults(result.overrides))
        without += not faults
        onsets += [(kind, unit, at_s, result.outcome) for kind, unit, at_s in faults]
    times = sorted({at_s for _, _, at_s, _ in onsets})
    names = _name_phases(times)
    outcomes: dict[tuple[str, str, str], list[Outcome]] = {}
    for kind, unit, at_s, outcome in onsets:
        outcomes.setdefault((kind, unit, _find_phase(at_s, times, names)), []).append(outcome)
    return Coverage(
        tuple(sorted({kind for kind, _, _ in outcomes})),
        tuple(sorted({unit for _, unit, _ in outcomes})),
        names,
        {place: tally_outcomes(found) for place, found in outcomes.items()},
        without,
    )


def _name_phases(times: Sequence[float]) -> tuple[str, ...]:
    """Each onset by itself where there are few, else stretches of equal length."""
    if len(times) <= PHASES:
        return tuple(f"{at_s:g} s" for at_s in times)
    step = (times[-1] - times[0]) / PHASES
    return tuple(f"{times[0] + i * step:.4g} to {times[0] + (i + 1) * step:.4g} s" for i in range(PHASES))


def _find_phase(at_s: float, times: Sequence[float], names: Sequence[str]) -> str:
    if len(times) <= PHASES:
        return names[times.index(at_s)]
    return names[min(PHASES - 1, int(PHASES * (at_s - times[0]) / (times[-1] - times[0])))]


def list_faults(overrides: Sequence[str]) -> Iterator[tuple[str, str, float]]:
    """Kind, unit and onset in s of each fault that a run's settings name; one that is only changed in part counts."""
    listed: list[Any] = []
    parts: dict[int, dict[str, Any]] = {}
    for setting in overrides:
        key, _, text = setting.partition("=")
        if not key.lstrip().startswith(FAULTS):
            continue
        path = parse_key(key.strip())
        if path == (FAULTS,):
            value = _read(text)
            listed = value if isinstance(value, list) else []
        elif path and path[0] == FAULTS and isinstance(path[1], int):
            value = _read(text)
            if len(path) == 2 and isinstance(value, dict):
                parts.setdefault(path[1], {}).update(value)
            elif len(path) == 3:
                parts.setdefault(path[1], {})[str(path[2])] = value
    faults = [dict(fault) for fault in listed if isinstance(fault, dict)]
    for i, part in sorted(parts.items()):
        if i < len(faults):
            faults[i].update(part)
        else:
            faults.append(part)
    for fault in faults:
        at_s = fault.get("at_s", 0.0)
        onset_s = float(at_s) if isinstance(at_s, int | float) else 0.0
        yield str(fault.get("kind", "(as in the base)")), str(fault.get("unit", "(as in the base)")), onset_s


@lru_cache(maxsize=4096)
def _read(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        pass
    try:
        return yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except (yaml.YAMLError, ValueError):
        return None
