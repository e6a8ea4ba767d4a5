"""What is kept of a campaign: a directory with one JSON line a run, which says nothing that depends on who flew it.

campaign.json   what was asked: CampaignInfo
results.jsonl   one RunResult a line, appended and flushed as runs end; in the order of their numbers at the end
timings.jsonl   one Timing a line: wall and processor time of each run, and by which worker
logs/           NUMBER.mcap of the runs whose logs are kept
found.json      what the strategy found: a boundary, an interval, a worst case
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Final, Literal

from bus.errors import RecordError

INFO_FILE: Final = "campaign.json"
RESULTS_FILE: Final = "results.jsonl"
TIMINGS_FILE: Final = "timings.jsonl"
FOUND_FILE: Final = "found.json"
LOG_DIR: Final = "logs"
Outcome = Literal["pass", "fail", "not executed", "infra"]
OUTCOMES: Final[tuple[Outcome, ...]] = ("pass", "fail", "not executed", "infra")


@dataclass(frozen=True, slots=True, kw_only=True)
class RequirementInfo:
    """One requirement that the runs of a campaign are judged by."""

    name: str
    id: str = ""
    bound: str = ""  # in words
    unit: str = ""  # of value and margin


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisInfo:
    """One axis: what runs differ in."""

    name: str
    kind: str  # values, uniform, normal, ...
    key: str = ""  # where it goes in the scenario
    labels: tuple[str, ...] = ()  # of a list, in its order; empty where values are drawn
    unit: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignInfo:
    """What was asked, and of which version of the bench."""

    name: str
    title: str
    seed: int
    file: str  # text of the campaign file, comments included
    bases: tuple[str, ...]
    axes: tuple[AxisInfo, ...]
    runs: int | None  # planned; None: the strategy decides
    strategy: str  # plan, until, boundary, worst
    metrics: Mapping[str, str] = field(default_factory=dict)  # name -> unit, of the metrics beside the requirements
    provenance: Mapping[str, str] = field(default_factory=dict)  # version, commit, build, python, host, started


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """One verdict on one run."""

    name: str
    outcome: Outcome
    value: float | None
    margin: float | None
    id: str = ""
    bound: str = ""
    unit: str = ""
    detail: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunResult:
    """What came of one run. `infra`: it could not be flown or judged, `reason` says why."""

    number: int
    values: Mapping[str, Any]  # axis -> value, in JSON types
    labels: Mapping[str, str]  # axis -> word
    repeat: int
    base: str
    overrides: tuple[str, ...]
    seed: int
    outcome: Outcome
    reason: str = ""
    verdicts: tuple[Judged, ...] = ()
    metrics: Mapping[str, float | None] = field(default_factory=dict)
    digest: str = ""  # of the deterministic content of its log, where a log was made
    log: str = ""  # relative path of the kept log


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """What a run cost. It differs from machine to machine and is no part of the results."""

    number: int
    wall_s: float
    cpu_s: float
    ticks: int
    worker: str


def to_line(record: RunResult | Timing) -> str:
    """One line of JSON, with its line feed; keys in the order of the fields. Raises ValueError for what is no number."""
    return json.dumps(asdict(record), allow_nan=False, ensure_ascii=False, separators=(",", ":")) + "\n"


def read_info(directory: Path) -> CampaignInfo:
    """What was asked. Raises RecordError when the directory is not that of a campaign."""
    path = directory / INFO_FILE
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        axes = tuple(AxisInfo(**{**axis, "labels": tuple(axis["labels"])}) for axis in data.pop("axes"))
        return CampaignInfo(axes=axes, **{**data, "bases": tuple(data["bases"])})
    except OSError as error:
        raise RecordError(f"{path}: {error.strerror or error}; it is not the directory of a campaign") from None
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise RecordError(f"{path}: is not what `hilsat campaign` writes") from None


def read_results(directory: Path) -> list[RunResult]:
    """All results, by number. A line that was cut short by a kill is left out: that run is not finished.

    Raises RecordError for what cannot be read, and for a line in the middle that is no result.
    """
    found = {result.number: result for result in _read_lines(directory / RESULTS_FILE, _read_result)}
    return [found[number] for number in sorted(found)]


def read_timings(directory: Path) -> list[Timing]:
    """All timings, in the order in which they were written; empty where there are none."""
    path = directory / TIMINGS_FILE
    return list(_read_lines(path, lambda data: Timing(**data))) if path.is_file() else []


def _read_lines(path: Path, make: Any) -> Iterator[Any]:
    try:
        text = path.read_bytes()
    except OSError as error:
        raise RecordError(f"{path}: {error.strerror or error}") from None
    lines = text.split(b"\n")
    for i, line in enumerate(lines[:-1]):  # what stands behind the last line feed was not finished
        try:
            yield make(json.loads(line))
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            raise RecordError(f"{path}, line {i + 1}: is not what `hilsat campaign` writes") from None


def _read_result(data: dict[str, Any]) -> RunResult:
    verdicts = tuple(Judged(**item) for item in data["verdicts"])
    result = RunResult(**{**data, "verdicts": verdicts, "overrides": tuple(data["overrides"])})
    if result.outcome not in OUTCOMES or len(data) != len(fields(RunResult)):
        raise ValueError
    return result
