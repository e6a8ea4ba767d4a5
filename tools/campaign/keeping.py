"""The directory of a campaign while it is flown: results as they come, each on the disk before the next is taken.

One process at a time has it. At the end, and when a campaign is stopped, the results are put in the order of their numbers.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any, Final

from bus.errors import RecordError, UsageError
from tools.campaign.fly import Flown
from tools.campaign.plan import RunPlan
from tools.campaign.results import (
    FOUND_FILE,
    INFO_FILE,
    LOG_DIR,
    RESULTS_FILE,
    TIMINGS_FILE,
    CampaignInfo,
    RunResult,
    read_results,
    to_line,
)

LOCK_FILE: Final = "campaign.lock"
BASES_FILE: Final = "bases.json"  # the base scenarios as they were flown: name -> text
TRACE_DIR: Final = "traces"  # NUMBER.txt of runs that ended in what nobody foresaw


class Store:
    """Takes results in and gives them out by number. Raises RecordError for what cannot be written."""

    def __init__(self, directory: Path) -> None:
        """directory: of a campaign that was begun, see `begin`; use as a context, which locks it."""
        self.directory = directory
        self.results: dict[int, RunResult] = {}
        self.traces = 0
        self._results_file: IO[bytes] | None = None
        self._timings_file: IO[bytes] | None = None

    @classmethod
    @contextlib.contextmanager
    def open(cls, directory: Path) -> Iterator[Store]:
        """Yield the store of a directory, read and locked; in order at the end, whatever ends the body.

        Raises UsageError where another process has it.
        """
        store = cls(directory)
        with lock(directory):
            if (directory / RESULTS_FILE).is_file():
                store.results = {result.number: result for result in read_results(directory)}
            store.put_in_order()  # cuts off what a kill left of a line
            with contextlib.ExitStack() as stack:
                with _writing(directory):
                    store._results_file = stack.enter_context(open(directory / RESULTS_FILE, "ab", buffering=0))
                    store._timings_file = stack.enter_context(open(directory / TIMINGS_FILE, "ab", buffering=0))
                try:
                    yield store
                finally:
                    stack.close()
                    store.put_in_order()

    def add(self, flown: Flown) -> None:
        """Write one result, and what it cost."""
        result = flown.result
        with _writing(self.directory):
            if flown.log is not None and result.log:
                write_whole(self.directory / result.log, flown.log)
            if flown.trace:
                (self.directory / TRACE_DIR).mkdir(exist_ok=True)
                (self.directory / TRACE_DIR / f"{result.number}.txt").write_text(flown.trace, errors="backslashreplace")
                self.traces += 1
            _append(self._results_file, to_line(result))
            _append(self._timings_file, to_line(flown.timing))
        self.results[result.number] = result

    def replace(self, result: RunResult) -> None:
        """Put a result in the place of the one of the same number."""
        with _writing(self.directory):
            _append(self._results_file, to_line(result))
        self.results[result.number] = result

    def find(self, plan: RunPlan) -> RunResult | None:
        """The result of a run that was flown before; None for one that was not.

        Raises UsageError when the run of this number was another one.
        """
        result = self.results.get(plan.number)
        if result is None:
            return None
        there = (result.base, tuple(result.overrides), result.seed)
        if there != (plan.base, tuple(plan.overrides), plan.seed):
            raise UsageError(
                f"{self.directory}: run {plan.number} was flown with other settings than it has now "
                f"({_differ(result, plan)}); this is not the campaign that was begun there"
            )
        return result

    def forget(self, numbers: set[int]) -> None:
        """Let these runs be flown again."""
        self.results = {number: result for number, result in self.results.items() if number not in numbers}

    def put_in_order(self) -> None:
        """Write the results by number, whole or not at all."""
        text = "".join(to_line(self.results[number]) for number in sorted(self.results))
        with _writing(self.directory):
            write_whole(self.directory / RESULTS_FILE, text.encode())

    def write_found(self, found: Mapping[str, Any]) -> None:
        """Write what the strategy found."""
        with _writing(self.directory):
            text = json.dumps(found, allow_nan=False, ensure_ascii=False, indent=1)
            write_whole(self.directory / FOUND_FILE, text.encode() + b"\n")


def begin(directory: Path, info: CampaignInfo, bases: Mapping[str, str]) -> None:
    """Make the directory of a new campaign. Raises UsageError for one that has a campaign or anything else in it."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        if (directory / INFO_FILE).exists():
            raise UsageError(
                f"{directory}: there is a campaign in it already; go on with --resume, or name another one"
            )
        if any(entry.name != LOCK_FILE for entry in directory.iterdir()):
            raise UsageError(f"{directory}: is not empty; name another directory with --out")
        with lock(directory):
            (directory / LOG_DIR).mkdir()
            write_whole(directory / BASES_FILE, json.dumps(bases, ensure_ascii=False).encode() + b"\n")
            text = json.dumps(asdict(info), allow_nan=False, ensure_ascii=False, indent=1)
            write_whole(directory / INFO_FILE, text.encode() + b"\n")
    except (OSError, ValueError) as error:
        raise UsageError(
            f"{directory}: cannot be made the directory of a campaign: {_reason(error)}; name another one with --out"
        ) from None


def read_bases(directory: Path) -> dict[str, str]:
    """The base scenarios of a campaign, as texts. Raises RecordError when they cannot be read."""
    path = directory / BASES_FILE
    try:
        bases = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RecordError(f"{path}: {_reason(error)}; it is not the directory of a campaign") from None
    if not isinstance(bases, dict):
        raise RecordError(f"{path}: is not what `hilsat campaign` writes")
    return {str(name): str(text) for name, text in bases.items()}


@contextlib.contextmanager
def lock(directory: Path) -> Iterator[None]:
    """Have the directory for this process alone; the system takes the lock off when it ends, however it ends.

    Raises UsageError where another process has it.
    """
    try:
        fd = os.open(directory / LOCK_FILE, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise UsageError(f"{directory}: cannot be written to: {_reason(error)}; name another one with --out") from None
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        raise UsageError(f"{directory}: another process flies this campaign; wait for it, or stop it") from None
    finally:
        os.close(fd)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file whole or not at all, over one that is there. Raises OSError."""
    part = path.with_name(f".{path.name}.part")
    try:
        with open(part, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError:
        with contextlib.suppress(OSError):
            part.unlink()
        raise


@contextlib.contextmanager
def _writing(directory: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise RecordError(
            f"{directory}: the results cannot be written: {_reason(error)}; what is there stays, go on with "
            f"hilsat campaign --resume {directory}"
        ) from None


def _append(file: IO[bytes] | None, line: str) -> None:
    """Append a line, whole; what a full disk took of one is cut off again."""
    assert file is not None
    data = line.encode()
    size = os.fstat(file.fileno()).st_size
    try:
        if file.write(data) != len(data):
            raise OSError(28, os.strerror(28))
    except OSError:
        with contextlib.suppress(OSError):
            os.ftruncate(file.fileno(), size)
        raise


def _differ(result: RunResult, plan: RunPlan) -> str:
    if result.base != plan.base:
        return f"base {result.base}, now {plan.base}"
    if result.seed != plan.seed:
        return f"seed {result.seed}, now {plan.seed}"
    pairs = zip((*result.overrides, ""), (*plan.overrides, ""), strict=False)
    before, now = next((pair for pair in pairs if pair[0] != pair[1]), ("", ""))
    return f"{before or 'nothing'}, now {now or 'nothing'}"


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
