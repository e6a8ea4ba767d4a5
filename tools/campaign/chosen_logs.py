"""Which runs of a campaign keep their logs: none, all, those that did not pass, or the worst."""

from __future__ import annotations

import math
import re
import statistics
from collections.abc import Iterable, Mapping
from typing import Final

from bus.errors import UsageError
from tools.campaign.results import RunResult

NONE, FAILURES, ALL = "none", "failures", "all"
_WORST: Final = re.compile(r"worst[ :=]?([1-9][0-9]{0,5})")
BADNESS: Final = {"fail": 0, "not executed": 1, "pass": 2}


def check_keeping(words: str) -> str:
    """The words as they are understood. Raises UsageError for others."""
    if words in (NONE, FAILURES, ALL):
        return words
    match = _WORST.fullmatch(words)
    if match is None:
        raise UsageError(f"keep logs of {words[:40]!r}: give none, failures, all, or worst N, such as worst 10")
    return f"worst {match[1]}"


def choose_logs(words: str, results: Mapping[int, RunResult]) -> set[int]:
    """Numbers of the runs whose logs are kept; one that could not be flown has none."""
    flown = [result for result in results.values() if result.outcome != "infra"]
    if words == ALL:
        return {result.number for result in flown}
    if words == FAILURES:
        return {result.number for result in flown if result.outcome != "pass"}
    if words == NONE:
        return set()
    return {result.number for result in rank_worst(flown)[: int(words.split()[1])]}


def rank_worst(results: Iterable[RunResult]) -> list[RunResult]:
    """The runs, worst first: fails, then what was not executed, then passes; in each, the smallest margin first.

    Margins have different units. Each is measured by the median size of the margins of its requirement over all these runs,
    and the smallest of a run counts.
    """
    runs = list(results)
    sizes: dict[tuple[str, str], list[float]] = {}
    for result in runs:
        for verdict in result.verdicts:
            if verdict.margin is not None:
                sizes.setdefault((verdict.id, verdict.name), []).append(abs(verdict.margin))
    # One whose margin never changes, such as the number of ticks that are missing, says nothing of which run is worse.
    scales = {
        key: statistics.median(values) or max(values) for key, values in sizes.items() if max(values) > min(values)
    }

    def rank(result: RunResult) -> tuple[int, float, int]:
        margins = [
            verdict.margin / scales[key] for verdict in result.verdicts
            if verdict.margin is not None and (key := (verdict.id, verdict.name)) in scales
        ]  # fmt: skip
        return BADNESS.get(result.outcome, 3), min(margins, default=math.inf), result.number

    return sorted(runs, key=rank)
