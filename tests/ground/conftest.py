"""A vehicle on a bench and a ground program of stock pymavlink, for the tests of the link between them."""

from __future__ import annotations

import contextlib
import json
import os
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import development as stock

from bus.mavlink import dialect
from bus.run import GroundConfig
from fsw.ground import FswGround, open_ground
from tools.run.bench import Bench

TICK_NS = 10_000_000  # of wall time: the bench flies ten times as fast as it is


class Clock:
    """Wall time as the test says."""

    def __init__(self) -> None:
        self.ns = 1_000_000_000_000

    def now_ns(self) -> int:
        return self.ns


class Vehicle:
    """A bench whose flight software has a link to the ground; wall time goes on with the ticks."""

    def __init__(self, path: Path, station: Any, scenario: str = "nominal", *overrides: str) -> None:
        self.bench = Bench.open(scenario, list(overrides), log="memory")
        self.clock = Clock()
        self.ground: FswGround = open_ground(self.bench.fsw_node, GroundConfig(socket=str(path)), self.clock)
        self.station = station

    @property
    def flight(self) -> Any:
        return self.bench.flight

    def step(self, ticks: int = 1) -> list[Any]:
        """Fly that many ticks; the messages that the ground heard meanwhile."""
        heard: list[Any] = []
        for _ in range(ticks):
            self.clock.ns += TICK_NS
            self.bench.step()
            heard += self.station.listen()
        return heard

    def ask(self, *params: float, ticks: int = 1, **more: Any) -> int:
        """Send a command; its result. Exactly one answer must come."""
        self.station.command(int(params[0]), *params[1:], **more)
        (ack,) = [m for m in self.step(ticks) if m.get_type() == "COMMAND_ACK"]
        assert ack.command == params[0]
        return int(ack.result)

    def events(self) -> list[str]:
        """The words in the log so far."""
        return [json.loads(r.data)["message"] for _, r in self.bench.log.iterate_topics("/events")]


class Station:
    """A ground program made of stock pymavlink, on a Unix socket. What that does not know yet it reads by our dialect."""

    def __init__(self, path: Path, vehicle: Path) -> None:
        self.vehicle = vehicle
        self.protocol = stock.MAVLink(None, 255, 190)
        self.reader = stock.MAVLink(None, 0, 0)
        self.reader.robust_parsing = True
        self.newer = dialect.MAVLink(None, 0, 0)
        self.heard: list[Any] = []
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(os.fspath(path))
        self._socket.settimeout(0.0)

    def send(self, message: Any) -> None:
        """Send a message of the stock dialect."""
        packet = message.pack(self.protocol)
        self.protocol.seq = (self.protocol.seq + 1) % 256
        self.send_bytes(packet)

    def send_bytes(self, data: bytes) -> None:
        """Send a datagram, whatever is in it."""
        self._socket.sendto(data, os.fspath(self.vehicle))

    def heartbeat(self) -> None:
        """Say that there is a ground program."""
        self.send(stock.MAVLink_heartbeat_message(stock.MAV_TYPE_GCS, stock.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3))

    def command(self, command: int, *params: float, confirmation: int = 0, component: int = 1) -> None:
        """Send a COMMAND_LONG, parameters that are left out as 0."""
        seven = [*params, *[0.0] * (7 - len(params))]
        self.send(stock.MAVLink_command_long_message(1, component, command, confirmation, *seven))

    def listen(self, wait_s: float = 0.0) -> list[Any]:
        """Return the messages that have come since the last time, in order."""
        came: list[Any] = []
        self._socket.settimeout(wait_s)
        with contextlib.suppress(BlockingIOError, TimeoutError):
            while True:
                for message in self.reader.parse_buffer(self._socket.recv(65536)) or []:
                    unknown = message.get_type().startswith("UNKNOWN")
                    came.append(self.newer.decode(bytearray(message.get_msgbuf())) if unknown else message)
                self._socket.settimeout(0.0)
        self.heard += came
        return came

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


@pytest.fixture
def station(tmp_path: Path) -> Iterator[Station]:
    """A stock ground program for the vehicle whose socket is `vehicle` in the test's directory."""
    found = Station(tmp_path / "station", tmp_path / "vehicle")
    yield found
    found.close()


@pytest.fixture
def make_vehicle(tmp_path: Path, station: Station) -> Iterator[Any]:
    """Makes the vehicle: `make_vehicle(scenario, overrides...)`, once a test."""
    made: list[Vehicle] = []

    def make(scenario: str = "nominal", *overrides: str) -> Vehicle:
        made.append(Vehicle(tmp_path / "vehicle", station, scenario, *overrides))
        return made[-1]

    yield make
    for vehicle in made:
        vehicle.ground.close()
        vehicle.bench.close()


@pytest.fixture
def vehicle(make_vehicle: Any) -> Vehicle:
    """A vehicle that points, and a ground program that it knows."""
    found: Vehicle = make_vehicle()
    found.station.heartbeat()
    found.step(20)
    return found
