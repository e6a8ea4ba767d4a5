"""The plant as a node on the bus: what a tick is, on every clock."""

from __future__ import annotations

from typing import Any, Protocol

from bus.commands import Command, CommandQueue
from bus.run import USUAL_BUS, BusConfig
from bus.telemetry.link import Link
from bus.wire.address import may_carry_error_frames
from plant_server.can_bus.wire import Wire
from plant_server.channel import Channel
from plant_server.faults import FaultEvent
from plant_server.faults.units import BUS
from plant_server.injector import Injector, Outcome
from plant_server.pacing import Exchange
from plant_server.plant import Plant
from plant_server.plant_log import PlantLog


class Ground(Protocol):
    """Where commands come from while the plant runs, and where it is told what happened."""

    def poll(self, tick: int) -> None: ...
    def report(self, events: tuple[FaultEvent, ...]) -> None: ...


class PlantNode:
    """A plant, its channel to the bus, its log, and the commands that wait for it."""

    def __init__(
        self,
        plant: Plant,
        link: Link,
        tick_ns: int,
        run_hash: int,
        *,
        stamped: bool = False,
        bus: BusConfig = USUAL_BUS,
    ) -> None:
        """stamped : the bus says when each frame was received, and that is logged
        bus     : its address, bit rate and timing, for what goes wrong on it
        """
        self.plant = plant
        self.channel = Channel(plant, tick_ns * 1e-9, run_hash)
        self.log = PlantLog(self.channel, link, tick_ns, stamped)
        self.commands = CommandQueue()
        self.tick_s = tick_ns * 1e-9  # period [s]
        self.ground: Ground | None = None  # no link for commands
        self._injector = Injector(plant, self.log)
        self._tick_ns, self._bus = tick_ns, bus
        self._wire: Wire | None = None  # only where something is wrong with the bus
        self._look_for_wire()

    @property
    def tick_number(self) -> int:
        """The next tick to run."""
        return self.channel.tick

    def tick(self, exchange: Exchange) -> None:
        """Run one tick: commands that are due, sample and announce, exchange, log, advance."""
        channel = self.channel
        if self.ground is not None:
            self.ground.poll(channel.tick)
        if channel.tick >= self.commands.next_tick:
            self._carry_out_due()
        announced = channel.announce()
        if self.ground is not None:
            self.ground.report(channel.events)
        if self._wire is not None:
            self._tick_over_wire(self._wire, exchange, announced)
            return
        received = exchange(announced, channel.accept)
        self.log.write(announced + received)
        channel.advance()

    def obey(self, verb: str, arguments: dict[str, Any], origin: str) -> Outcome:
        """Carry out a command before the work of the next tick, behind all others that are due; say what came of it."""
        self.commands.add(Command(self.channel.tick, verb, arguments, origin))
        return self._carry_out_due()

    def _carry_out_due(self) -> Outcome:
        """Carry out the commands that are due; return what became of the last one."""
        tick, outcome = self.channel.tick, Outcome("")
        for command in self.commands.take(tick):
            outcome = self._injector.carry_out(command, tick)
        self._look_for_wire()
        return outcome

    def _tick_over_wire(self, wire: Wire, exchange: Exchange, announced: bytes) -> None:
        """Run the rest of a tick where something may be wrong with the bus."""
        channel = self.channel
        seen = wire.send(channel.tick, self.plant.next_step, announced)
        received = exchange(seen, self._hear)
        channel.accept(wire.end())
        self.log.write(seen + received, wire.values())
        channel.advance()

    def _hear(self, batch: bytes) -> bool:
        """Hand in what the flight software sends; True once CYCLE_DONE is among it."""
        return self._wire is not None and self.channel.accept(self._wire.hear(batch))

    def _look_for_wire(self) -> None:
        """Lay the wire once there is anything on it that a plain exchange does not have."""
        timed = self._bus.timing == "real"
        if self._wire is None and (timed or self.plant.timeline.chains[BUS].entries):
            reports = may_carry_error_frames(self._bus.address)
            self._wire = Wire(self.plant.timeline, self._tick_ns, self._bus.bitrate_bps, timed=timed, reports=reports)
            self.log.show_bus()
