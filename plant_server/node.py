"""The plant as a node on the bus: what a tick is, on every clock."""

from __future__ import annotations

from bus.commands import CommandQueue
from bus.telemetry.link import Link
from plant_server.channel import Channel
from plant_server.injector import Injector
from plant_server.pacing import Exchange
from plant_server.plant import Plant
from plant_server.plant_log import PlantLog


class PlantNode:
    """A plant, its channel to the bus, its log, and the commands that wait for it."""

    def __init__(self, plant: Plant, link: Link, tick_ns: int, run_hash: int, *, stamped: bool = False) -> None:
        """stamped : the bus says when each frame was received, and that is logged."""
        self.plant = plant
        self.channel = Channel(plant, tick_ns * 1e-9, run_hash)
        self.log = PlantLog(self.channel, link, tick_ns, stamped)
        self.commands = CommandQueue()
        self._injector = Injector(plant, self.log)

    @property
    def tick_number(self) -> int:
        """The next tick to run."""
        return self.channel.tick

    def tick(self, exchange: Exchange) -> None:
        """Run one tick: commands that are due, sample and announce, exchange, log, advance."""
        channel = self.channel
        if channel.tick >= self.commands.next_tick:
            for command in self.commands.take(channel.tick):
                self._injector.carry_out(command, channel.tick)
        announced = channel.announce()
        received = exchange(announced, channel.accept)
        self.log.write(announced + received)
        channel.advance()
