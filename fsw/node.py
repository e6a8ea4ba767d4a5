"""The flight software as a node: one `tick`, whoever paces it and whatever carries its frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from bus.clock import MonotonicClock
from bus.commands import Command, CommandQueue
from bus.telemetry.link import Link
from fsw.flight import Flight
from fsw.flight_log import SAFE_ASKED, SHEDDING, FlightLog

if TYPE_CHECKING:
    from fsw.ground import FswGround


class FswNode:
    """Flight software, its ground commands and its telemetry."""

    def __init__(
        self, flight: Flight, link: Link, tick_ns: int, clock: MonotonicClock, commands: Iterable[Command] = ()
    ) -> None:
        """commands: known beforehand, such as the scenario's timeline; more may be added to `commands` while it runs."""
        self.flight = flight
        self.log = FlightLog(flight, link, tick_ns)
        self.commands = CommandQueue(commands)
        self.tick_ns = tick_ns
        self.ground: FswGround | None = None  # the link to the ground, where there is one
        self._clock = clock

    def tick(
        self,
        tick: int,
        frames: bytes,
        send: Callable[[bytes], object],
        safe_requested: bool = False,
        shedding: bool = False,
    ) -> None:
        """Run the cycle of a tick: commands that are due, the cycle on the frames received since the last, send, log.

        safe_requested : the executive asks for safe mode
        shedding       : groups that are not essential are left out
        """
        flight, clock, counters = self.flight, self._clock, self.flight.executive
        if self.ground is not None:
            self.ground.poll(tick)
        due = self._take_commands(tick) if tick >= self.commands.next_tick else ()
        started_ns = clock.now_ns()
        answer = flight.cycle(tick, frames, due, safe_requested)
        # Without the sending: in lock-step on one processor the plant does its work before it returns.
        cycle_ns = clock.now_ns() - started_ns
        send(answer)
        counters.cycles += 1
        counters.last_cycle_ns = cycle_ns
        if cycle_ns > counters.max_cycle_ns:
            counters.max_cycle_ns = cycle_ns
        self.log.write(tick, frames, due, (SAFE_ASKED if safe_requested else 0) | (SHEDDING if shedding else 0))
        if self.ground is not None:
            self.ground.tell(frames, answer)

    def _take_commands(self, tick: int) -> tuple[Command, ...]:
        """The commands due on this tick that can be obeyed; each is announced, a refused one with the reason."""
        obeyed = []
        for command in self.commands.take(tick):
            problem = self.flight.check(command, tick)
            if not problem:
                obeyed.append(command)
            words = f"refused: {problem}" if problem else f"obeyed at tick {tick}"
            level = "warning" if problem else "info"
            self.log.link.event(tick * self.tick_ns, level, "fsw", f"command {command.verb} ({command.origin}) {words}")
        return tuple(obeyed)
