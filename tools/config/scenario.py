"""A scenario: one vehicle, its faults, its flight software, what the run must show. Read by tools/config/loader.py."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from bus.run import BusConfig, ClockConfig, GroundConfig, Seed, run_hash
from bus.settings import plain
from bus.texts import Line, Name, Prose
from bus.units import Gt, Seconds
from fsw.config import FswConfig
from plant_server.config import PlantConfig
from plant_server.faults import Fault
from tools.config.expect import Expectation
from tools.config.findings import Source


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """A whole scenario file, after `extends` and overrides."""

    name: Name  # short, also names the log file
    title: Line = ""  # one line for reports
    description: Prose = ""  # what it shows, and where the numbers come from
    seed: Seed = 0  # of every random stream in the plant
    duration_s: Annotated[Seconds, Gt(0)]  # simulated time, whole ticks
    clock: ClockConfig = field(default_factory=ClockConfig)
    bus: BusConfig = field(default_factory=BusConfig)
    inject: Literal["off", "allowed"] = "off"  # whether a running bench takes faults from `hilsat inject`
    plant: PlantConfig
    faults: tuple[Fault, ...] = ()  # each must take effect, or the run fails
    fsw: FswConfig
    expect: tuple[Expectation, ...] = ()  # all must hold for the run to pass


@dataclass(frozen=True)
class Resolved:
    """A scenario that was found sound: every value in it, whether written or by default."""

    scenario: Scenario
    path: Path  # of the file it was read from
    sources: tuple[Source, ...]  # the texts it was read from: the file, those it extends, overrides

    @classmethod
    def of(cls, scenario: Scenario) -> Self:
        """A scenario that was built in Python. Plant and flight software still check their parts; no file is behind it."""
        return cls(scenario, Path(scenario.name), ())

    @cached_property
    def run_hash(self) -> int:
        """Number (u32) that both processes announce: see bus.settings.run_hash."""
        return run_hash(self.as_dict())

    @property
    def ticks(self) -> int:
        """Number of ticks of the whole run."""
        return round(self.scenario.duration_s * self.scenario.clock.tick_hz)

    def as_dict(self) -> dict[str, Any]:
        """The scenario in JSON types; the same keys as in a scenario file."""
        result: dict[str, Any] = plain(self.scenario)
        return result

    def to_yaml(self) -> str:
        """The scenario as a file of its own, nothing left out; reads back as the same."""
        return "".join(_write_section(json.dumps({key: value})) for key, value in self.as_dict().items())

    def run_dict(self, address: str | None = None) -> dict[str, Any]:
        """What both processes are told of the run (bus.settings.RunConfig), in JSON types.

        address : the bus in place of the scenario's (such as the directory made for "hub:")
        """
        item = self.scenario
        bus = plain(item.bus)
        return {
            "name": item.name,
            "seed": item.seed,
            "duration_s": item.duration_s,
            "clock": plain(item.clock),
            "bus": bus if address is None else bus | {"address": address},
            "run_hash": self.run_hash,
        }

    def plant_json(self, address: str | None = None, ground: GroundConfig | None = None) -> str:
        """What the plant's process gets: run, plant, faults, and its socket for MAVLink where it has one."""
        part = {
            "run": self.run_dict(address),
            "plant": plain(self.scenario.plant),
            "faults": plain(self.scenario.faults),
        }
        return json.dumps(part | _name_ground(ground), allow_nan=False)

    def fsw_json(self, address: str | None = None, ground: GroundConfig | None = None) -> str:
        """What the flight software's process gets: run and fsw; nothing of plant or faults."""
        part = {"run": self.run_dict(address), "fsw": plain(self.scenario.fsw)}
        return json.dumps(part | _name_ground(ground), allow_nan=False)


def _name_ground(ground: GroundConfig | None) -> dict[str, Any]:
    return {} if ground is None else {"ground": plain(ground)}


@lru_cache(maxsize=64)
def _write_section(section_json: str) -> str:
    """The YAML of one key of the file. Kept, for runs of a campaign differ in one or two keys, mostly the seed."""
    from tools.config.yaml_nodes import write_yaml

    return write_yaml(json.loads(section_json))
