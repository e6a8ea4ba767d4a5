"""Which runs of a campaign keep their logs: none, all, those that did not pass, or the worst."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

from bus.errors import UsageError
from tools.campaign.results import RunResult
from tools.campaign.summary import rank_worst

NONE, FAILURES, ALL = "none", "failures", "all"
_WORST: Final = re.compile(r"worst[ :=]?([1-9][0-9]{0,5})")


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
