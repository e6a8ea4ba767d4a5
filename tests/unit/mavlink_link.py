"""What tests of the MAVLink side share: a bench with a link, and a ground program's end of it."""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from bus.clock import SystemClock
from bus.mavlink import words
from bus.mavlink.endpoint import Endpoint
from bus.mavlink.json_parts import Assembler, cut_request
from bus.run import GroundConfig
from plant_server.ground import open_ground
from tools.run.bench import Bench

ONE_STAR = ["duration_s=20"]
TOKENS = itertools.count(1)


class GroundEnd:
    """A ground program's socket beside a component's."""

    def __init__(self, directory: Path, name: str = "g", to: str = "plant.sock") -> None:
        self.endpoint = Endpoint(directory / f"{name}.sock", words.GROUND_SYSTEM_ID, words.GROUND_COMPONENT)
        self.to = str(directory / to)
        self._assembler = Assembler()

    def ask(self, what: dict[str, Any], token: int | None = None) -> int:
        """Send a request to the plant; return its token."""
        token = next(TOKENS) if token is None else token
        for message in cut_request(what, token, words.SYSTEM_ID, words.PLANT_COMPONENT):
            assert self.endpoint.send(message, self.to)
        return token

    def hear(self) -> list[Any]:
        """Everything that has come."""
        return [message for message, _ in self.endpoint.poll(10_000)]

    def replies(self) -> list[dict[str, Any]]:
        """The replies that have come, in their order."""
        found = [self._assembler.add(m) for m in self.hear() if m.get_type() == "HILSAT_REPLY"]
        return [what for what in found if what is not None]


@contextmanager
def linked_bench(
    overrides: list[str] | None = None, *, inject: bool = True, scenario: str = "zhang2018", ticks: int | None = 200
) -> Iterator[tuple[Bench, GroundEnd]]:
    """A bench in this process whose plant has a link, with its log in memory, and the other end of the link."""
    bench = Bench.open(scenario, [*ONE_STAR, "faults=[]", "expect=[]", *(overrides or [])], log="memory")
    with tempfile.TemporaryDirectory(prefix="hs-", dir="/tmp") as name:
        config = GroundConfig(socket=f"{name}/plant.sock", inject=inject)
        ground = open_ground(bench.plant_node, config, SystemClock(), name="bench", ticks=ticks)
        end = GroundEnd(Path(name))
        try:
            yield bench, end
        finally:
            ground.close()
            end.endpoint.close()
            bench.close()
