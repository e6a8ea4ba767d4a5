"""Real ground programs over UDP and the gateway, on benches of real processes: MAVProxy, MAVSDK, stock pymavlink.

MAVProxy and MAVSDK are fetched from the package index into pytest's cache, once; where that fails, the test fails.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mav

from tools.log.mcap_reader import read_run

ROOT = Path(__file__).resolve().parents[2]
HILSAT = [sys.executable, "-P", "-m", "tools.cli"]
PROGRAMS = {
    "mavsdk": ["mavsdk==3.17.4"],
    "mavproxy": ["--no-deps", "MAVProxy==1.8.75", "future==1.0.0", "pyserial==3.5", "setuptools<82"],
}
SDK_SCRIPT = """
import asyncio, sys
from mavsdk import System
from mavsdk.failure import FailureError, FailureType, FailureUnit

async def main():
    vehicle = System(mavsdk_server_address="127.0.0.1", port=int(sys.argv[1]))
    await vehicle.connect()
    async for state in vehicle.core.connection_state():
        if state.is_connected:
            break
    async for q in vehicle.telemetry.attitude_quaternion():
        print("norm", round(q.w**2 + q.x**2 + q.y**2 + q.z**2, 3), flush=True)
        break
    params = await vehicle.param.get_all_params()
    print("params", len(params.float_params), len(params.int_params), flush=True)
    await vehicle.param.set_param_float("SLEW_MAX_DEG_S", 0.5)
    print("slew", await vehicle.param.get_param_float("SLEW_MAX_DEG_S"), flush=True)

    async def inject(unit, number):
        try:
            await vehicle.failure.inject(unit, FailureType.OFF, number)
            print(unit.name, "accepted", flush=True)
        except FailureError as error:
            print(unit.name, error._result.result.name, flush=True)

    await inject(FailureUnit.SYSTEM_MOTOR, 2)
    await inject(FailureUnit.SENSOR_BARO, 1)

asyncio.run(main())
"""


def fetch(name: str, place: Path) -> Path:
    """Where a program of PROGRAMS is, fetched where it is not yet. Fails the test with pip's words."""
    place.mkdir(parents=True, exist_ok=True)
    target = place / re.sub(r"[^\w.]", "-", "-".join(PROGRAMS[name]))
    with open(place / "lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # of two test processes one fetches
        if not target.is_dir():
            shutil.rmtree(place / "part", ignore_errors=True)
            command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--target"]
            done = subprocess.run(
                [*command, str(place / "part"), *PROGRAMS[name]],
                capture_output=True,
                text=True,
                timeout=280,
                check=False,
            )
            if done.returncode:
                pytest.fail(f"{name} cannot be fetched: {done.stderr[-600:]}")
            (place / "part").rename(target)
    return target


@pytest.fixture(scope="session")
def programs(request: pytest.FixtureRequest) -> Any:
    """The directory of a program by its name."""
    place = Path(request.config.cache.mkdir("ground-programs"))
    return lambda name: fetch(name, place)


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def running(words: list[str], directory: Path, **more: Any) -> Iterator[subprocess.Popen[str]]:
    """A process that is ended with the block, with its output in a file of its own."""
    with open(directory / f"{Path(words[0]).name}-{time.monotonic_ns()}.txt", "w+") as output:
        child = subprocess.Popen(words, cwd=directory, stdout=output, stderr=subprocess.STDOUT, text=True, **more)
        child.output = Path(output.name)  # type: ignore[attr-defined]
        try:
            yield child
        finally:
            if child.poll() is None:
                child.terminate()
                with contextlib.suppress(subprocess.TimeoutExpired):
                    child.wait(20)
                child.kill()
            child.wait()


@contextlib.contextmanager
def bench(directory: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    """`hilsat run` with a temporary directory of its own."""
    command = [*HILSAT, "run", *words, "--no-plot", "-q", "--out", str(directory / "run")]
    with tempfile.TemporaryDirectory(prefix="hil-", dir="/tmp", ignore_cleanup_errors=True) as short:  # sockets' names
        environment = {**os.environ, "TMPDIR": short, "PYTHONPATH": str(ROOT)}
        with running(command, directory, env=environment) as child:
            yield child


def await_words(path: Path, words: str, wait_s: float = 60.0) -> None:
    """Wait until a file holds these words."""
    until_s = time.monotonic() + wait_s
    while words not in path.read_text():
        assert time.monotonic() < until_s, f"{words!r} did not come:\n{path.read_text()[-2000:]}"
        time.sleep(0.1)


@pytest.mark.slow
def test_mavsdk_connects_sets_and_breaks(tmp_path: Path, programs: Any) -> None:
    """MAVSDK-Python 3.17.4: attitude, all parameters as floats, one set, a motor off, and UNSUPPORTED for a barometer."""
    place = programs("mavsdk")
    port, grpc_port = free_port(), free_port(socket.SOCK_STREAM)
    (tmp_path / "script.py").write_text(SDK_SCRIPT)
    server = [str(place / "mavsdk" / "bin" / "mavsdk_server"), "-p", str(grpc_port), f"udpin://127.0.0.1:{port}"]
    with running(server, tmp_path) as served, bench(tmp_path, "realtime-60s", "--mavlink", f"udp:{port}", "--inject"):
        await_words(served.output, "Server set to listen")  # type: ignore[attr-defined]
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "script.py", str(grpc_port)], cwd=tmp_path, capture_output=True, text=True,
            timeout=60, check=False, env={**os.environ, "PYTHONPATH": str(place)},
        )  # fmt: skip
    assert done.returncode == 0, done.stderr
    said = done.stdout.split("\n")
    assert "norm 1.0" in said
    assert re.search(r"^params (2\d|3\d) 0$", done.stdout, re.MULTILINE), done.stdout
    assert "slew 0.5" in said
    assert "SYSTEM_MOTOR accepted" in said
    assert "SENSOR_BARO UNSUPPORTED" in said


