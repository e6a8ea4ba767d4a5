"""What the flight software writes to the log: its telemetry, one write a tick, and every change of mode in words."""

from __future__ import annotations

from bus.telemetry import Link, announce_topics
from fsw.flight import Flight
from fsw.modes import Mode


class FlightLog:
    """Feeds one telemetry link."""

    def __init__(self, flight: Flight, link: Link, tick_ns: int) -> None:
        self._flight = flight
        self.link = link
        self._tick_ns = tick_ns
        self._mode_changes = 0
        link.announce(announce_topics(flight.packers))

    def write(self, tick: int) -> None:
        """Log the cycle of this tick."""
        flight, link = self._flight, self.link
        t_ns = tick * self._tick_ns
        modes = flight.modes
        if modes.changes != self._mode_changes:
            self._mode_changes = modes.changes
            level = "warning" if modes.mode is Mode.SAFE else "info"
            link.event(t_ns, level, "fsw", f"mode {modes.mode.name.lower()}: {modes.reason}")
        link.write_tick(tick, t_ns, flight.publish(tick, t_ns))
        flight.dropped_ticks = link.dropped
