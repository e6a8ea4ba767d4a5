"""Who failed first: what the supervisor sees of the processes of a run, and in which order it tells of it.

Nobody who is well is named. The dead get no grace; the others get a moment to say what they saw.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tools.run.children import Process

GRACE_S = 0.5  # after one process failed, how long the others may take to say what they saw of it
STOPPED_S = 1.0  # a process that a signal has held for so long is taken to be lost
SIDE_PATIENCE_S = 4.0  # how long a side may take to end once the plant has run its last tick
RECORDER_PATIENCE_S = 10.0  # how long the recorder may take to finish the file once both sides have ended
START_S = 30.0  # how long the plant may take to come up: a slow machine, an emulated one, has much to import
STILL_S = 12.0  # without progress from then on, it is taken to hang
FELT = ("PeerLostError", "BusLostError", "RecordError")  # they tell of another process than the one that has them

LOST, ERROR, EARLY, VICTIM = range(4)  # how a process failed, the most telling first


@dataclass(frozen=True, slots=True)
class Failure:
    """One process that failed, and how: LOST, ERROR, EARLY or VICTIM."""

    process: Process
    how: int
    fate: str


class Watch:
    """Looks at the processes of a run again and again. Times are seconds of one monotonic clock."""

    def __init__(self, sides: Sequence[Process], recorders: Sequence[Process]) -> None:
        self._sides = sides
        self._recorders = recorders
        self._stopped_since_s: dict[str, float] = {}
        self._failed_s: float | None = None
        self._finished_s: float | None = None
        self._sides_ended_s: float | None = None
        self._failures: dict[str, Failure] = {}  # by name, in the order in which they were seen

    def look(self, now_s: float, finished: bool, codes: Sequence[int | None]) -> bool:
        """Whether there is nothing more to wait for: all have ended, or one failed and the others had their moment.

        finished : the plant has run its last tick
        codes    : of the sides, then of the recorders, read before `finished` was
        """
        if finished:
            self._finished_s = self._finished_s or now_s
        if None not in codes[: len(self._sides)]:
            self._sides_ended_s = self._sides_ended_s or now_s
        for process, code in zip((*self._sides, *self._recorders), codes, strict=True):
            if process.name not in self._failures:
                self._look_at(process, code, now_s)
        if self._failures:
            self._failed_s = self._failed_s or now_s
            if any(process.code is None and process.name in self._failures for process in self._sides):
                return True  # held or hanging: no one else has words for that
        over_s = None if self._failed_s is None else self._failed_s + GRACE_S
        return None not in codes or (over_s is not None and now_s >= over_s)

    def _look_at(self, process: Process, code: int | None, now_s: float) -> None:
        if code is None:
            self._look_at_living(process, now_s)
        elif code < 0:
            self._fail(process, LOST, process.fate())
        elif code > 0:
            self._fail(process, ERROR, process.fate())
        elif self._finished_s is None:
            self._fail(process, EARLY, f"{process.fate()} before the run was over")

    def _look_at_living(self, process: Process, now_s: float) -> None:
        if process.stopped:
            since_s = self._stopped_since_s.setdefault(process.name, now_s)
            if now_s - since_s >= STOPPED_S:
                self._fail(process, LOST, process.fate())
            return
        self._stopped_since_s.pop(process.name, None)
        is_side = process in self._sides
        since, patience_s, what = (
            (self._finished_s, SIDE_PATIENCE_S, "the last tick")
            if is_side
            else (self._sides_ended_s, RECORDER_PATIENCE_S, "both sides ended")
        )
        if since is not None and now_s - since > patience_s:
            self._fail(process, LOST, f"{process.fate()} {patience_s:g} s after {what}")

    def _fail(self, process: Process, how: int, fate: str) -> None:
        self._failures[process.name] = Failure(process, how, fate)

    def list_failures(self, errors: dict[str, str]) -> list[Failure]:
        """The failures, the culprit first; who merely ended because another failed is left out.

        errors : the kind of error that a process said it ended with, by its name
        """
        told = [
            Failure(f.process, VICTIM, f.fate) if f.how == ERROR and errors.get(f.process.name) in FELT else f
            for f in self._failures.values()
        ]
        told.sort(key=lambda failure: failure.how)
        return [failure for failure in told if failure.how != EARLY or told[0].how == EARLY]
