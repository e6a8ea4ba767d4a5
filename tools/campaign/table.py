"""A campaign and a comparison in words and tables, for terminals (rich) and pipes (plain text)."""

from __future__ import annotations

import io
import math
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

from tools.campaign.comparison import ALL_RUNS, Change, Comparison
from tools.campaign.results import RunResult
from tools.campaign.statistics import Tally
from tools.campaign.summary import (
    WORDS,
    Cell,
    Loaded,
    Matrix,
    make_matrix,
    name_troubles,
)

STYLES: Final = {"PASS": "green", "FAIL": "bold red", "NOT EXECUTED": "yellow", "INFRA": "magenta", "worse": "bold red",
                 "better": "green", "lost": "magenta"}  # fmt: skip
SHOWN_REASONS: Final = 5


@dataclass(frozen=True, slots=True)
class Grid:
    """A table, or lines of words where it has no headings."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def say_rate(tally: Tally) -> str:
    """Rate and interval of the judged runs: `83.3 % [51.6, 97.9]`."""
    if tally.rate is None:
        return "none judged"
    low, high = tally.interval()  # rounded outwards: never narrower than it is
    return f"{100.0 * tally.rate:.1f} % [{math.floor(1e3 * low) / 10.0:.1f}, {math.ceil(1e3 * high) / 10.0:.1f}]"


def say_cell(cell: Cell | None) -> str:
    """A cell of a matrix in words."""
    if cell is None:
        return "-"
    tally = cell.tally
    words = f"{WORDS[cell.outcome]} {tally.passed}/{tally.judged}"
    return words + (f" +{tally.infra} INFRA" if tally.infra and tally.judged else "")


def describe_tally(tally: Tally, missing: int = 0) -> list[str]:
    """How the runs came off, and both rates where they differ."""
    lines = [
        f"{tally.planned} runs: {tally.passed} PASS, {tally.failed} FAIL, {tally.not_executed} NOT EXECUTED, "
        f"{tally.infra} INFRA",
        f"pass rate {say_rate(tally)} of {tally.judged} judged runs (95 % Clopper-Pearson)",
    ]
    if tally.infra and tally.least_rate is not None:
        low = Tally(tally.passed, tally.planned - tally.passed)
        lines.append(f"at least {say_rate(low)} if every INFRA run had failed")
    if missing:
        lines.append(f"{missing} runs of the plan have no result: the campaign was not flown to its end")
    return lines


def list_grids(loaded: Loaded, rows: str | None, columns: str | None, worst: int) -> Iterator[Grid]:
    """Everything that `show` says of a campaign."""
    info = loaded.info
    title = f"{info.name}: {info.title}" if info.title else info.name
    yield Grid(title, (), _lines(describe_tally(loaded.tally, loaded.missing)))
    if found := loaded.found.get("summary"):
        yield Grid("Found", (), _lines([str(line) for line in found]))
    if loaded.list_axes or rows or columns:
        yield _lay_out(make_matrix(loaded, rows, columns))
    yield _list_verdicts(loaded)
    if picked := loaded.worst_first[:worst]:
        yield Grid(
            "Worst runs",
            ("outcome", "repeat with", "values", "why"),
            tuple((WORDS[r.outcome], loaded.command(r), say_labels(r), name_troubles(r)) for r in picked),
        )
    if reasons := list_reasons(loaded):
        yield Grid("INFRA", ("runs", "reason", "such as"), tuple(reasons))


def _list_verdicts(loaded: Loaded) -> Grid:
    return Grid(
        "Requirements",
        ("passed", "judged", "rate [95 %]", "smallest margin", "in run", "requirement"),
        tuple(
            (
                str(item.tally.passed),
                str(item.tally.judged),
                say_rate(item.tally),
                "-" if item.smallest is None else f"{item.smallest:+.3g} {item.unit}".strip(),
                "-" if item.worst is None else f"#{item.worst.number}",
                item.title,
            )
            for item in loaded.requirements
        ),
    )


def say_labels(result: RunResult) -> str:
    """Where in the space of the axes a run is."""
    return ", ".join(f"{axis}={label}" for axis, label in result.labels.items())


def list_reasons(loaded: Loaded) -> list[tuple[str, str, str]]:
    """Why runs could not be flown or judged, the most frequent reasons first, with an example of each."""
    seen: dict[str, list[int]] = {}
    for result in loaded.results:
        if result.outcome == "infra":
            seen.setdefault(" ".join(result.reason.split()) or "no reason given", []).append(result.number)
    ranked = sorted(seen.items(), key=lambda item: -len(item[1]))
    rows = [(str(len(numbers)), reason, f"#{numbers[0]}") for reason, numbers in ranked[:SHOWN_REASONS]]
    if len(ranked) > SHOWN_REASONS:
        rest = ranked[SHOWN_REASONS:]
        rows.append((str(sum(len(n) for _, n in rest)), f"{len(rest)} other reasons", f"#{rest[0][1][0]}"))
    return rows


def _lay_out(matrix: Matrix) -> Grid:
    corner = f"{matrix.rows or ''} \\ {matrix.columns}" if matrix.columns else matrix.rows
    return Grid(
        "Passed of judged runs",
        (corner, *matrix.column_labels),
        tuple(
            (row, *(say_cell(matrix.cells.get((row, column))) for column in matrix.column_labels))
            for row in matrix.row_labels
        ),
    )


def describe_loaded(loaded: Loaded, rows: str | None, columns: str | None, worst: int) -> dict[str, Any]:
    """The same in JSON types."""
    matrix = make_matrix(loaded, rows, columns)
    return {
        "name": loaded.info.name,
        "directory": str(loaded.directory),
        "missing": loaded.missing,
        **describe_count(loaded.tally),
        "found": dict(loaded.found),
        "rows": matrix.rows,
        "columns": matrix.columns,
        "cells": [
            {matrix.rows or "rows": row, matrix.columns or "columns": column, **describe_count(cell.tally)}
            for (row, column), cell in matrix.cells.items()
        ],
        "requirements": [
            {
                "requirement": item.key,
                "name": item.name,
                "unit": item.unit,
                **describe_count(item.tally),
                "smallest_margin": item.smallest,
                "worst_run": None if item.worst is None else item.worst.number,
            }
            for item in loaded.requirements
        ],
        "worst": [
            {"number": r.number, "outcome": r.outcome, "command": loaded.command(r), "why": name_troubles(r)}
            for r in loaded.worst_first[:worst]
        ],
    }


def describe_count(tally: Tally) -> dict[str, Any]:
    """Counts, rate and interval in JSON types."""
    return {
        "passed": tally.passed,
        "failed": tally.failed,
        "not_executed": tally.not_executed,
        "infra": tally.infra,
        "rate": tally.rate,
        "interval": list(tally.interval()),
    }


def list_changes(comparison: Comparison, everything: bool) -> Iterator[Grid]:
    """Everything that `diff` says."""
    worse, better = comparison.by_verdict("worse"), comparison.by_verdict("better")
    lost = comparison.by_verdict("lost")
    tests = [change for change in comparison.changes if change.test]
    pairs = sum(change.test == "mcnemar" for change in tests)
    lines = [
        f"before {comparison.before}",
        f"after  {comparison.after}",
        f"{len(tests)} tests ({pairs} of runs that match one to one by McNemar, {len(tests) - pairs} by Fisher), "
        f"corrected together (Holm) at {100.0 * comparison.alpha:g} %",
        f"{len(worse)} worse, {len(better)} better, {len(lost)} not judged any more",
        *comparison.notes,
    ]
    yield Grid("Comparison", (), _lines(lines))
    shown = worse + lost + better
    if everything:
        shown += comparison.by_verdict("no difference", "untested")
    if shown:
        yield Grid(
            "Changes" if not everything else "All tests",
            ("verdict", "cell", "requirement", "before", "after", "difference [95 %]", "p", "corrected", "test"),
            tuple(_make_change_row(change) for change in shown),
        )


def _make_change_row(change: Change) -> tuple[str, ...]:
    interval = change.interval
    difference = "-"
    if interval is not None:
        rate = (change.after.rate or 0.0) - (change.before.rate or 0.0)
        difference = f"{100.0 * rate:+.1f} % [{100.0 * interval[0]:+.1f}, {100.0 * interval[1]:+.1f}]"
    return (
        change.verdict,
        change.cell if change.labels else ALL_RUNS,
        change.requirement,
        f"{change.before.passed}/{change.before.judged}",
        f"{change.after.passed}/{change.after.judged}",
        difference,
        f"{change.p_value:.2g}" if change.test else "-",
        f"{change.adjusted:.2g}" if change.test else "-",
        change.test or "-",
    )


def _lines(lines: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    return tuple((line,) for line in lines)


# -- printing ------------------------------------------------------------------------------------------------------


def print_grids(grids: Sequence[Grid]) -> None:
    """Tables with frames and colours on a terminal, lines of plain text anywhere else."""
    if sys.stdout.isatty() and os.environ.get("TERM") != "dumb":
        from rich.console import Console

        console = Console()
        for grid in grids:
            console.print(*_make_rich(grid), sep="\n")
        return
    print("\n\n".join(to_text(grid) for grid in grids), flush=True)


def _make_rich(grid: Grid) -> list[Any]:
    from rich.table import Table
    from rich.text import Text

    title = Text(grid.title, style="bold")
    if not grid.headings:
        return [title, *(Text(f"  {row[0]}") for row in grid.rows), Text()]
    table = Table(title=title, title_justify="left", header_style="bold")
    for heading in grid.headings:
        table.add_column(Text(heading), overflow="fold")
    for row in grid.rows:
        table.add_row(*(Text(cell, style=_find_style(cell)) for cell in row))
    return [table, Text()]


def _find_style(cell: str) -> str:
    return next((style for word, style in STYLES.items() if cell.startswith(word)), "")


def to_text(grid: Grid) -> str:
    """A table as aligned lines, the same wherever it is printed; the last column is as long as it is."""
    out = io.StringIO()
    out.write(f"{grid.title}\n")
    if not grid.headings:
        out.write("\n".join(f"  {row[0]}" for row in grid.rows))
        return out.getvalue()
    table = [grid.headings, *grid.rows]
    widths = [max(len(cell) for cell in column) for column in zip(*table, strict=True)]
    lines = [
        "  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in table
    ]
    out.write("\n".join(lines))
    return out.getvalue()
