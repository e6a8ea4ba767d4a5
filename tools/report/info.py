"""What a log holds, how the run ended and what came of it, on one screen. From the log alone; nothing is judged anew."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from bus.errors import RecordError
from tools.log.completeness import check_completeness
from tools.log.mcap_reader import Run

GRADE: Final = "grade.json"
SHOWN: Final = 8  # of anything there can be many of
WARNING: Final = 3  # level of foxglove.Log
PROVENANCE: Final = ("start_utc", "host", "python", "build", "git_rev", "versions")
SETTING: Final = ("clock", "bus", "tick_hz", "seed", "run_hash")


@dataclass(frozen=True, slots=True)
class FaultStory:
    """One fault and when what became of it [s]."""

    id: str
    unit: str
    kind: str
    onset_s: float | None
    effect_s: float | None
    end_s: float | None
    by: str  # how it ended, or why it was refused


@dataclass(frozen=True, slots=True)
class LogInfo:
    """What `hilsat info` says of a log."""

    log: str
    bytes: int
    scenario: str
    run: dict[str, str]  # the metadata of the run: setting and provenance
    simulated_s: float
    ended: str  # in words
    finished: bool  # the file was closed and both sides said that they were done
    missing: tuple[str, ...]  # what the log lacks, in words
    outcome: str | None  # of the grade that the run left in it; None: none there
    requirements: tuple[int, int] | None  # met, of how many
    failed: tuple[str, ...]  # requirements that were not met
    faults: tuple[FaultStory, ...]
    warnings: tuple[str, ...]  # events of the level of warnings and above
    topics: dict[str, int]  # messages by topic
    attachments: dict[str, int]  # bytes by name

    def as_dict(self) -> dict[str, Any]:
        """In JSON types."""
        return asdict(self)


def collect_info(run: Run) -> LogInfo:
    """Everything about an opened log that fits on a screen."""
    meta = run.metadata.get("run", {})
    faults = tell_faults(run.faults)  # JSON topics first: what is damaged in them is counted as they are read
    warnings = tuple(
        f"{event['t_ns'] / 1e9:.2f} s  {event['name']}: {event['message']}"
        for event in run.events
        if event["level"] >= WARNING
    )
    outcome, counts, failed = _read_grade(run)
    ended, finished = _tell_end(run)
    length_s = _find_length_s(run)
    return LogInfo(
        log=str(run.path),
        bytes=Path(run.path).stat().st_size,
        scenario=meta.get("scenario", ""),
        run={key: meta[key] for key in (*SETTING, *PROVENANCE) if meta.get(key)},
        simulated_s=length_s,
        ended=ended,
        finished=finished,
        missing=tuple(check_completeness(run).describe()) or (() if length_s else ("every tick of a run",)),
        outcome=outcome,
        requirements=counts,
        failed=failed,
        faults=faults,
        warnings=warnings,
        topics={name: run.count(name) for name in run.topics},
        attachments={name: len(data) for name, data in run.attachments.items()},
    )


def _find_length_s(run: Run) -> float:
    """Up to when the log goes [s], one tick beyond its last."""
    try:
        tick_hz = float(run.metadata.get("run", {}).get("tick_hz", "0"))
    except ValueError:
        return 0.0
    last = max(
        (int(run.ticks(name).max()) for name in run.topics if run.has(name) and name[:5] in ("/trut", "/fsw/")),
        default=-1,
    )
    return (last + 1) / tick_hz if tick_hz > 0.0 else 0.0


def _tell_end(run: Run) -> tuple[str, bool]:
    """How recording ended, in words, and whether that was as it should be."""
    if not run.complete:
        return "cut: the recorder was killed or the disk was full; `hilsat recover` makes the file whole", False
    recording = run.metadata.get("recording", {})
    ends = {side: recording.get(f"ended_{source}", "") for source, side in (("1", "plant"), ("2", "flight software"))}
    odd = [f"{side}: {word or 'without a word'}" for side, word in ends.items() if word != "done"]
    if not recording:
        return "closed", True
    return ("closed; " + ", ".join(odd), False) if odd else ("closed; both sides were done", True)


def _read_grade(run: Run) -> tuple[str | None, tuple[int, int] | None, tuple[str, ...]]:
    """The verdict that the run left in its log."""
    try:
        data = run.attachment(GRADE)
        grade = json.loads(data) if data is not None else None
        verdicts = [(str(item["name"]), bool(item["passed"])) for item in grade["verdicts"]] if grade else []
        outcome = str(grade["outcome"]) if grade else None
    except (RecordError, ValueError, KeyError, TypeError):
        return "unreadable", None, ()
    if outcome is None:
        return None, None, ()
    return outcome, (sum(ok for _, ok in verdicts), len(verdicts)), tuple(name for name, ok in verdicts if not ok)


def tell_faults(records: list[dict[str, Any]]) -> tuple[FaultStory, ...]:
    """What became of each fault, in the order of their first records."""
    stories: dict[str, dict[str, Any]] = {}
    times = {"onset_s": None, "effect_s": None, "end_s": None, "by": ""}
    for record in records:
        asked = str(record.get("id") or "")
        key = f"{asked} refused at tick {record['tick']}".strip() if record["phase"] == "refused" else asked
        story = stories.setdefault(key, {"id": key, "unit": record["unit"], "kind": record["fault"], **times})
        t_s, phase = record["t_ns"] / 1e9, record["phase"]
        if phase in ("onset", "effect"):
            story[f"{phase}_s"] = t_s if story[f"{phase}_s"] is None else story[f"{phase}_s"]
        elif phase in ("end", "cleared"):
            story["end_s"], story["by"] = t_s, phase
        else:
            story["by"] = f"{phase}: {record.get('message', '')}"
    return tuple(FaultStory(**story) for story in stories.values())


# -- for people ----------------------------------------------------------------------------------------------------


def format_info(info: LogInfo) -> str:
    """One screen."""
    run = info.run
    rows = [
        ("log", f"{info.log}, {info.bytes / 1e6:.1f} MB"),
        ("scenario", info.scenario or "not said"),
        ("verdict", _describe_verdict(info)),
        ("ended", info.ended),
        ("length", f"{info.simulated_s:g} s simulated"),
        ("missing", _cut(info.missing) or "nothing"),
        ("clock, bus", ", ".join(run[key] for key in ("clock", "bus") if key in run)),
        ("seed, hash", ", ".join(run[key] for key in ("seed", "run_hash") if key in run)),
        ("started", ", ".join(run[key] for key in ("start_utc", "host") if key in run)),
        ("made by", ", ".join(f"{key} {run[key]}" for key in ("python", "build", "git_rev") if key in run)),
        ("versions", run.get("versions", "not said")),
    ]
    lines = [f"{name:<11}{_plain(text)}" for name, text in rows if text]
    lines += _list_some("faults", [_describe_fault(fault) for fault in info.faults])
    lines += _list_some("warnings", list(info.warnings))
    lines += ["topics"]
    width = max((len(name) for name in info.topics), default=0)
    cells = [f"{name:<{width}} {count:>9}" for name, count in sorted(info.topics.items())]
    half = -(-len(cells) // 2)
    lines += ["  " + "   ".join(_plain(cell) for cell in cells[i::half]) for i in range(half)]
    lines += ["attached   " + ", ".join(f"{_plain(name)} ({size} bytes)" for name, size in info.attachments.items())]
    return "\n".join(lines)


def _describe_verdict(info: LogInfo) -> str:
    if info.outcome is None and "scenario.yaml" not in info.attachments:
        return "none: the log carries no scenario to grade it against"
    if info.outcome is None:
        return "not graded when it was made; `hilsat grade` grades it"
    counts = f", {info.requirements[0]} of {info.requirements[1]} requirements met" if info.requirements else ""
    missed = f": {_cut(info.failed)}" if info.failed else ""
    return info.outcome.upper() + counts + missed


def _describe_fault(fault: FaultStory) -> str:
    times = [
        f"{word} {value:g} s"
        for word, value in (("onset", fault.onset_s), ("effect", fault.effect_s), (fault.by or "end", fault.end_s))
        if value is not None
    ]
    if fault.onset_s is None and fault.by:
        times.append(fault.by)
    elif fault.effect_s is None:
        times.append("NO EFFECT")
    return f"{fault.id}: {fault.unit} {fault.kind}: {', '.join(times)}"


def _list_some(name: str, items: list[str]) -> list[str]:
    if not items:
        return [f"{name:<11}none"]
    rest = [f"  and {len(items) - SHOWN} more (--json has all)"] if len(items) > SHOWN else []
    return [f"{name:<11}{len(items)}", *[f"  {_plain(item)}" for item in items[:SHOWN]], *rest]


def _cut(items: tuple[str, ...]) -> str:
    return "; ".join(items[:3]) + (f"; and {len(items) - 3} more" if len(items) > 3 else "")


def _plain(text: str) -> str:
    """The text with what would start a line of its own or move the cursor shown as ?, and not longer than a screen takes."""
    clean = "".join(letter if letter.isprintable() else "?" for letter in text)
    return clean if len(clean) <= 200 else clean[:197] + "..."
