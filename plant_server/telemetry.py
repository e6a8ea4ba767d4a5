"""What the plant writes to the log: the raw frames of the bus, the truth, and every fault as it bites."""

from __future__ import annotations

from bus.telemetry import Link, announce_topics, pack_frames
from plant_server.plant import FaultEvent
from plant_server.server import PlantServer
from plant_server.truth import FRAMES_CHANNEL, make_packer

BUS_NAME = "bus0"


class PlantLog:
    """Feeds one telemetry link, one write a tick."""

    def __init__(self, server: PlantServer, link: Link, tick_ns: int) -> None:
        self._server = server
        self.link = link
        self._tick_ns = tick_ns
        self._packer = make_packer()
        link.announce(announce_topics([self._packer], {FRAMES_CHANNEL: BUS_NAME}))

    def write(self, frames: bytes) -> None:
        """Log this tick: the frames in the order of the bus, the truth at the time of sampling, new fault events."""
        server = self._server
        tick = server.tick
        t_ns = tick * self._tick_ns
        samples = server.samples
        if samples is not None and samples.events:
            for event in samples.events:
                self._announce(event, tick, t_ns)
        records = pack_frames(FRAMES_CHANNEL, tick, t_ns, frames) + self._packer.pack(tick, t_ns, *server.truth)
        self.link.write_tick(tick, t_ns, records)

    def _announce(self, event: FaultEvent, tick: int, t_ns: int) -> None:
        phase = "onset" if event.active else "end"
        self.link.fault(t_ns, event.tick, event.unit, event.kind, phase, event.magnitude, event.describe())
        self.link.event(t_ns, "warning" if event.active else "info", "plant", f"fault {phase}: {event.describe()}")
