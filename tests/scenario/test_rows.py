"""What a tick leaves behind for the log must not change before it is packed."""

from __future__ import annotations

import pytest

from bus.telemetry.link import Link, Row
from tools.config.loader import load_scenario
from tools.config.scenario_files import find_scenario, list_shipped
from tools.run.bench import Bench


class Keeper(Link):
    """Keeps the rows of one side, and how they look when they are handed over."""

    def __init__(self) -> None:
        super().__init__(hold_ticks=1)
        self.rows: list[tuple[Row, str]] = []

    def write_row(self, row: Row) -> None:
        self.rows.append((row, repr(row)))

    def write_json(self, topic: str, t_ns: int, payload: bytes) -> None: ...


@pytest.mark.parametrize("name", list_shipped())
def test_rows_hold_nothing_that_can_change(name: str) -> None:
    """Every value in them, to the last digit, is the same up to 60 ticks later."""
    plant, fsw = Keeper(), Keeper()
    Bench(load_scenario(find_scenario(name), ["clock.mode=inprocess", "expect=[]"]), plant, fsw).step(60)
    for keeper in (plant, fsw):
        assert len(keeper.rows) == 60
        assert all(repr(row) == before for row, before in keeper.rows)
