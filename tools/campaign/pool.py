"""A pool of warm worker processes on this machine. It is known at any time who flies what.

A worker asks for a run when it is free. One that dies or hangs costs the run that it had, and is replaced.
"""

from __future__ import annotations

import contextlib
import math
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import IO, Any, Final

from bus.errors import RecordError
from bus.process import name_signal
from tools.campaign.crew import Halt, Order
from tools.campaign.fly import Flown, describe_late, fail
from tools.campaign.job import Job
from tools.campaign.results import Timing
from tools.run.children import end_with_parent

SHORT_S: Final = 0.2  # shorter runs are handed out one ahead: the way there and back would tell
START_S: Final = 60.0  # how long a worker may take to be ready
MOST_DEATHS: Final = 3  # workers in a row that die before they are ready
WORDS: Final = 300  # characters of a dead worker's last words that are told


class Worker:
    """One worker process and what it is about."""

    def __init__(self, job: Job, directory: Path) -> None:
        mine, theirs = socket.socketpair()
        self._words: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 (as long as the worker)
        try:
            self.popen = subprocess.Popen(
                [sys.executable, "-P", "-m", "tools.campaign.worker", str(theirs.fileno())],
                stdin=subprocess.DEVNULL, stdout=self._words, stderr=self._words, pass_fds=(theirs.fileno(),),
                start_new_session=True, preexec_fn=end_with_parent,
            )  # fmt: skip
        finally:
            theirs.close()
        self.connection = Connection(mine.detach())
        self.orders: deque[Order] = deque()  # the one it flies, and what it goes on with
        self.ready = False
        self.since_s = time.monotonic()  # of what it is about
        self.dead = False
        with contextlib.suppress(OSError):
            self.connection.send((job, directory))

    def give(self, order: Order) -> None:
        """Hand it a run. A worker that is gone is found out when it is listened to."""
        if not self.orders:
            self.since_s = time.monotonic()
        self.orders.append(order)
        with contextlib.suppress(OSError):
            self.connection.send(order)

    def hear(self) -> Any:
        """What it says; None when it is gone."""
        try:
            return self.connection.recv()
        except (EOFError, OSError):
            self.dead = True
            return None

    def end(self, *, kill: bool = False) -> str:
        """End it; return how it ended, in words."""
        with contextlib.suppress(OSError):
            self.connection.close()
        if kill:
            self.popen.kill()
        try:
            code = self.popen.wait(5.0)
        except subprocess.TimeoutExpired:
            self.popen.kill()
            code = self.popen.wait()
        how = f"was killed by {name_signal(-code)}" if code < 0 else f"ended with exit code {code}"
        return f"the process that flew it {how}{self._last_words()}"

    def _last_words(self) -> str:
        with self._words:
            self._words.seek(0)
            text = self._words.read().decode(errors="replace").strip()
        return f": {text[-WORDS:]}" if text else ""


