"""The wire at the flight computer's connector: between the plant's nodes and whatever carries the frames.

One tick, on every clock: `send` takes what the nodes announce and returns what the flight software gets to see, SYNC last;
`hear` keeps what the flight software sends, and lets CYCLE_DONE through at once; `end` returns what the nodes get of it. The
flight software's cycle stands half a tick after the samples, as it does in real time: a telemetry frame up to half a tick
late is in time for it, and a command up to half a tick late is in time for the next tick.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, cast

from bus.wire.frames import FRAME, FRAME_SIZE
from plant_server.can_bus.controller import SEQUENCE_BITS
from plant_server.can_bus.counts import REASONS, TO_FSW, TO_PLANT, WireCounts
from plant_server.can_bus.frame_time import count_frame_bits
from plant_server.can_bus.line import Line, TimedLine
from plant_server.can_bus.parcel import Parcel
from plant_server.can_bus.stations import Stations
from plant_server.can_bus.traffic import Forger, count_babble, goes_to_plant, make_babble
from plant_server.faults.bus_nodes import FSW, NODES, PACING_IDS, find_route
from plant_server.faults.effects import BusEffect, BusFrame
from plant_server.faults.kinds.bus import Babble, BusOff, Dominant, Masquerade
from plant_server.faults.timeline import ActiveFault, FaultChain, FaultTimeline
from plant_server.faults.units import BUS as BUS_UNIT

NANO: Final = 1_000_000_000
OF_NODES: Final = (Babble, BusOff, Dominant, Masquerade)  # kinds that are not about single frames
Active = ActiveFault[BusEffect]


class Wire:
    """Every frame between the two sides, as the faults of the bus leave it."""

    def __init__(
        self, timeline: FaultTimeline, tick_ns: int, bitrate_bps: int, *, timed: bool = False, reports: bool = True
    ) -> None:
        """Begin with an empty bus.

        timed   : frames take as long as on a bus of this bit rate
        reports : error frames of the flight computer's controller go to it; not on real adapters, which have their own
        """
        self._timeline = timeline
        self._chain = cast(FaultChain[BusEffect], timeline.chains[BUS_UNIT])
        self._tick_ns, self._bitrate_bps = tick_ns, bitrate_bps
        self._tick_s = tick_ns * 1e-9
        self._reports = reports
        self.counts = WireCounts()
        self.stations = Stations()
        self._line: Line | TimedLine = (
            TimedLine(self.stations, self.counts, self._strikes)
            if timed
            else Line(self.stations, self.counts, self._find_bit(1))
        )
        self._timed = timed
        self._forger = Forger()
        self._active: tuple[Active, ...] = ()  # about single frames,
        self._of_nodes: tuple[Active, ...] = ()  # and the others
        self._delaying: list[Active] = []  # those that hold the present frame back
        self._last_due: dict[tuple[int, int], int] = {}  # by direction and id
        self._heard: list[bytes] = []  # of this tick, from the flight software
        self._tick = self._step = self._number = 0
        self._load = 0.0

    # -- one tick ----------------------------------------------------------------------------------------------------

    def send(self, tick: int, step: int, announced: bytes) -> bytes:
        """Return what the flight software gets to see of what the nodes announce on this tick, SYNC last.

        step : the integration step that comes next, for the events of faults
        """
        self._tick, self._step = tick, step
        self._find_faults()
        pacing = b""
        for frame in _split(announced):
            if _id_of(frame) in PACING_IDS:
                pacing += frame
                self._line.charge(count_frame_bits(frame))
            else:
                self._put(frame, TO_FSW)
        self._insert(TO_FSW)
        self._babble()
        seen = self._carry(TO_FSW, tick if not self._timed else self._find_half(2 * tick + 1))
        reports = self.stations.reporter.take()
        return seen + (reports if self._reports else b"") + pacing

    def hear(self, batch: bytes) -> bytes:
        """Return CYCLE_DONE out of frames of the flight software; the others are kept for `end`."""
        done = b""
        for frame in _split(batch):
            if _id_of(frame) in PACING_IDS:
                done += frame
                self._line.charge(count_frame_bits(frame))
            else:
                self._heard.append(frame)
        return done

    def end(self) -> bytes:
        """Return what the nodes get of the frames of the flight software by the end of the tick."""
        for frame in self._heard:
            self._put(frame, TO_PLANT)
        self._heard.clear()
        self._insert(TO_PLANT)
        arrived = self._carry(TO_PLANT, self._tick if not self._timed else self._find_half(2 * self._tick + 2))
        busy, frames = self._line.end_tick()
        bits = self._find_bit(self._tick + 1) - self._find_bit(self._tick)
        self._load = busy / bits
        if not self.stations.is_blocked:
            self.stations.note_recessive(frames + max(0, bits - busy) // SEQUENCE_BITS)
        return arrived

    def values(self) -> tuple[float, ...]:
        """Return the numbers of the topic /plant/bus, in the order of its fields."""
        counts, nodes = self.counts, [self.stations.controllers[node] for node in NODES]
        numbers: list[Sequence[int]] = [counts.sent, counts.duplicated, counts.inserted, counts.delivered]
        numbers += [counts.lost[reason] for reason in REASONS]
        numbers += [self._line.waiting(), counts.late, counts.broken]
        flat = [float(number) for pair in numbers for number in pair]
        flat += [float(counts.attempts_failed), float(self.stations.reporter.reported), self._load]
        flat += [float(node.tec) for node in nodes] + [float(node.rec) for node in nodes]
        return tuple(flat + [float(node.state) for node in nodes])

    def waiting(self) -> tuple[int, int]:
        """Return the number of frames on their way to the flight software and to the plant."""
        return self._line.waiting()

    # -- faults ------------------------------------------------------------------------------------------------------

    def _find_faults(self) -> None:
        """Bring the faults to this tick, and those of nodes and bus to work."""
        chain, t_s = self._chain, self._tick * self._tick_s
        if self._step >= chain.next_edge:
            chain.refresh(self._step)
        for entry in chain.active:
            entry.bring_to(t_s)
        acting = [entry for entry in chain.active if entry.now.level > 0.0]
        self._active = tuple(entry for entry in chain.active if not isinstance(entry.effect, OF_NODES))
        self._of_nodes = tuple(entry for entry in acting if isinstance(entry.effect, OF_NODES))
        failing: set[str] = set()
        stays_off: set[str] = set()
        is_blocked = False
        for entry in self._of_nodes:
            effect = entry.effect
            if isinstance(effect, Dominant):
                is_blocked = True
                self._note(entry)
            elif isinstance(effect, BusOff):
                nodes = NODES if effect.node == "all" else (effect.node,)
                failing.update(nodes)
                stays_off.update(() if effect.auto_recovery else nodes)
        self.stations.set_faults(frozenset(failing), frozenset(stays_off), is_blocked)

    def _treat(self, parcel: Parcel, on_wire: bool | None) -> BusFrame:
        """Return what the faults make of a frame.

        on_wire : only kinds that strike each attempt, or only the others; None: all
        """
        fate = BusFrame()
        self._delaying.clear()
        for entry in self._active:
            effect = entry.effect
            if on_wire is not None and effect.on_wire is not on_wire:
                continue
            if effect.concerns(parcel.can_id, parcel.sender, parcel.receiver):
                entry.draw_each()  # also where another fault has the frame already: nobody's chance depends on others
                if fate.lost or not effect.disturb(fate, entry.now):
                    continue
                if effect.delays:
                    self._delaying.append(entry)
                else:
                    self._note(entry)
        return fate

    def _strikes(self, parcel: Parcel) -> bool:
        """Whether an attempt to send a frame fails by chance."""
        return bool(self._treat(parcel, True).broken_bits)

    def _note(self, entry: Active) -> None:
        self._timeline.note_effect(entry, self._step)

    # -- frames ------------------------------------------------------------------------------------------------------

    def _put(self, frame: bytes, way: int) -> None:
        """Let a node send a frame."""
        can_id = _id_of(frame)
        sender, receiver = find_route(can_id, way == TO_PLANT)
        parcel = self._make_parcel(frame, can_id, sender, receiver, way)
        self.counts.sent[way] += 1
        self._forger.note(can_id, sender, frame)
        if sender in self.stations.failing:
            for entry in self._of_nodes:
                if isinstance(entry.effect, BusOff) and entry.effect.node in ("all", sender):
                    self._note(entry)
        fate = self._treat(parcel, False if self._timed else None)
        if fate.lost:
            self.counts.lost[fate.lost][way] += 1
            return
        if fate.broken_bits or fate.dlc >= 0:
            parcel.frame, parcel.is_broken = _break(frame, fate), True
        self._schedule(parcel, fate)
        self._line.put(parcel)
        for _ in range(fate.copies):
            self.counts.duplicated[way] += 1
            copy = self._make_parcel(parcel.frame, can_id, sender, receiver, way)
            copy.due, copy.is_swapped, copy.is_broken = parcel.due, parcel.is_swapped, parcel.is_broken
            self._line.put(copy)

    def _make_parcel(self, frame: bytes, can_id: int, sender: str, receiver: str, way: int) -> Parcel:
        self._number += 1
        due = self._tick if not self._timed else self._find_half(2 * self._tick + (way == TO_PLANT))
        return Parcel(frame, can_id, sender, receiver, way, self._number, self._tick, due)

    def _schedule(self, parcel: Parcel, fate: BusFrame) -> None:
        """Say when a frame may go on: no earlier than those of its id before it, but for one that is swapped."""
        if self._timed:
            late = round(fate.delay_s * self._bitrate_bps)
        else:
            late = max(0, math.ceil(fate.delay_s / self._tick_s - 0.5 - 1e-9))
        if late:
            parcel.due += late
            for entry in self._delaying:
                self._note(entry)
        key = (parcel.way, parcel.can_id)
        if fate.swapped:
            parcel.is_swapped = True
            parcel.due += self._find_bit(self._tick + 1) - self._find_bit(self._tick) if self._timed else 1
        else:
            parcel.due = self._last_due[key] = max(parcel.due, self._last_due.get(key, 0))

    def _carry(self, way: int, until: int) -> bytes:
        """Let the bus work up to a tick or a bit of its time; return what has arrived."""
        self._line.run(until)
        counts, arrived = self.counts, []
        for parcel in self._line.take(way, until):
            if self.stations.is_off(parcel.receiver):
                counts.lost["bus_off"][way] += 1
                continue
            counts.delivered[way] += 1
            counts.late[way] += parcel.tick < self._tick
            counts.broken[way] += parcel.is_broken
            arrived.append(parcel.frame)
        return b"".join(arrived)

    def _insert(self, way: int) -> None:
        """Let masquerading nodes send what goes in this direction."""
        for entry in self._of_nodes:
            effect = entry.effect
            if isinstance(effect, Masquerade) and goes_to_plant(effect.can_id, effect.node) == (way == TO_PLANT):
                frame = self._forger.forge(cast(ActiveFault[Masquerade], entry))
                if frame is not None:
                    self._add(entry, frame, effect.can_id, effect.node, way, 0, is_extra=False)

    def _babble(self) -> None:
        """Let babbling nodes send what they send in this tick."""
        for entry in self._of_nodes:
            effect = entry.effect
            if not isinstance(effect, Babble):
                continue
            way = TO_PLANT if goes_to_plant(effect.can_id, effect.node) else TO_FSW
            count = count_babble(effect, entry.now.elapsed_s, self._tick_s)
            bits = self._find_bit(self._tick + 1) - self._find_bit(self._tick)
            for number in range(count):
                after = number * bits // count if self._timed else 0
                self._add(entry, make_babble(effect), effect.can_id, effect.node, way, after, is_extra=True)

    def _add(
        self, entry: Active, frame: bytes, can_id: int, sender: str, way: int, after: int, *, is_extra: bool
    ) -> None:
        """Put a frame on the wire that no sound node sends.

        after : bits from the start of the tick for an extra one
        """
        self._note(entry)
        self.counts.inserted[way] += 1
        receiver = find_route(can_id, way == TO_PLANT)[1] if way == TO_PLANT else FSW
        parcel = self._make_parcel(frame, can_id, sender, receiver, way)
        parcel.is_extra = is_extra
        if is_extra and self._timed:
            parcel.due = self._find_bit(self._tick) + after
        self._line.put(parcel)

    def _find_bit(self, tick: int) -> int:
        """Return the bit of the bus's time at which a tick begins."""
        return self._find_half(2 * tick)

    def _find_half(self, halves: int) -> int:
        """Return the bit of the bus's time so many half ticks after the start of the run."""
        return halves * self._tick_ns * self._bitrate_bps // (2 * NANO)


def _split(batch: bytes) -> list[bytes]:
    return [batch[at : at + FRAME_SIZE] for at in range(0, len(batch), FRAME_SIZE)]


def _id_of(frame: bytes) -> int:
    return int.from_bytes(frame[:4], "little")


def _break(frame: bytes, fate: BusFrame) -> bytes:
    """Return a frame with turned bits and another length."""
    can_id, dlc, data = FRAME.unpack(frame)
    bits = int.from_bytes(data, "little")
    for bit in fate.broken_bits:
        bits ^= 1 << bit
    if fate.dlc >= 0:
        dlc = min(dlc, fate.dlc)
    return FRAME.pack(can_id, dlc, bits.to_bytes(8, "little")[:dlc])
