"""What a log is of, beside what flies here: version, ICD, layout of topics. What differs is named before anything flies."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

from bus.errors import RecordError
from tools.log.mcap_reader import DBC_ATTACHMENT, Run
from tools.run.provenance import describe_program

SHOWN: Final = 4  # differences that are named


def describe_origin(run: Run) -> str:
    """Of which version the log is, and which this one is, in words."""
    return f"the log is of {_describe(run.metadata.get('run', {}))}, this is {_describe(describe_program())}"


def _describe(program: dict[str, str]) -> str:
    packages = dict(part.rsplit(" ", 1) for part in program.get("versions", "").split(", ") if " " in part)
    revision = program.get("git_rev", "")
    words = f"hilsat {packages.get('hilsat', 'of a version that it does not name')}"
    return f"{words}{f' ({revision})' if revision else ''}, {program.get('build', 'build not named')}"


def check_icd(run: Run, dbc: Path) -> None:
    """Raise RecordError, with the lines, where the ICD in the log says something else than the file does.

    Comments are not compared. A log without an ICD is taken as it is.
    """
    recorded = run.attachment(DBC_ATTACHMENT)
    if recorded is None:
        return
    theirs, ours = _list_rules(recorded.decode("utf-8", "replace")), _list_rules(dbc.read_text(encoding="utf-8"))
    if theirs == ours:
        return
    lines = [
        f"{'the log' if line[0] == '-' else 'here'}: {line[1:].strip()}"
        for line in difflib.unified_diff(theirs, ours, lineterm="", n=0)
        if line[0] in "-+" and not line.startswith(("---", "+++"))
    ]
    raise RecordError(
        f"{run.path}: its ICD ({DBC_ATTACHMENT}) is not the one here, so its frames mean something else: "
        f"{join_some(lines)}; {describe_origin(run)}"
    )


def _list_rules(dbc: str) -> list[str]:
    """The lines of a DBC that decide what a frame means, comments left out."""
    rules, in_comment = [], False
    for line in dbc.splitlines():
        in_comment = in_comment or line.startswith("CM_ ")
        if line.strip() and not in_comment:
            rules.append(line.rstrip())
        if in_comment and line.rstrip().endswith('";'):
            in_comment = False
    return rules


def compare_layouts(topic: str, recorded: str | None, flown: str | None) -> str:
    """How the layout of a topic in the log differs from that here, in words; empty where it does not."""
    if recorded == flown:
        return ""
    if recorded is None:
        return f"{topic} is not in the log"
    if flown is None:
        return f"{topic} is in the log alone"
    theirs, ours = _list_fields(recorded), _list_fields(flown)
    gone, come = [f for f in theirs if f not in ours], [f for f in ours if f not in theirs]
    words = [f"{side} {', '.join(fields)}" for side, fields in (("the log has", gone), ("here it has", come)) if fields]
    return f"{topic}: {'; '.join(words) or 'its fields are in another order'}"


def _list_fields(schema: str) -> list[str]:
    lines = (line.split("#")[0].strip() for line in schema.split("=" * 80)[0].splitlines())
    return [line for line in lines if line]


def join_some(items: Sequence[str] | Iterable[str]) -> str:
    """The first few in one line, and how many more there are."""
    words = list(items)
    more = [f"and {len(words) - SHOWN} more"] if len(words) > SHOWN else []
    return "; ".join(words[:SHOWN] + more)
