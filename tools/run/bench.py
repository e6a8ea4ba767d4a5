"""A bench in Python: both sides of a scenario in one process, a tick at a time. The same frames, checks and bytes.

    from tools.run.bench import Bench

    bench = Bench.open("zhang2018-flight", ["seed=7"], log="memory")
    bench.step(1000)
    bench.inject(unit="wheel.2", kind="loss", effectiveness=0.3)
    bench.retarget("slew", target_q=[0.9, 0.1, 0.3, 0.3], max_rate_deg_s=0.3)
    bench.run_to_end()
    print(bench.truth.error_deg, bench.read("fsw.observer.tau_fault_hat_b_nm"))

It is what `--clock inprocess` runs, and what tests, studies and campaigns use.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import weakref
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from bus.attitude import angle_between
from bus.build import CURRENT
from bus.clock import SystemClock
from bus.commands import Command
from bus.errors import ConfigError, HilsatError, RecordError, UsageError
from bus.run import GroundConfig
from bus.settings import build
from bus.telemetry.link import Link, TelemetryLink
from bus.units import DEG
from fsw.flight import Flight
from fsw.guidance.timeline import PREFIX, make_command
from fsw.node import FswNode
from fsw.telemetry import SOURCE as FSW_SOURCE
from plant_server.faults import Fault
from plant_server.node import PlantNode
from plant_server.pacing import Accept
from plant_server.plant import Plant, Snapshot
from plant_server.truth import SOURCE as PLANT_SOURCE
from plant_server.truth import Truth
from tools.config.loader import load_scenario
from tools.config.scenario import Resolved
from tools.config.scenario_files import find_scenario
from tools.log.mcap_reader import Run, read_run
from tools.log.recorder import Recorder
from tools.run.bench_signals import read_signal
from tools.run.provenance import describe_run, list_attachments
from tools.run.run_file import RUN_FILE, describe_bench, write_run_file

ORIGIN = "bench"


class Bench:
    """Plant and flight software of one scenario, paced by whoever calls `step`."""

    def __init__(
        self,
        resolved: Resolved,
        plant_link: Link | None = None,
        fsw_link: Link | None = None,
        log: Path | Literal["memory"] | None = None,
        ground_dir: Path | None = None,
    ) -> None:
        """Put both sides at tick 0.

        plant_link, fsw_link : where telemetry goes; None: to the log, or nowhere
        log                  : a file that does not exist yet, "memory", or None
        ground_dir           : a private directory for the sockets of both sides, which speak MAVLink; None: no sockets
        Raises ConfigError where the scenario cannot be flown, RecordError where the log cannot be written, UsageError
        for a compiled build that is stale.
        """
        if CURRENT.trouble:
            raise UsageError(CURRENT.trouble)
        scenario = resolved.scenario
        self.resolved = resolved
        self.ticks = resolved.ticks  # of the whole run
        self.tick_ns = 1_000_000_000 // scenario.clock.tick_hz
        self.tick_s = tick_s = self.tick_ns * 1e-9
        plant = Plant(scenario.plant, scenario.faults, tick_s, scenario.seed)
        self.flight = Flight(scenario.fsw, tick_s, resolved.run_hash)
        self._log_path, self._recorder = self._open_log(log)
        if self._recorder is not None:
            plant_link, fsw_link = self._recorder.link(PLANT_SOURCE), self._recorder.link(FSW_SOURCE)
        self._links = [
            plant_link or TelemetryLink(None, PLANT_SOURCE, False),
            fsw_link or TelemetryLink(None, FSW_SOURCE, False),
        ]
        bus = dataclasses.replace(scenario.bus, address="memory:")  # whatever it is, no frame leaves this process
        self.plant_node = PlantNode(plant, self._links[0], self.tick_ns, resolved.run_hash, bus=bus)
        timeline = [make_command(entry, tick_s) for entry in scenario.fsw.timeline]
        self.fsw_node = FswNode(self.flight, self._links[1], self.tick_ns, SystemClock(), timeline)
        self._ground_dir = ground_dir
        self._grounds = self._open_grounds(ground_dir, log)
        self._answer = b""
        self._closed = False
        self._accept: Accept = self.plant_node.channel.accept

    @classmethod
    def open(
        cls,
        scenario: str | Path,
        overrides: Sequence[str] = (),
        log: Path | Literal["memory"] | None = None,
        ground_dir: Path | None = None,
    ) -> Self:
        """A bench for a scenario file or the name of one that ships, with `key.path=value` overrides applied."""
        return cls(load_scenario(find_scenario(str(scenario)), overrides), log=log, ground_dir=ground_dir)

    # -- moving ----------------------------------------------------------------------------------------------------

    @property
    def tick(self) -> int:
        """The next tick to run; so many have been run."""
        return self.plant_node.tick_number

    @property
    def t_s(self) -> float:
        """Simulated time of the next tick [s]."""
        return self.tick * self.tick_s

    def step(self, ticks: int = 1, on_progress: Callable[[int], None] | None = None) -> Self:
        """Run that many ticks from where the bench stands."""
        tick, exchange = self.plant_node.tick, self._exchange
        for number in range(self.tick, self.tick + ticks):
            tick(exchange)
            if on_progress is not None and not number % 100:
                on_progress(number)
        return self

    def run_to_end(self, on_progress: Callable[[int], None] | None = None) -> Self:
        """Run what is left of the scenario's duration, and finish the log."""
        self.step(max(0, self.ticks - self.tick), on_progress)
        self.close("done")
        return self

    def _exchange(self, frames: bytes, accept: Accept) -> bytes:
        """What paces the plant here: the flight software runs its cycle at once."""
        self.fsw_node.tick(self.plant_node.tick_number, frames, self._keep)
        accept(self._answer)
        return self._answer

    def _keep(self, answer: bytes) -> None:
        self._answer = answer

    # -- looking ---------------------------------------------------------------------------------------------------

    @property
    def truth(self) -> Truth:
        """What is so now, by name: `truth.q_ib`, `truth.error_deg`, ... (see plant_server/truth.py)."""
        return self._point(self.plant_node.plant.snapshot())

    @property
    def sampled_truth(self) -> Truth:
        """What was so on the last tick when its samples were taken: what goes with that tick's telemetry, and is logged."""
        return self._point(self.plant_node.channel.snapshot)

    def _point(self, snapshot: Snapshot) -> Truth:
        truth = Truth.from_flat(Plant.flatten(snapshot))
        return truth._replace(error_deg=angle_between(self.flight.guidance.target.q_it, truth.q_ib) / DEG)

    def read(self, signal: str) -> Any:
        """The value of a signal as of the last tick, by the name that expectations use: `fsw.attitude.error_deg`.

        Raises UsageError for a name that nothing is logged under, with the near miss.
        """
        return read_signal(signal, self.truth, self.flight)

    # -- interfering -----------------------------------------------------------------------------------------------

    def inject(self, at_tick: int | None = None, **fault: Any) -> None:
        """Break a unit at a tick (default: the next): keys as of a fault in a scenario file, `at_s` left out.

        Raises ConfigError when it is wrong; what can have no effect any more is refused in the log.
        """
        tick = self.tick if at_tick is None else at_tick
        arguments = {"at_s": tick * self.tick_s} | fault
        build(Fault, arguments, "fault")
        self.plant_node.commands.add(Command(tick, "fault.add", arguments, ORIGIN))

    def clear(self, at_tick: int | None = None, **which: str) -> None:
        """Heal: `id=...` one fault, `unit=...` all of a unit, nothing: all; at a tick (default: the next)."""
        tick = self.tick if at_tick is None else at_tick
        self.plant_node.commands.add(Command(tick, "fault.clear", which, ORIGIN))

    def retarget(self, do: str = "hold", at_tick: int | None = None, **settings: Any) -> None:
        """Point elsewhere from a tick on (default: the next): keys as of an entry of `fsw.timeline`, `at_s` left out.

        Raises ConfigError when it is wrong.
        """
        tick = self.tick if at_tick is None else at_tick
        command = Command(tick, PREFIX + do, settings, ORIGIN)
        if problem := self.flight.check(command, tick):
            raise ConfigError(problem)
        self.fsw_node.commands.add(command)

    # -- logging ---------------------------------------------------------------------------------------------------

    @property
    def log(self) -> Run:
        """The log so far, opened. Raises UsageError for a bench without one."""
        if self._recorder is None or self._log_path is None:
            raise UsageError('this bench keeps no log; make it with log="memory" or log=Path(...)')
        for link in self._links:
            link.flush()
        self._recorder.flush()
        return read_run(self._log_path)

    def close(self, reason: str = "closed") -> None:
        """Finish the log, and close the sockets. Harmless when repeated, and for a bench without them."""
        for ground in self._grounds:
            ground.close()
        if self._ground_dir is not None:
            (self._ground_dir / RUN_FILE).unlink(missing_ok=True)
        for link in self._links:
            with contextlib.suppress(RecordError):
                link.close(reason)
        if self._recorder is not None and not self._closed:
            self._recorder.close()
        self._closed = True

    def _open_log(self, log: Path | Literal["memory"] | None) -> tuple[Path | None, Recorder | None]:
        if log is None:
            return None, None
        if log == "memory":
            fd = os.memfd_create("hilsat-run.mcap")
            weakref.finalize(self, os.close, fd)
            log = Path(f"/proc/self/fd/{fd}")
        attachments = list_attachments(self.resolved)
        return log, Recorder(log, metadata=describe_run(self.resolved, "in process"), attachments=attachments)

    def _open_grounds(self, directory: Path | None, log: Path | Literal["memory"] | None) -> list[Any]:
        """The sockets of both sides, and the file by which they are found."""
        if directory is None:
            return []
        out = log.parent if isinstance(log, Path) else None
        bench = describe_bench(self.resolved, directory.absolute(), address="in process", out=out, linked=True)
        # A bench without sockets is not to wait for the dialect.
        from fsw.ground import open_ground as open_fsw
        from plant_server.ground import open_ground as open_plant

        allowed, clock, name = bench.inject == "allowed", SystemClock(), self.resolved.scenario.name
        plant_ground = GroundConfig(socket=bench.plant or "", inject=allowed)
        grounds: list[Any] = [open_plant(self.plant_node, plant_ground, clock, name=name, ticks=self.ticks)]
        try:
            grounds.append(open_fsw(self.fsw_node, GroundConfig(socket=bench.fsw or "", inject=allowed), clock))
            write_run_file(directory, bench)
        except HilsatError:
            for ground in grounds:
                ground.close()
            raise
        return grounds

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close("failed" if error is not None else "closed")
