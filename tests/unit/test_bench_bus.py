"""The bus measurements measure what they say. Their figures belong to the machine, and no test asserts one."""

from __future__ import annotations

import os

import pytest

from tools.measure.bus import measure_all, measure_one_way, measure_round_trip


def test_all_figures_are_there_and_nothing_was_lost() -> None:
    """Two processes each, every frame accounted for, and this process may run on all its cores again afterwards."""
    cores = os.sched_getaffinity(0)
    table = measure_all(rounds=50, frames=20_000)
    assert table["hub: frames lost"] == 0
    assert all(value > 0 for name, value in table.items() if name.startswith(("pair", "hub")) and "lost" not in name)
    assert os.sched_getaffinity(0) == cores


@pytest.mark.parametrize("address", ["pair", "hub:"])
def test_percentiles_are_in_order(address: str) -> None:
    trip = measure_round_trip(address, 100)
    assert 0 < trip["p50_us"] <= trip["p99_us"]


def test_a_bus_that_drops_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """With more frames under way than the reader's queue holds, some are lost, and the count says so.

    Whether the reader falls behind is up to the scheduler: in one of ten tries it does.
    """
    monkeypatch.setattr("tools.measure.bus.WINDOW", 60_000)
    for _ in range(10):
        result = measure_one_way("hub:", 64_000, 1000)
        assert result["lost"] == result["dropped_by_bus"]
        if result["lost"]:
            return
    pytest.fail("ten times, nothing was lost")
