"""A Dask cluster as the crew of a campaign: `pip install hilsat[cluster]` here and `pip install hilsat[cluster]` there.

A run is a task that has all it takes to fly it; workers need no files of ours and write none. One that dies has its runs
flown by others; a run that takes several workers with it is INFRA.
"""

from __future__ import annotations

import contextlib
import logging
import queue
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final
from uuid import uuid4

from bus.errors import RecordError, UsageError
from tools.campaign.crew import Halt, Order
from tools.campaign.fly import Flown, fail, fly_for_bytes
from tools.campaign.job import Job
from tools.campaign.results import LOG_DIR, Timing
from tools.run.provenance import read_revision

LOCAL: Final = "local"
POLL_S: Final = 0.2  # how soon a signal is seen
LOOK_S: Final = 5.0  # how often it is looked whether the scheduler is still there
CONNECT_S: Final = 10
MOST_LOST: Final = 3  # times that a run is flown again because its result went with the worker that held it
AHEAD: Final = 2  # runs a worker's thread has at most: the one it flies and the next
MISSING: Final = "--dask needs Dask's scheduler: pip install 'hilsat[cluster]'"

_one_at_a_time = threading.Lock()  # a bench is not made for threads


class DaskCrew:
    """The workers of a cluster, or of one that is made on this machine for as long as the campaign lasts."""

    def __init__(self, job: Job, directory: Path, address: str, jobs: int, limit_s: float | None, halt: Halt) -> None:
        """address: of the scheduler, such as tcp://host:8786, or local; jobs: workers of a local one.

        Raises UsageError where Dask is missing, nobody answers, or a worker has another hilsat than we.
        """
        self._job, self._limit_s, self._halt = job, limit_s, halt
        self._cluster: Any = None
        self._client: Any = None
        self._name = f"hilsat-{uuid4().hex[:12]}"
        self._lost: Counter[int] = Counter()  # results that could not be fetched, by the run's number
        self._connect(address, jobs, directory)
        self._check_versions(address)

    def _connect(self, address: str, jobs: int, directory: Path) -> None:
        try:
            from distributed import Client, LocalCluster
        except ImportError:
            raise UsageError(MISSING) from None
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        try:
            if address == LOCAL:
                with _deaf_children():
                    self._cluster = LocalCluster(  # type: ignore[no-untyped-call]
                        n_workers=jobs, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None,
                        worker_dashboard_address=None, silence_logs=logging.CRITICAL, memory_limit=0,
                    )  # fmt: skip
            self._client = Client(self._cluster or address, timeout=CONNECT_S)  # type: ignore[no-untyped-call]
        except (OSError, ValueError, TimeoutError) as error:
            self.close()
            raise UsageError(f"--dask {address}: no scheduler answers there: {error}") from None

    def _check_versions(self, address: str) -> None:
        """See that there are workers, and that they fly what we would."""
        ours = name_program()
        theirs: dict[str, str] = self._client.run(name_program)
        odd = {worker: program for worker, program in theirs.items() if program != ours}
        if odd:
            worker, program = next(iter(odd.items()))
            self.close()
            raise UsageError(
                f"--dask {address}: worker {worker} has hilsat {program}, here is {ours} ({len(odd)} of {len(theirs)} "
                "workers differ); install the same everywhere"
            )

    def fly(self, orders: Sequence[Order], on_done: Callable[[Flown], None]) -> None:
        """Fly all orders; see Crew."""
        waiting = deque(orders)
        ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        flying: dict[str, tuple[Order, Any]] = {}
        quiet_s = 0.0
        try:
            while (waiting and not self._halt.asked) or (flying and not self._halt.urgent):
                while waiting and not self._halt.asked and len(flying) < self._room():
                    order = waiting.popleft()
                    future = self._submit(order)
                    flying[future.key] = (order, future)
                    future.add_done_callback(ended.put)
                try:
                    future = ended.get(timeout=POLL_S)
                except queue.Empty:
                    quiet_s += POLL_S
                    if quiet_s >= LOOK_S:
                        quiet_s = 0.0
                        self._look()
                    continue
                order, _ = flying.pop(future.key)
                flown = self._take(order, future)
                if flown is None:
                    waiting.appendleft(order)
                else:
                    on_done(flown)
        finally:
            if flying:
                with contextlib.suppress(Exception):  # a scheduler that is gone has nothing to cancel
                    self._client.cancel([future for _, future in flying.values()], force=True)

    def close(self) -> None:
        """Let the cluster go; end it when it is ours."""
        for ours in (self._client, self._cluster):
            if ours is not None:
                with contextlib.suppress(Exception):  # a scheduler that is gone cannot be taken leave of
                    ours.close()
        self._client = self._cluster = None

    def _room(self) -> int:
        """Runs that may be under way, so that nobody waits for us and little is dropped by a stop."""
        threads: dict[str, int] = self._client.nthreads()
        return max(1, AHEAD * sum(threads.values()))

    def _submit(self, order: Order) -> Any:
        named = f"{LOG_DIR}/{order.log}" if order.log else ""
        key = f"{self._name}-{order.plan.number}-{uuid4().hex[:8]}"
        return self._client.submit(
            fly_task, self._job, order.plan, named, self._limit_s, name_program(), key=key, pure=False
        )

    def _take(self, order: Order, future: Any) -> Flown | None:
        """What came of a task; for one that killed its workers, that. None: it went with its worker, and is flown again."""
        try:
            flown = future.result(timeout=CONNECT_S)
            assert isinstance(flown, Flown)
            return flown
        except Exception as error:
            self._look()
            if isinstance(error, TimeoutError | OSError) and self._lost[order.plan.number] < MOST_LOST:
                self._lost[order.plan.number] += 1
                return None
            words = " ".join(str(error).split())
            timing = Timing(number=order.plan.number, wall_s=0.0, cpu_s=0.0, ticks=0, worker="dask")
            return Flown(fail(order.plan, f"the cluster gave it up: {type(error).__name__}: {words}"), timing)
        finally:
            future.release()

    def _look(self) -> None:
        """Raise RecordError when the scheduler is gone."""
        if self._client.status != "running":
            raise RecordError("the Dask scheduler is gone; what was flown is kept, go on with --resume")


def fly_task(job: Job, plan: Any, named: str, limit_s: float | None, program: str) -> Flown:
    """One run, on a worker of the cluster."""
    ours = name_program()
    if ours != program:
        timing = Timing(number=plan.number, wall_s=0.0, cpu_s=0.0, ticks=0, worker="dask")
        return Flown(
            fail(plan, f"a worker has hilsat {ours}, the campaign {program}; install the same everywhere"), timing
        )
    with _one_at_a_time:
        return fly_for_bytes(job, plan, named, limit_s)


@cache
def name_program() -> str:
    """Which hilsat this is: version and revision. Builds compute the same bits and are not told apart."""
    try:
        known = version("hilsat")
    except PackageNotFoundError:
        known = "not installed"
    return f"{known} {read_revision()}".strip()


@contextlib.contextmanager
def _deaf_children() -> Iterator[None]:
    """Processes that are started meanwhile do not hear the terminal's Ctrl-C: we see to it."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