@pytest.mark.slow
def test_mavproxy_connects_sets_and_breaks(tmp_path: Path, programs: Any) -> None:
    """MAVProxy 1.8.75 at its prompt: parameters within seconds, one set, a wheel dead, safe mode, and no false alarm."""
    place = programs("mavproxy")
    port = free_port()
    proxy = [
        sys.executable, "-W", "ignore", "-u", str(place / "bin" / "mavproxy.py"), f"--master=udp:127.0.0.1:{port}",
    ]  # fmt: skip
    environment = {**os.environ, "PYTHONPATH": str(place), "HOME": str(tmp_path), "PYTHONUNBUFFERED": "1"}
    with (
        running(proxy, tmp_path, stdin=subprocess.PIPE, env=environment) as child,
        bench(tmp_path, "realtime-60s", "--mavlink", f"udp:{port}", "--inject"),
    ):
        output = child.output  # type: ignore[attr-defined]

        def type_in(line: str, answer: str) -> None:
            assert child.stdin is not None
            child.stdin.write(line + "\n")
            child.stdin.flush()
            await_words(output, answer, 30.0)

        await_words(output, "Received ")
        type_in("param set SLEW_MAX_DEG_S 0.5", "command param.set (ground) obeyed")
        type_in("long MAV_CMD_INJECT_FAILURE 101 1 2", "INJECT_FAILURE: ACCEPTED")
        type_in("long MAV_CMD_INJECT_FAILURE 3 1 1", "INJECT_FAILURE: UNSUPPORTED")
        type_in("long DO_SET_MODE 1 3", "mode safe: commanded")
        words = output.read_text()
    assert re.search(r"Received (2\d|3\d) parameters", words)
    assert "DO_SET_MODE: ACCEPTED" in words
    assert "fence breach" not in words
    events = b"".join(record.data for _, record in read_run(tmp_path / "run" / "run.mcap").iterate_topics("/events"))
    assert b"wheel.2 dead" in events


class UdpStation:
    """Stock pymavlink over UDP, at the port that a bench speaks to."""

    def __init__(self) -> None:
        self.protocol = mav.MAVLink(None, 255, 190)
        self.reader = mav.MAVLink(None, 0, 0)
        self.reader.robust_parsing = True
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.5)
        self.port = self.socket.getsockname()[1]
        self.heard: list[Any] = []

    def listen(self, kind: str, wait_s: float = 60.0) -> Any:
        """The next message of a kind from the vehicle; the station's heartbeat goes out meanwhile."""
        until_s = time.monotonic() + wait_s
        while time.monotonic() < until_s:
            with contextlib.suppress(TimeoutError):
                data, self.bench = self.socket.recvfrom(65536)
                found = self.reader.parse_buffer(data) or []
                self.heard += found
                for message in found:
                    if message.get_type() == kind and message.get_srcComponent() == 1:
                        return message
        raise AssertionError(f"no {kind} came; there were {sorted({m.get_type() for m in self.heard})}")

    def send(self, message: Any) -> None:
        packet = message.pack(self.protocol)
        self.protocol.seq = (self.protocol.seq + 1) % 256
        self.socket.sendto(packet, self.bench)


@pytest.mark.slow
@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_two_processes_obey_a_station_and_the_log_replays(tmp_path: Path, clock: str) -> None:
    """Mode and target over UDP while the bench runs; `hilsat replay` finds no difference in what came of it."""
    station = UdpStation()
    settings = ["--set", "duration_s=1500", "--set", "expect=[]"] if clock == "lockstep" else []
    scenario = "nominal" if clock == "lockstep" else "realtime-60s"
    with bench(tmp_path, scenario, "--clock", clock, *settings, "--mavlink", f"udp:{station.port}") as child:
        station.listen("HEARTBEAT")
        turned = [0.9238795, 0.0, 0.3826834, 0.0]
        station.send(mav.MAVLink_set_attitude_target_message(0, 1, 1, 7, turned, 0, 0, 0, 0))
        station.send(mav.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
        assert station.listen("COMMAND_ACK").result == mav.MAV_RESULT_ACCEPTED
        station.send(mav.MAVLink_param_set_message(1, 1, b"STALE_TICKS", 8.0, 9))
        assert station.listen("PARAM_VALUE").param_value == 8.0
        assert child.wait(120) in (0, 1)  # a requirement of the scenario may fail: it was told to point elsewhere
    station.socket.close()
    log = tmp_path / "run" / "run.mcap"
    words = [b"target.slew", b"param.set"]
    inputs = b"".join(record.data for _, record in read_run(log).iterate_topics("/fsw/input"))
    assert all(word in inputs for word in words)
    done = subprocess.run(
        [*HILSAT, "replay", str(log)], capture_output=True, text=True, timeout=280, check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