class Pool:
    """Workers that fly the orders of one campaign."""

    def __init__(self, job: Job, directory: Path, jobs: int, limit_s: float | None, halt: Halt) -> None:
        """jobs: how many at a time; limit_s: wall time after which a run is taken to hang, None: never."""
        self._job, self._directory, self._jobs, self._limit_s, self._halt = job, directory, jobs, limit_s, halt
        self._workers: list[Worker] = []
        self._waiting: deque[Order] = deque()
        self._mean_s = math.inf  # wall time of a run, lately
        self._deaths = 0  # in a row, before being ready
        self._on_done: Callable[[Flown], None] = lambda flown: None

    @property
    def pids(self) -> list[int]:
        """The processes of the workers."""
        return [worker.popen.pid for worker in self._workers]

    def fly(self, orders: Sequence[Order], on_done: Callable[[Flown], None]) -> None:
        """Fly all orders; see Crew."""
        self._waiting, self._on_done = deque(orders), on_done
        try:
            while self._waiting or self._flying():
                if self._halt.asked and (self._halt.urgent or not self._flying()):
                    break
                self._hire()
                self._hand_out()
                self._listen()
                self._end_late()
        finally:
            self._drop_flying()

    def close(self) -> None:
        """Let all workers go; those that are in the middle of something are killed."""
        workers, self._workers = self._workers, []
        for worker in workers:
            with contextlib.suppress(OSError):
                worker.connection.close()
        for worker in workers:
            worker.end(kill=bool(worker.orders) or not worker.ready)

    def _flying(self) -> list[Worker]:
        return [worker for worker in self._workers if worker.orders]

    def _hire(self) -> None:
        wanted = 0 if self._halt.asked else min(self._jobs, len(self._waiting) + len(self._flying()))
        while len(self._workers) < wanted:
            try:
                self._workers.append(Worker(self._job, self._directory))
            except OSError as error:
                raise RecordError(f"cannot start a worker: {error.strerror or error}; try fewer with -j") from None

    def _hand_out(self) -> None:
        for worker in self._workers:
            self._supply(worker)

    def _supply(self, worker: Worker) -> None:
        """Give a worker its next run; where runs are short and many are left, one more to go on with."""
        ahead = 2 if self._mean_s < SHORT_S and len(self._waiting) > 2 * self._jobs else 1
        while worker.ready and self._waiting and len(worker.orders) < ahead and not self._halt.asked:
            worker.give(self._waiting.popleft())

    def _listen(self) -> None:
        """Wait until somebody has something to say, or is due; take what has been said."""
        by_end: dict[Any, Worker] = {worker.connection: worker for worker in self._workers}
        for end in wait([*by_end, self._halt.fd], self._patience_s()):
            worker = by_end.get(end)
            if worker is None:
                self._halt.clear()
                continue
            said = worker.hear()
            if worker.dead:
                self._bury(worker, worker.end())
            elif isinstance(said, Flown):
                worker.orders.popleft()
                worker.since_s = time.monotonic()
                self._mean_s = (
                    said.timing.wall_s if math.isinf(self._mean_s) else (0.9 * self._mean_s + 0.1 * said.timing.wall_s)
                )
                self._supply(worker)  # before anything else, so that it does not wait for us
                self._on_done(said)
            else:
                worker.ready, self._deaths = True, 0

    def _patience_s(self) -> float | None:
        limits = [self._due_s(worker) for worker in self._workers]
        nearest = min((limit for limit in limits if limit is not None), default=None)
        return None if nearest is None else max(0.0, nearest - time.monotonic())

    def _due_s(self, worker: Worker) -> float | None:
        """When a worker is taken to hang, of the monotonic clock."""
        if not worker.ready:
            return worker.since_s + START_S
        return None if self._limit_s is None or not worker.orders else worker.since_s + self._limit_s

    def _end_late(self) -> None:
        for worker in list(self._workers):
            due_s = self._due_s(worker)
            if due_s is not None and time.monotonic() >= due_s:
                words = worker.end(kill=True)
                self._bury(worker, describe_late(self._limit_s) if worker.ready else words)

    def _bury(self, worker: Worker, words: str) -> None:
        """A worker is gone: so is the run that it had. What it had not begun is somebody else's."""
        self._workers.remove(worker)
        if worker.orders:
            order = worker.orders.popleft()
            self._waiting.extendleft(reversed(worker.orders))
            wall_s = time.monotonic() - worker.since_s
            name = f"{os.uname().nodename}:{worker.popen.pid}"
            timing = Timing(number=order.plan.number, wall_s=wall_s, cpu_s=0.0, ticks=0, worker=name)
            self._on_done(Flown(fail(order.plan, words), timing))
        elif not worker.ready:
            self._deaths += 1
            if self._deaths >= MOST_DEATHS:
                raise RecordError(
                    f"{self._deaths} workers in a row ended before they were ready; the last one: {words}"
                )

    def _drop_flying(self) -> None:
        """Kill whoever is still in the middle of a run when the flying ends early."""
        for worker in self._flying():
            worker.end(kill=True)
            self._workers.remove(worker)


class Solo:
    """One run after the other, each in processes of its own: for other clocks and real buses."""

    def __init__(self, job: Job, directory: Path, halt: Halt) -> None:
        self._job, self._directory, self._halt = job, directory, halt

    def fly(self, orders: Sequence[Order], on_done: Callable[[Flown], None]) -> None:
        """Fly all orders; see Crew."""
        from tools.campaign.fly import Interruption, fly
        from tools.campaign.results import LOG_DIR

        for order in orders:
            if self._halt.asked:
                return
            path = self._directory / LOG_DIR / order.log if order.log else None
            try:
                on_done(fly(self._job, order.plan, path, f"{LOG_DIR}/{order.log}" if order.log else ""))
            except Interruption as stop:
                self._halt.ask(stop.number)

    def close(self) -> None:
        """Nobody is left."""


__all__ = ["Pool", "Solo", "Worker"]
