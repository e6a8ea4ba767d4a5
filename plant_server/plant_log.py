"""What the plant writes to the log: the raw frames of the bus, the truth, and every fault as it bites."""

from __future__ import annotations

from bus.telemetry.link import Field, Link, Row, TickPacker, Topic, announce_topics, pack_frames_stamped, stamp
from bus.wire.frames import FRAME_ID
from bus.wire.transport import Transport
from plant_server.channel import PlantServer
from plant_server.plant import FaultEvent
from plant_server.truth import FRAMES_CHANNEL, make_packer

BUS_NAME = "bus0"
STAMPS_CHANNEL = 51
STAMPS = Topic(
    f"/can/{BUS_NAME}_kernel_stamps",
    "hilsat/KernelStamp",
    (
        Field("received_ns", "uint64", 1, "ns", "when the kernel took this frame in, CLOCK_REALTIME; 0: not stamped"),
        Field("can_id", "uint32", 1, "1", "id of the frame with its flag bits, as in struct can_frame"),
        Field("dropped", "uint32", 1, "1", "frames that the receive buffer had no room for so far"),
    ),
    deterministic=False,
)


class PlantLog:
    """Feeds one telemetry link, a row a tick.

    stamped : the bus says when each frame was received; logged in a topic of its own, one record a frame
    """

    def __init__(self, server: PlantServer, link: Link, tick_ns: int, stamped: bool = False) -> None:
        self._server = server
        self.link = link
        self._tick_ns = tick_ns
        self._packer = make_packer()
        self._stamps = TickPacker([STAMPS], STAMPS_CHANNEL) if stamped else None
        self._arrivals: list[tuple[int, int, int]] = []  # of this tick: time, id, frames dropped so far
        packers = [self._packer] if self._stamps is None else [self._packer, self._stamps]
        link.announce(announce_topics(packers, {FRAMES_CHANNEL: BUS_NAME}), self._pack_rows)

    def note_arrival(self, batch: bytes, transport: Transport) -> None:
        """Keep the kernel's stamps of the frames that the transport has just returned."""
        if self._stamps is not None and batch:
            dropped = transport.counters.dropped
            ids = FRAME_ID.iter_unpack(batch)
            stamps = transport.kernel_stamps_ns
            self._arrivals += [(stamp_ns, can_id, dropped) for (can_id,), stamp_ns in zip(ids, stamps, strict=False)]

    def write(self, frames: bytes) -> None:
        """Log this tick: the frames in the order of the bus, the truth at the time of sampling, new fault events."""
        server = self._server
        tick = server.tick
        t_ns = tick * self._tick_ns
        for event in server.events:
            self._announce(event, tick, t_ns)
        self.link.write_row((tick, t_ns, frames, server.snapshot, tuple(self._arrivals)))
        self._arrivals.clear()

    def _pack_rows(self, rows: list[Row]) -> list[bytes]:
        expand, pack, records = self._server.plant.expand, self._packer.pack_stamped, []
        for tick, t_ns, frames, snapshot, arrivals in rows:
            head = stamp(tick, t_ns)
            data = pack_frames_stamped(FRAMES_CHANNEL, head, frames) + pack(head, expand(snapshot))
            if arrivals and self._stamps is not None:
                pack_stamp = self._stamps.pack_stamped
                data += b"".join([pack_stamp(head, arrival) for arrival in arrivals])
            records.append(data)
        return records

    def _announce(self, event: FaultEvent, tick: int, t_ns: int) -> None:
        phase = "onset" if event.active else "end"
        self.link.fault(t_ns, event.tick, event.unit, event.kind, phase, event.magnitude, event.describe())
        self.link.event(t_ns, "warning" if event.active else "info", "plant", f"fault {phase}: {event.describe()}")
