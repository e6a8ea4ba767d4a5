"""Faults of the bus itself: what becomes of the frames that a node sends or that are meant for it.

They act on the frames at the flight computer's connector, whatever carries them. SYNC and CYCLE_DONE, the beat of the test
bench, are left alone. The wire of plant_server/can_bus carries out what is said here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from bus.units import Ge, Gt, Hz, Le, Seconds
from plant_server.config import PlantConfig
from plant_server.faults.bus_nodes import ALL, PACING_IDS, ROUTES, Node
from plant_server.faults.effects import Acting, BusEffect, BusFrame, register

CanId = Annotated[int, Ge(0), Le(0x7FF)]
HALF_A_TICK = 0.5  # after the samples of a tick the flight software's cycle runs, and as long after it the tick ends
MOST_BITS = 8


@register("bus", "loss")
@dataclass(frozen=True, slots=True, kw_only=True)
class Loss(BusEffect):
    """with `probability` per frame, it does not arrive"""

    draws_each = 1
    equation = "frames"
    seen_in = "a receive buffer that overruns, a loose connector"
    failures = ((109, 7),)
    probability: Annotated[float, Gt(0), Le(1)] = 0.1
    node: Node = "all"  # frames that it sends or that are meant for it
    can_id: CanId | None = None  # of these alone the frames with this id

    def disturb(self, frame: BusFrame, now: Acting) -> bool:
        """Lose the frame when chance has it."""
        if now.drawn[0] >= now.level * self.probability:
            return False
        frame.lost = "loss"
        return True


@register("bus", "delay")
@dataclass(frozen=True, slots=True, kw_only=True)
class Delay(BusEffect):
    """frames arrive `delay_s` late; on time where that is at most half a tick"""

    delays = True
    equation = "frames"
    seen_in = "a gateway with a queue, a driver with a slow task"
    failures = ((109, 6),)
    delay_s: Annotated[Seconds, Gt(0), Le(10)] = 0.1
    node: Node = "all"  # frames that it sends or that are meant for it
    can_id: CanId | None = None  # of these alone the frames with this id

    def disturb(self, frame: BusFrame, now: Acting) -> bool:
        """Hold the frame back; several delays add up."""
        frame.delay_s += now.level * self.delay_s
        return now.level > 0.0

    def explain_short(self, tick_s: float) -> str | None:
        """Return why, when the frames still arrive in time for the cycle and the end of the tick."""
        return _explain_short("delay_s", self.delay_s, tick_s)


@register("bus", "jitter")
@dataclass(frozen=True, slots=True, kw_only=True)
class Jitter(BusEffect):
    """frames arrive late by chance, up to `jitter_s`; those of one id stay in their order"""

    delays = True
    draws_each = 1
    equation = "frames"
    seen_in = "a busy gateway, an operating system that lets its driver wait"
    jitter_s: Annotated[Seconds, Gt(0), Le(10)] = 0.1
    node: Node = "all"  # frames that it sends or that are meant for it
    can_id: CanId | None = None  # of these alone the frames with this id

    def disturb(self, frame: BusFrame, now: Acting) -> bool:
        """Hold the frame back for a while."""
        frame.delay_s += now.level * self.jitter_s * now.drawn[0]
        return now.level > 0.0

    def explain_short(self, tick_s: float) -> str | None:
        """Return why, when the frames still arrive in time for the cycle and the end of the tick."""
        return _explain_short("jitter_s", self.jitter_s, tick_s)


@register("bus", "duplicate")
@dataclass(frozen=True, slots=True, kw_only=True)
class Duplicate(BusEffect):
    """with `probability` per frame, it arrives twice"""

    draws_each = 1
    equation = "frames"
    seen_in = "an error in the last bit of a frame: taken by the receiver, sent again by the sender (ISO 11898-1)"
    probability: Annotated[float, Gt(0), Le(1)] = 0.1
    node: Node = "all"  # frames that it sends or that are meant for it
    can_id: CanId | None = None  # of these alone the frames with this id

    def disturb(self, frame: BusFrame, now: Acting) -> bool:
        """Deliver the frame once more when chance has it."""
        if now.drawn[0] >= now.level * self.probability:
            return False
        frame.copies += 1
        return True


@register("bus", "reorder")
@dataclass(frozen=True, slots=True, kw_only=True)
class Reorder(BusEffect):
    """with `probability` per frame, it arrives behind the next one of its id"""

    brings_rivals = True
    draws_each = 1
    equation = "frames"
    seen_in = "a controller with several transmit buffers, a gateway with two paths"
    probability: Annotated[float, Gt(0), Le(1)] = 0.1
    node: Node = "all"  # frames that it sends or that are meant for it
    can_id: CanId | None = None  # of these alone the frames with this id

    def disturb(self, frame: BusFrame, now: Acting) -> bool:
        """Let the frame be overtaken when chance has it."""
        if now.drawn[0] >= now.level * self.probability:
            return False
        frame.swapped = True
        return True


@register("bus", "bit_errors")
@dataclass(frozen=True, slots=True, kw_only=True)
class BitErrors(BusEffect):
    """with `probability` per frame, `bits` bits of its data are turned"""

    draws_each = 1 + MOST_BITS
    on_wire = True
    equation = "frames; with bus.timing: real seen by CAN's own CRC, which costs an error frame and another attempt"
    seen_in = "radiation, a damaged cable, missing termination"
    failures = ((109, 3),)
    probability: Annotated[float, Gt(0), Le(1)] = 0.1
    bits: Annotated[int, Ge(1), Le(MOST_BITS)] = 1
    node: Node = "all"  # frames that it sends or that are meant for it
    can_id: CanId | None = None  # of these alone the frames with this id

    def disturb(self, frame: BusFrame, now: Acting) -> bool:
        """Turn bits when chance has it, each another one."""
        if now.drawn[0] >= now.level * self.probability:
            return False
        broken = list(frame.broken_bits)
        for number in now.drawn[1 : 1 + self.bits]:
            bit = int(number * 64.0)
            while bit in broken and len(broken) < 64:
                bit = (bit + 1) % 64
            broken.append(bit)
        frame.broken_bits = tuple(broken)
        return True


@register("bus", "wrong_dlc")
@dataclass(frozen=True, slots=True, kw_only=True)
class WrongDlc(BusEffect):
    """with `probability` per frame, it has `dlc` data bytes and no more"""

    draws_each = 1
    equation = "frames"
    seen_in = "a node with another edition of the interface"
    failures = ((109, 4),)
    probability: Annotated[float, Gt(0), Le(1)] = 1.0
    dlc: Annotated[int, Ge(0), Le(7)] = 4
    node: Node = "all"  # frames that it sends or that are meant for it
    can_id: CanId | None = None  # of these alone the frames with this id

    def disturb(self, frame: BusFrame, now: Acting) -> bool:
        """Cut the frame when chance has it."""
        if now.drawn[0] >= now.level * self.probability:
            return False
        frame.dlc = self.dlc
        return True


@register("bus", "silent")
@dataclass(frozen=True, slots=True, kw_only=True)
class Silent(BusEffect):
    """a node sends nothing; it still hears"""

    rises = False
    switches = True
    sends_only = True
    equation = "frames"
    seen_in = "a transmitter that has died, a transceiver in its listen-only state"
    node: Node = "wheel.1"  # which
    can_id: CanId | None = None  # the frames with this id alone

    def disturb(self, frame: BusFrame, now: Acting) -> bool:
        """Lose the frame."""
        if now.level > 0.0:
            frame.lost = "silent"
        return now.level > 0.0


@register("bus", "bus_off")
@dataclass(frozen=True, slots=True, kw_only=True)
class BusOff(BusEffect):
    """a node cannot send: its error counter climbs by 8 an attempt, and from 256 on it neither sends nor hears"""

    rises = False
    switches = True
    sends_only = True
    equation = "TEC + 8 an attempt; bus-off from 256, back after 128 times 11 recessive bits once the fault is over"
    seen_in = "a transceiver with a broken driver, a wrong bit rate"
    failures = ((109, 1),)
    node: Node = "wheel.1"  # which
    auto_recovery: bool = (
        True  # false: its software does not restart the controller, it stays off to the end of the run
    )

    def disturb(self, frame: BusFrame, now: Acting) -> bool:
        """Let the sender's attempts fail."""
        frame.is_off = frame.is_off or now.level > 0.0
        return now.level > 0.0


