"""How far a campaign is, on stderr: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import os
import sys
import time
from collections import Counter
from typing import Any, Final, Protocol

from tools.campaign.results import OUTCOMES, RunResult

LINE_EVERY_S: Final = 10.0


class Progress(Protocol):
    """Is told of every run."""

    def expect(self, runs: int | None, done: int) -> None:
        """There are so many runs (None: nobody knows yet), of which so many were done before."""

    def note(self, result: RunResult) -> None:
        """A run is done."""

    def say(self, words: str) -> None:
        """Something for people to know."""

    def close(self) -> None:
        """No more will come."""


class Silence:
    """For -q: nothing but what is said."""

    def expect(self, runs: int | None, done: int) -> None:
        """Nobody wants to know."""

    def note(self, result: RunResult) -> None:
        """Nobody wants to know."""

    def say(self, words: str) -> None:
        """Warnings are no progress."""
        print(f"hilsat campaign: {words}", file=sys.stderr, flush=True)

    def close(self) -> None:
        """Nothing was opened."""


class Lines:
    """For a file or a pipe: a line every LINE_EVERY_S, and one at the end."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._runs: int | None = None
        self._before = 0
        self._started_s = self._last_s = time.monotonic()
        self._told = -1

    def expect(self, runs: int | None, done: int) -> None:
        self._runs, self._before = runs, done

    def note(self, result: RunResult) -> None:
        self._counts[result.outcome] += 1
        if time.monotonic() >= self._last_s + LINE_EVERY_S:
            self._tell()

    def say(self, words: str) -> None:
        print(f"hilsat campaign: {words}", file=sys.stderr, flush=True)

    def close(self) -> None:
        if (self._told >= 0 or self._counts) and self._told != sum(self._counts.values()):
            self._tell()

    def _tell(self) -> None:
        self._last_s = now_s = time.monotonic()
        count = self._told = sum(self._counts.values())
        rate = count / max(now_s - self._started_s, 1e-9)
        of, left = "", ""
        if self._runs is not None:
            of = f" of {self._runs}"
            left_s = (self._runs - self._before - count) / rate if rate else 0.0
            left = f", about {format_time(left_s)} left" if left_s > 0.0 else ""
        words = f"{self._before + count}{of} runs, {rate:.2g}/s{left}: {describe_counts(self._counts)}"
        print(f"  {words}", file=sys.stderr, flush=True)


class Bar:
    """For a terminal."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            TextColumn,
            TimeRemainingColumn,
        )
        from rich.progress import (
            Progress as RichProgress,
        )

        self._counts: Counter[str] = Counter()
        self._started_s = time.monotonic()
        self._progress: Any = RichProgress(
            TextColumn("  runs"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(), TextColumn("{task.fields[counts]}"), console=Console(stderr=True), transient=False,
        )  # fmt: skip
        self._task = self._progress.add_task("runs", total=None, rate="", counts="")
        self._progress.start()

    def expect(self, runs: int | None, done: int) -> None:
        self._progress.update(self._task, total=runs, completed=done)

    def note(self, result: RunResult) -> None:
        self._counts[result.outcome] += 1
        rate = sum(self._counts.values()) / max(time.monotonic() - self._started_s, 1e-9)
        self._progress.update(self._task, advance=1, rate=f"{rate:.2g}/s", counts=describe_counts(self._counts))

    def say(self, words: str) -> None:
        self._progress.console.print(f"hilsat campaign: {words}", markup=False, highlight=False)

    def close(self) -> None:
        self._progress.stop()


def make_progress(quiet: bool) -> Progress:
    """What suits whoever reads stderr."""
    if quiet:
        return Silence()
    return Bar() if sys.stderr.isatty() and os.environ.get("TERM") != "dumb" else Lines()


def describe_counts(counts: Counter[str]) -> str:
    """3 pass, 1 fail."""
    return ", ".join(f"{counts[outcome]} {outcome}" for outcome in OUTCOMES if counts[outcome]) or "none yet"


def format_time(seconds: float) -> str:
    """Roughly, for people."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    if seconds < 5400.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"
