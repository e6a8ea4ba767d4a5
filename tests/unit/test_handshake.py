"""Meeting: both sides find each other on a bus on which others speak too, and say so when only others do."""

from __future__ import annotations

import threading
import time

import pytest

from bus.clock import SystemClock
from bus.errors import PeerLostError, UsageError
from bus.icd.codec import DECODERS, encode_HEARTBEAT_FSW, encode_HEARTBEAT_PLANT
from bus.icd.e2e import Link
from bus.icd.heartbeat import BOOT, OPERATIONAL, PRE_OPERATIONAL, STOPPED, find_heartbeats
from bus.settings import build
from bus.wire.memory import MemoryTransport
from fsw.handshake import meet_plant, plant_stopped
from fsw.outputs import Outputs
from plant_server.channel import Channel
from plant_server.config import PlantConfig
from plant_server.handshake import meet_fsw
from plant_server.plant import Plant

OURS, THEIRS = 42, 77
PLANT_ID, FSW_ID = 0x701, 0x702


def make_server() -> Channel:
    data = {
        "body": {"inertia_kgm2": [[45, 3, 2], [3, 38, -1.5], [2, -1.5, 50]]},
        "wheels": [{"mount": mount} for mount in ("x", "y", "z", "skew")],
    }
    return Channel(Plant(build(PlantConfig, data, "test"), (), 0.1, 1), 0.1, OURS)


def chatter(bus: MemoryTransport, until: threading.Event) -> None:
    """A plant and flight software of another run, each with a counter of its own."""
    counter = 0
    while not until.wait(0.01):
        bus.send(encode_HEARTBEAT_PLANT(counter, 0, OPERATIONAL, THEIRS))
        bus.send(encode_HEARTBEAT_FSW(counter, 0, OPERATIONAL, THEIRS))
        counter = (counter + 1) % 15


def test_the_sides_meet_although_another_run_speaks_first() -> None:
    """Heartbeats with a foreign hash before and during the meeting are ignored and counted on both sides."""
    plant, fsw, other = (MemoryTransport("meet", node) for node in ("plant", "fsw", "other"))
    met, found = threading.Event(), []
    speaking = threading.Thread(target=chatter, args=(other, met))
    serving = threading.Thread(target=lambda: found.append(meet_fsw(plant, make_server(), OURS, 5.0, SystemClock())))
    speaking.start()
    serving.start()
    try:
        time.sleep(0.1)
        ignored = meet_plant(fsw, Outputs(OURS, 10), OURS, 5.0)
    finally:
        serving.join(5.0)
        met.set()
        speaking.join()
        for transport in (other, fsw, plant):
            transport.close()
    assert ignored > 0
    assert found
    assert found[0] > 0


@pytest.mark.parametrize("side", ["plant", "fsw"])
def test_only_others_is_a_wrong_scenario_and_nobody_is_a_lost_peer(side: str) -> None:
    """At the end of patience: exit 2 with both hashes where only foreign heartbeats came, exit 3 where none did."""
    own, other = MemoryTransport("alone", side), MemoryTransport("alone", "other")

    def meet() -> None:
        if side == "fsw":
            meet_plant(own, Outputs(OURS, 10), OURS, 0.15)
        else:
            meet_fsw(own, make_server(), OURS, 0.15, SystemClock())

    try:
        with pytest.raises(PeerLostError):
            meet()
        other.send(encode_HEARTBEAT_PLANT(0, 0, PRE_OPERATIONAL, THEIRS) + encode_HEARTBEAT_FSW(0, 0, BOOT, THEIRS))
        started_s = time.monotonic()
        with pytest.raises(UsageError, match="0x0000004d, ours is 0x0000002a"):
            meet()
        assert time.monotonic() - started_s >= 0.15
    finally:
        other.close()
        own.close()


def test_an_answer_that_is_read_late_is_in_sequence_with_the_run() -> None:
    """The plant's last word of the meeting has the counter ahead of the run's first heartbeat."""
    plant, fsw = MemoryTransport("late", "plant"), MemoryTransport("late", "fsw")
    outputs, server = Outputs(OURS, 10), make_server()
    try:
        fsw.send(outputs.heartbeat(BOOT))
        fsw.send(outputs.heartbeat(OPERATIONAL))
        with pytest.raises(PeerLostError):  # both in one batch: the second confirms nothing yet
            meet_fsw(plant, server, OURS, 0.05, SystemClock())
        link = Link(DECODERS[PLANT_ID])
        values = link.accept(fsw.recv(0.1)[8:16], 0)
        assert values is not None
        assert values[2] == PRE_OPERATIONAL
        server.begin()
        assert link.accept(server.heartbeat(OPERATIONAL)[8:], 0)
        assert (link.missing, link.outcome) == (0, "ok")
    finally:
        plant.close()
        fsw.close()


def test_heartbeats_are_found_among_other_frames() -> None:
    """Only those of the id asked for, with right checksum and length."""
    good = encode_HEARTBEAT_FSW(3, 0, BOOT, OURS)
    flipped = good[:12] + bytes([good[12] ^ 1]) + good[13:]
    short = good[:4] + b"\x07" + good[5:]
    batch = encode_HEARTBEAT_PLANT(0, 0, STOPPED, OURS) + flipped + good + short
    assert list(find_heartbeats(batch, FSW_ID)) == [(BOOT, OURS)]


def test_a_stop_of_another_run_is_no_stop() -> None:
    """Foreign heartbeats behind or ahead of ours do not change what ours say."""
    ours, theirs = (encode_HEARTBEAT_PLANT(0, 0, STOPPED, its) for its in (OURS, THEIRS))
    going = encode_HEARTBEAT_PLANT(0, 0, OPERATIONAL, OURS)
    assert plant_stopped(ours + theirs, OURS)
    assert not plant_stopped(going + theirs, OURS)
    assert not plant_stopped(theirs, OURS)
