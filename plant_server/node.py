"""The plant as a node on the bus: what a tick is, on every clock."""

from __future__ import annotations

from typing import Any, Protocol

from bus.commands import Command, CommandQueue
from bus.telemetry.link import Link
from plant_server.channel import Channel
from plant_server.faults import FaultEvent
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

    def __init__(self, plant: Plant, link: Link, tick_ns: int, run_hash: int, *, stamped: bool = False) -> None:
        """stamped : the bus says when each frame was received, and that is logged."""
        self.plant = plant
        self.channel = Channel(plant, tick_ns * 1e-9, run_hash)
        self.log = PlantLog(self.channel, link, tick_ns, stamped)
        self.commands = CommandQueue()
        self.tick_s = tick_ns * 1e-9  # period [s]
        self.ground: Ground | None = None  # no link for commands
        self._injector = Injector(plant, self.log)

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
        return outcome
