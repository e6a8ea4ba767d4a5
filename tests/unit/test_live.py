"""`hilsat live`: a viewer gets telemetry, scene and services over a real websocket, and breaks the bench with a button."""

from __future__ import annotations

import base64
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tools.cli import main
from tools.log.mcap_reader import read_run

LIVE = [sys.executable, "-P", "-m", "tools.cli", "live", "zhang2018", "--set", "faults=[]", "--set", "expect=[]"]
PATIENCE_S = 60.0


class Viewer:
    """A client of Foxglove's websocket protocol, on a bare socket."""

    def __init__(self, url: str) -> None:
        host, _, port = url.removeprefix("ws://").partition(":")
        self.socket = socket.create_connection((host, int(port)), timeout=PATIENCE_S)
        key = base64.b64encode(os.urandom(16)).decode()
        self.socket.sendall(
            f"GET / HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
        )
        self._rest = b""
        while b"\r\n\r\n" not in self._rest:
            self._rest += self.socket.recv(4096)
        head, self._rest = self._rest.split(b"\r\n\r\n", 1)
        assert b" 101 " in head.splitlines()[0]
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        self.numbers: dict[int, str] = {}

    def _take(self, size: int) -> bytes:
        while len(self._rest) < size:
            more = self.socket.recv(65536)
            assert more, "the server has gone"
            self._rest += more
        taken, self._rest = self._rest[:size], self._rest[size:]
        return taken

    def receive(self) -> tuple[int, bytes]:
        """Opcode and content of the next frame."""
        first, length = self._take(2)
        if length == 126:
            (length,) = struct.unpack(">H", self._take(2))
        elif length == 127:
            (length,) = struct.unpack(">Q", self._take(8))
        return first & 15, self._take(length)

    def send(self, opcode: int, data: bytes) -> None:
        """One masked frame."""
        mask = os.urandom(4)
        size = bytes([0x80 | len(data)]) if len(data) < 126 else b"\xfe" + struct.pack(">H", len(data))
        body = bytes(byte ^ mask[i % 4] for i, byte in enumerate(data))
        self.socket.sendall(bytes([0x80 | opcode]) + size + mask + body)

    def learn(self, *topics: str) -> None:
        """Read until these topics and the services are advertised."""
        while not (self.channels.keys() >= set(topics) and self.services):
            opcode, data = self.receive()
            if opcode == 1:
                told = json.loads(data)
                if told["op"] == "advertise":
                    self.channels |= {channel["topic"]: channel for channel in told["channels"]}
                elif told["op"] == "advertiseServices":
                    self.services |= {service["name"]: service for service in told["services"]}

    def subscribe(self, *topics: str) -> None:
        """Ask for the messages of these topics."""
        wanted = [{"id": i, "channelId": self.channels[topic]["id"]} for i, topic in enumerate(topics, 1)]
        self.numbers = dict(enumerate(topics, 1))
        self.send(1, json.dumps({"op": "subscribe", "subscriptions": wanted}).encode())

    def call(self, service: str, request: bytes) -> None:
        """Press a button."""
        number = self.services[service]["id"]
        self.send(2, struct.pack("<BIII", 2, number, 1, 4) + b"json" + request)

    def messages(self) -> Iterator[tuple[str, bytes]]:
        """Topic and content of messages; answers of services under the topic `reply`."""
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            opcode, data = self.receive()
            if opcode == 2 and data[0] == 1:
                yield self.numbers[struct.unpack_from("<I", data, 1)[0]], data[13:]
            elif opcode == 2 and data[0] == 3:
                (size,) = struct.unpack_from("<I", data, 9)
                yield "reply", data[13 + size :]
        raise AssertionError("nothing came")


@pytest.fixture
def live(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """A bench that is served, on any free port, with a log."""
    process = subprocess.Popen(
        [*LIVE, "--port", "0", "--out", str(tmp_path / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    yield process, tmp_path / "out" / "run.mcap"
    process.kill()
    process.communicate()


def read_url(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def test_a_viewer_sees_the_bench_and_breaks_it(live: tuple[subprocess.Popen[str], Path]) -> None:
    """Telemetry and scene come; a button is taken and the wheel turns red; nonsense is refused with reasons; Ctrl-C ends
    with 130, and the log has the fault, the command, and is whole."""
    process, log = live
    viewer = Viewer(read_url(process))
    topics = ("/truth/attitude", "/scene/frames", "/scene/wheels", "/scene/body", "/scene/faults", "/faults", "/events")
    viewer.learn(*topics)
    assert viewer.channels["/truth/attitude"]["schemaName"].startswith("hilsat")
    viewer.subscribe(*topics)
    seen: set[str] = set()
    for topic, data in viewer.messages():
        if topic == "/truth/attitude":
            (error_deg,) = struct.unpack_from("<d", data, 4 + 8 + 7 * 8)
            assert 50.0 < error_deg < 70.0  # the published case starts 63 deg off
        seen.add(topic)
        if seen >= {"/truth/attitude", "/scene/frames", "/scene/wheels", "/scene/body"}:
            break
    viewer.call("/fault/wheel/dead", b'{"unit": "wheel.9"}')
    reply = json.loads(next(data for topic, data in viewer.messages() if topic == "reply"))
    assert reply["state"] == "refused"
    assert "wheel.9" in str(reply["reasons"])
    viewer.call("/fault/wheel/dead", b"{}")
    phases, red, accepted = [], False, {}
    for topic, data in viewer.messages():
        if topic == "reply":
            accepted = json.loads(data)
        elif topic == "/faults":
            phases.append(json.loads(data)["phase"])
        elif topic == "/scene/wheels":
            red = json.loads(data)["entities"][0]["cylinders"][0]["color"]["r"] > 0.5
        if red and accepted and "effect" in phases:
            break
    assert accepted["state"] == "accepted"
    assert phases[0] == "onset"
    process.send_signal(signal.SIGINT)
    _, words = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert "Traceback" not in words
    run = read_run(log)
    assert run.complete
    assert [record["phase"] for record in run.faults][:3] == ["refused", "onset", "effect"]
    assert run.faults[1]["unit"] == "wheel.1"
    assert main(["replay", str(log)]) == 0  # what the flight software said on the way, bit for bit


def test_a_port_that_is_taken_is_named(capfd: pytest.CaptureFixture[str]) -> None:
    """Exit code 2, with the port and what to do."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert main(["live", "zhang2018", "--port", str(port)]) == 2
    said = capfd.readouterr().err
    assert f"port {port}" in said
    assert "--port" in said


@pytest.mark.parametrize(
    ("words", "said"),
    [(["--speed", "0"], "above 0"), (["--port", "70000"], "0 to 65535"), (["--set", "seed=x"], "seed")],
)
def test_mistakes_are_named(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 2 with what is wrong."""
    assert main(["live", "zhang2018", *words]) == 2
    assert said in capsys.readouterr().err


def test_without_the_extra_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """No traceback, but the line that installs it."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main(["live", "zhang2018"]) == 2
    assert "pip install 'hilsat[live]'" in capsys.readouterr().err
