"""Results as one flat table, a run a row: CSV with the standard library, Parquet with pyarrow."""

from __future__ import annotations

import csv
import importlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

from bus.errors import UsageError
from tools.campaign.results import Outcome, RunResult, Timing
from tools.campaign.summary import Loaded, key_of

INSTALL = "pip install 'hilsat[parquet]'"


def make_columns(loaded: Loaded, timings: Sequence[Timing] = ()) -> dict[str, list[Any]]:
    """The table by columns, one entry a run in each.

    number, outcome, reason, base, repeat, seed, log, command, wall_s and cpu_s where there are timings; AXIS its value and
    AXIS.label where it has a name of its own; REQUIREMENT.outcome, .value and .margin; METRIC. A column whose name is
    taken by one before it gets its kind in front: axis., metric.
    """
    costs = {timing.number: timing for timing in timings}
    rows = [
        _make_row(loaded, result, outcomes, _find_cost(costs, result.number))
        for result, outcomes in zip(loaded.results, loaded.outcomes, strict=True)
    ]
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: [row.get(name) for row in rows] for name in names}


def _find_cost(costs: Mapping[int, Timing], number: int) -> dict[str, float | None]:
    """What a run cost, as columns; none where nothing is known of any run."""
    timing = costs.get(number)
    known = {name: None if timing is None else getattr(timing, name) for name in ("wall_s", "cpu_s")}
    return known if costs else {}


def _make_row(
    loaded: Loaded, result: RunResult, outcomes: Mapping[str, Outcome], cost: Mapping[str, float | None]
) -> dict[str, Any]:
    row: dict[str, Any] = {
        "number": result.number,
        "outcome": result.outcome,
        "reason": result.reason,
        "base": result.base,
        "repeat": result.repeat,
        "seed": result.seed,
        "log": result.log,
        "command": loaded.command(result),
        **cost,
    }
    for axis, value in result.values.items():
        if isinstance(value, str | int | float) or value is None:
            _add(row, axis, value, "axis")
        else:
            _add(row, axis, json.dumps(value, separators=(",", ":")), "axis")
    for axis, label in result.labels.items():
        if not isinstance(result.values.get(axis), str):
            _add(row, f"{axis}.label", label, "axis")
    for verdict in result.verdicts:
        key = key_of(verdict)
        if f"{key}.outcome" not in row:
            row[f"{key}.outcome"] = outcomes[key]
            row[f"{key}.value"] = verdict.value
            row[f"{key}.margin"] = verdict.margin
    for metric, number in result.metrics.items():
        _add(row, metric, number, "metric")
    return row


def _add(row: dict[str, Any], name: str, value: Any, kind: str) -> None:
    row[f"{kind}.{name}" if name in row else name] = value


def write_csv(path: Path, columns: Mapping[str, Sequence[Any]]) -> None:
    """Write the table as CSV (RFC 4180 but for line feeds alone); what is not known is empty."""
    with path.open("w", encoding="utf-8", newline="") as file:
        print_csv(file, columns)


def print_csv(file: TextIO, columns: Mapping[str, Sequence[Any]]) -> None:
    """The same, to what is open."""
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*(_plain(column) for column in columns.values()), strict=True))


def _plain(column: Sequence[Any]) -> Iterator[Any]:
    for value in column:
        yield repr(value) if isinstance(value, float) else "" if value is None else value


def write_parquet(path: Path, columns: Mapping[str, Sequence[Any]]) -> None:
    """Write the table as Parquet. Raises UsageError where pyarrow is not installed."""
    try:
        pyarrow = importlib.import_module("pyarrow")
        parquet = importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise UsageError(f"--parquet needs pyarrow, which is not installed: {INSTALL}; or write --csv") from None
    arrays = {name: pyarrow.array(*_typed(pyarrow, column)) for name, column in columns.items()}
    parquet.write_table(pyarrow.table(arrays), path, compression="zstd")


def _typed(pyarrow: Any, column: Sequence[Any]) -> tuple[list[Any], Any]:
    """Values and type of a column: whole numbers, numbers or texts; of mixed ones texts."""
    known = [value for value in column if value is not None]
    if known and all(isinstance(value, bool) for value in known):
        return list(column), pyarrow.bool_()
    if known and all(isinstance(value, int) and not isinstance(value, bool) for value in known):
        return list(column), pyarrow.int64()
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in known):
        numbers = [None if value is None or not math.isfinite(value) else float(value) for value in column]
        return numbers, pyarrow.float64()
    return [None if value is None else str(value) for value in column], pyarrow.string()