@register("bus", "dominant")
@dataclass(frozen=True, slots=True, kw_only=True)
class Dominant(BusEffect):
    """the bus is held dominant: nobody gets a frame through"""

    rises = False
    switches = True
    equation = "frames; REC + 8 for each eight bits, so that every node is error passive at once"
    seen_in = "a shorted line, a transceiver that holds the bus"
    failures = ((109, 2),)

    def disturb(self, frame: BusFrame, now: Acting) -> bool:
        """Let nothing begin."""
        frame.is_blocked = frame.is_blocked or now.level > 0.0
        return now.level > 0.0


@register("bus", "babble")
@dataclass(frozen=True, slots=True, kw_only=True)
class Babble(BusEffect):
    """a node sends `rate_hz` frames of `can_id` beside its own, eight zero bytes each"""

    rises = False
    switches = True
    sends_only = True
    equation = "frames; with bus.timing: real they take the bus's time, and a low id starves the others"
    seen_in = "babbling idiot: software in a loop, a timer that runs wild"
    failures = ((109, 5),)
    rate_hz: Annotated[Hz, Le(20000)] = 1000.0
    can_id: CanId = 0x010  # lower than every other: it wins each arbitration
    node: Node = "wheel.1"  # which

    def disturb(self, frame: BusFrame, now: Acting) -> bool:
        """Send more."""
        if now.level > 0.0:
            frame.extra_hz += self.rate_hz
        return now.level > 0.0

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when that id is not to be touched or no single node sends it."""
        return _explain_sender(self.node, self.can_id)


@register("bus", "masquerade")
@dataclass(frozen=True, slots=True, kw_only=True)
class Masquerade(BusEffect):
    """once a tick a node sends a frame of another node's `can_id`, with right checksum and a counter of its own"""

    brings_rivals = True
    rises = False
    switches = True
    sends_only = True
    equation = "frames; the two senders of an id show in the alive counters, and are counted as rivals"
    seen_in = "a node that was configured with another's id, a replayed recording, an intruder"
    node: Node = "wheel.2"  # which
    can_id: CanId = 0x190  # of another node
    content: Literal["stale", "foreign"] = (
        "stale"  # what the last frame of that id carried at the onset; its own last frame
    )

    def disturb(self, frame: BusFrame, now: Acting) -> bool:
        """Forge the id."""
        frame.forged = frame.forged or now.level > 0.0
        return now.level > 0.0

    def explain_futile(self, plant: PlantConfig | None, unit: str) -> str | None:
        """Return why, when that id is its own, is nobody's or is not to be touched."""
        route = ROUTES.get(self.can_id)
        if route is None and self.can_id not in PACING_IDS:
            return f"has no effect: 0x{self.can_id:03X} is sent by no node; give can_id that of another node"
        if route is not None and route[0] == self.node:
            return f"has no effect: 0x{self.can_id:03X} is {self.node}'s own id; give can_id that of another node"
        return _explain_sender(self.node, self.can_id)


def _explain_sender(node: str, can_id: int) -> str | None:
    if can_id in PACING_IDS:
        return f"0x{can_id:03X} paces the run and is left alone by faults of the bus; give another can_id"
    return "takes one node that does it, not all; give node another value" if node == ALL else None


def _explain_short(key: str, delay_s: float, tick_s: float) -> str | None:
    if delay_s > HALF_A_TICK * tick_s:
        return None
    limit_s = HALF_A_TICK * tick_s
    return f"{key} {delay_s:g} s has no effect: frames up to half a tick late, {limit_s:g} s, are still in time"
