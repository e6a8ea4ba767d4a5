"""The bus measurements measure what they say. Their figures belong to the machine, and no test asserts one."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from typing import Any

import pytest

from tools.measure import bus
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
    """A reader that stands still while more frames come than its queue holds loses some, and the count says so."""
    children: list[subprocess.Popen[bytes]] = []
    start_child, stream, await_account = bus._start_child, bus._stream, bus._await_account

    def keep_child(stack: contextlib.ExitStack, role: str, where: str) -> None:
        children.append(start_child(stack, role, where))

    def stream_to_a_stopped_reader(*args: Any) -> tuple[int, int]:
        children[0].send_signal(signal.SIGSTOP)
        return stream(*args)

    def wake_and_await(*args: Any) -> tuple[int, int]:
        children[0].send_signal(signal.SIGCONT)
        return await_account(*args)

    monkeypatch.setattr(bus, "WINDOW", 60_000)
    monkeypatch.setattr(bus, "ASK_AFTER_S", 5.0)  # a question that finds no room would be counted with the frames
    monkeypatch.setattr(bus, "_start_child", keep_child)
    monkeypatch.setattr(bus, "_stream", stream_to_a_stopped_reader)
    monkeypatch.setattr(bus, "_await_account", wake_and_await)
    result = measure_one_way("hub:", 64_000, 1000)
    assert result["lost"] == result["dropped_by_bus"] > 0
