"""What the plant writes to the log: frames of the bus, truth, counters, and what becomes of every fault."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from bus.commands import Command
from bus.native import COMPILED
from bus.telemetry.link import Field, Link, Row, TickPacker, Topic, announce_topics, pack_frames_stamped, stamp
from bus.wire.frames import FRAME_ID
from bus.wire.transport import Transport
from plant_server.can_bus.counts import BUS, BUS_CHANNEL
from plant_server.channel import Channel
from plant_server.faults import FaultEvent
from plant_server.plant import Plant
from plant_server.truth import FRAMES_CHANNEL, make_packer

if COMPILED:  # never where librt may be missing
    from plant_server.native_log import pack_tick

BUS_NAME: Final = "bus0"
COUNTERS_CHANNEL: Final = 50
COUNTERS = Topic(
    "/plant/channel",
    "hilsat/PlantChannel",
    (
        Field("accepted", "uint64", 1, "1", "frames taken since the start of the run"),
        Field("refused", "uint64", 1, "1", "frames whose length, checksum or alive counter was wrong"),
        Field("foreign", "uint64", 1, "1", "frames that are not for the plant"),
        Field("too_old", "uint64", 1, "1", "commands whose SYNC_CNT was older than allowed"),
        Field("timeouts", "uint64", 1, "1", "wheel-ticks without a fresh enough command"),
        Field("rivals", "uint64", 1, "1", "frames that show a second sender of an id"),
    ),
    every="second",
)
STAMPS_CHANNEL: Final = 51
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
LEVELS = {"onset": "warning", "effect": "info", "end": "info", "cleared": "info"}  # of the line for people


class PlantLog:
    """Feeds one telemetry link, a row a tick; the counters of the channel with every heartbeat.

    A tick's records end with those of the truth, so that these stand at a fixed distance from its end.

    stamped : the bus says when each frame was received; logged in a topic of its own, one record a frame
    """

    def __init__(self, channel: Channel, link: Link, tick_ns: int, stamped: bool = False) -> None:
        self._channel = channel
        self.link = link
        self._tick_ns = tick_ns
        self._rivals_said: set[int] = set()
        self._truth = make_packer()
        attitude, wheels, gyro = self._truth.prefixes
        self._prefixes = (attitude, wheels, gyro)
        self._counters = TickPacker([COUNTERS], COUNTERS_CHANNEL)
        self._stamps = TickPacker([STAMPS], STAMPS_CHANNEL) if stamped else None
        self._bus: TickPacker | None = None
        self._arrivals: list[tuple[int, int, int]] = []  # of this tick: time, id, frames dropped so far
        packers = [self._truth, self._counters, *([self._stamps] if self._stamps else [])]
        link.announce(announce_topics(packers, {FRAMES_CHANNEL: BUS_NAME}), self._pack_rows)

    def show_bus(self) -> None:
        """Have a record of the wire on every tick from the next on."""
        self._bus = bus = TickPacker([BUS], BUS_CHANNEL)
        self.link.flush()
        self.link.announce(announce_topics([bus]), self._pack_rows)

    def note_arrival(self, batch: bytes, transport: Transport) -> None:
        """Keep the kernel's stamps of the frames that the transport has just returned."""
        if self._stamps is not None and batch:
            dropped = transport.counters.dropped
            ids = FRAME_ID.iter_unpack(batch)
            stamps = transport.kernel_stamps_ns
            self._arrivals += [(stamp_ns, can_id, dropped) for (can_id,), stamp_ns in zip(ids, stamps, strict=False)]

    def write(self, frames: bytes, bus: tuple[float, ...] = ()) -> None:
        """Log this tick: the frames in the order of the bus, the truth at the time of sampling, new fault events.

        bus : what the wire has to show, where there is one
        """
        channel = self._channel
        tick = channel.tick
        t_ns = tick * self._tick_ns
        for event in channel.events:
            self._announce(event, t_ns)
        counts: tuple[int, ...] = ()
        if tick % channel.heartbeat_ticks == 0:
            now = channel.counters
            counts = (now.accepted, now.refused, now.foreign, now.too_old, now.timeouts, channel.count_rivals())
            self._say_rivals(t_ns)
        if COMPILED:
            self.link.write_row((tick, t_ns, self._pack(tick, t_ns, frames, counts, bus)))
        else:
            self.link.write_row((tick, t_ns, frames, channel.snapshot, tuple(self._arrivals), counts, bus))
        self._arrivals.clear()

    def _pack(self, tick: int, t_ns: int, frames: bytes, counts: tuple[int, ...], bus: tuple[float, ...]) -> bytes:
        """The records of this tick, at once: compiled, that costs less than to keep what they are made of."""
        head = stamp(tick, t_ns)
        is_more = self._arrivals or counts or bus
        between = self._pack_between(head, self._arrivals, counts, bus) if is_more else b""
        return pack_tick(FRAMES_CHANNEL, head, frames, between, self._prefixes, self._channel.snapshot)

    def _pack_between(
        self, head: bytes, arrivals: Sequence[tuple[int, int, int]], counts: tuple[int, ...], bus: tuple[float, ...]
    ) -> bytes:
        """The records that a tick has now and then: stamps of the kernel, counters, the wire."""
        data = b""
        if self._stamps is not None:
            pack_stamp = self._stamps.pack_stamped
            data = b"".join([pack_stamp(head, arrival) for arrival in arrivals])
        if counts:
            data += self._counters.pack_stamped(head, counts)
        return data + self._bus.pack_stamped(head, bus) if bus and self._bus is not None else data

    def _say_rivals(self, t_ns: int) -> None:
        """A line, once an id, when a second node is seen to send what only one may."""
        for can_id in self._channel.list_rivals():
            if can_id not in self._rivals_said:
                self._rivals_said.add(can_id)
                self.link.event(t_ns, "warning", "plant", f"two senders of 0x{can_id:03X} on the bus")

    def _pack_rows(self, rows: list[Row]) -> list[bytes]:
        """The records of each tick, from what `write` noted."""
        if COMPILED:
            return [row[2] for row in rows]
        flatten, pack_truth, records = Plant.flatten, self._truth.pack_stamped, []
        for tick, t_ns, frames, snapshot, arrivals, counts, bus in rows:
            head = stamp(tick, t_ns)
            data = pack_frames_stamped(FRAMES_CHANNEL, head, frames)
            if arrivals or counts or bus:
                data += self._pack_between(head, arrivals, counts, bus)
            records.append(data + pack_truth(head, flatten(snapshot)))
        return records

    # -- now and then --------------------------------------------------------------------------------------------------

    def _announce(self, event: FaultEvent, t_ns: int) -> None:
        fault = event.fault
        self.link.fault(
            t_ns, event.tick, fault.unit, fault.kind, event.phase, event.value, fault.describe(),
            id=event.id, number=event.number, definition=fault.definition,
        )  # fmt: skip
        self.link.event(t_ns, LEVELS[event.phase], "plant", describe_event(event))

    def note_command(self, command: Command, tick: int, done: str) -> None:
        """Log a command that was applied before the work of this tick."""
        self.link.event(
            tick * self._tick_ns, "info", "plant", f"{command.verb} by {command.origin} at tick {tick}: {done}"
        )

    def note_refusal(self, command: Command, tick: int, reason: str) -> None:
        """Log a command that was refused before the work of this tick, and why."""
        t_ns = tick * self._tick_ns
        asked = {key: str(command.arguments.get(key, "")) for key in ("unit", "kind", "id")}
        self.link.fault(
            t_ns,
            tick,
            asked["unit"],
            asked["kind"],
            "refused",
            0.0,
            reason,
            id=asked["id"],
            definition=command.to_json(),
        )
        self.link.event(
            t_ns, "warning", "plant", f"{command.verb} by {command.origin} at tick {tick} refused: {reason}"
        )


def describe_event(event: FaultEvent) -> str:
    """Return what has become of a fault, as a line for people: the same in the log and on every link."""
    phase = f"{event.phase} by {event.by}" if event.by else event.phase
    return f"fault {phase}: {event.id}: {event.fault.describe()}"
