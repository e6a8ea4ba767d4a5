"""What both processes are told about the run: clock, bus, length, and the number that both must agree on."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from bus.texts import Name
from bus.units import Ge, Gt, Le, Seconds, Unit

Seed = Annotated[int, Ge(0), Le(2**64 - 1)]

# What decides the bytes of a run. Bus, clock mode and grading may differ between runs of the same bytes.
HASHED_KEYS = ("seed", "duration_s", "plant", "faults", "fsw")


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockConfig:
    """Who waits for whom, and how often the loop turns."""

    mode: Literal["lockstep", "realtime", "inprocess"] = "lockstep"  # realtime: nobody waits; inprocess: no bus
    tick_hz: Annotated[int, Unit("Hz"), Ge(1), Le(1000)] = 100  # the period must be whole nanoseconds


@dataclass(frozen=True, slots=True, kw_only=True)
class BusConfig:
    """The bus that the two sides meet on."""

    address: str = "hub:"  # hub: (a fresh private directory), hub:<dir>, socketcan:vcan0, memory:, ...
    bitrate_bps: Annotated[int, Unit("bit/s"), Ge(10_000), Le(1_000_000)] = 500_000  # the load is checked against this
    timing: Literal["none", "real"] = "none"  # real: frames take as long as on a bus of that bit rate, and arbitrate


USUAL_BUS = BusConfig()


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """The part of a scenario that both sides get: key `run` of the file each process is started with."""

    name: Name
    seed: Seed
    duration_s: Annotated[Seconds, Gt(0)]
    clock: ClockConfig = field(default_factory=ClockConfig)
    bus: BusConfig = field(default_factory=BusConfig)
    run_hash: Annotated[int, Ge(0), Le(0xFFFFFFFF)]

    @property
    def tick_ns(self) -> int:
        """Period of the loop [ns]."""
        return 1_000_000_000 // self.clock.tick_hz

    @property
    def ticks(self) -> int:
        """Number of ticks of the whole run."""
        return round(self.duration_s * self.clock.tick_hz)


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundConfig:
    """A side's socket for MAVLink, where it has one: key `ground` of the file a process is started with."""

    socket: str  # path of a Unix datagram socket that this side makes, in the run's private directory
    inject: bool = False  # whether faults may be injected by command; no concern of the flight software


def run_hash(resolved: dict[str, Any]) -> int:
    """Number (u32) that two peers must agree on: it stands for everything that decides the bytes of the run.

    First four bytes, little endian, of the SHA-256 over seed, duration, tick rate, plant, faults and flight software.
    Bus, clock mode, recording and grading do not count: the same bytes flow on every bus. A bus with the timing of a real
    one is another matter: timing and bit rate count then.
    """
    counted = {key: resolved[key] for key in HASHED_KEYS}
    counted["tick_hz"] = resolved["clock"]["tick_hz"]
    bus = resolved.get("bus") or {}
    if bus.get("timing", "none") != "none":
        counted["bus"] = {key: bus[key] for key in ("timing", "bitrate_bps")}
    text = json.dumps(counted, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "little")
