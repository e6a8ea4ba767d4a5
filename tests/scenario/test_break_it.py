"""Benches that run, broken from outside: the commands of docs/break-it.md as written, and what happens at the edges."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from bus.mavlink.dialect import MAVLink, MAVLink_command_long_message
from bus.mavlink.packets import Packets
from tools.log.mcap_reader import read_run

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "break-it.md").read_text()
HILSAT = [sys.executable, "-P", "-m", "tools.cli"]
REFUSED = "hilsat inject wheel.1 los"  # the one command that is there to be refused


def commands() -> list[str]:
    """The commands of the page that can be typed as they are, without remarks."""
    lines = re.findall(r"^    (hilsat .*)$", PAGE, re.MULTILINE)
    return [line.split("   #")[0].split("  #")[0].strip() for line in lines if "UNIT KIND" not in line]


@pytest.fixture
def environment(short_tmpdir: str) -> dict[str, str]:
    """A temporary directory of its own: other benches of this machine are not found."""
    return {**os.environ, "TMPDIR": short_tmpdir, "PYTHONPATH": str(ROOT)}


def start(command: str, cwd: Path, environment: dict[str, str], *, plot: bool = False) -> subprocess.Popen[str]:
    """Start a bench in a directory; return when it can be found."""
    words = [*HILSAT, *shlex.split(command)[1:], *([] if plot else ["--no-plot"])]
    child = subprocess.Popen(words, cwd=cwd, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    until_s = time.monotonic() + 30.0
    while not list((cwd / "t").glob("hilsat-*/run.json")):
        assert child.poll() is None, child.stderr.read() if child.stderr else ""
        assert time.monotonic() < until_s
        time.sleep(0.05)
    return child


def end(child: subprocess.Popen[str]) -> str:
    child.send_signal(signal.SIGINT)
    return child.communicate(timeout=60)[1]


def hilsat(command: str, cwd: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    words = [*HILSAT, *shlex.split(command)[1:]]
    return subprocess.run(words, cwd=cwd, env=environment, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.slow
def test_the_page_runs_as_written(tmp_path: Path, environment: dict[str, str]) -> None:
    """In order: a bench in real time, broken and healed, its faults exported and checked."""
    first, *rest = commands()
    assert len(rest) >= 10
    bench = start(first, tmp_path, environment)
    try:
        for command in rest:
            if " export " in command:
                end(bench)
            logs = list(tmp_path.glob("runs/*/run.mcap"))
            done = hilsat(command.replace("runs/.../run.mcap", str(logs[0]) if logs else ""), tmp_path, environment)
            if command.startswith(REFUSED):
                assert done.returncode == 2
                assert "did you mean" in done.stderr
                assert "loss" in done.stderr
            else:
                assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    finally:
        if bench.poll() is None:
            end(bench)
    log = read_run(logs[0])
    bit = {fault["id"] for fault in log.faults if fault["phase"] == "effect"}
    assert {"command[0]", "liar"} <= bit
    assert "liar" in (tmp_path / "broken.yaml").read_text()


@pytest.fixture
def closed_bench(tmp_path: Path, environment: dict[str, str]) -> Iterator[None]:
    bench = start("hilsat run nominal --clock realtime", tmp_path, environment)
    yield
    end(bench)


@pytest.mark.slow
@pytest.mark.usefixtures("closed_bench")
def test_a_bench_that_allows_nothing_has_no_socket(tmp_path: Path, environment: dict[str, str]) -> None:
    """It is found, and says how it would be allowed; there is nothing in its directory to speak to."""
    done = hilsat("hilsat inject status --json", tmp_path, environment)
    assert done.returncode == 2
    assert "bench nominal runs, but its scenario does not allow injection" in done.stderr
    assert json.loads(done.stdout)["state"] == "refused"
    assert not list((tmp_path / "t").glob("hilsat-*/*.sock"))


@pytest.mark.slow
def test_who_waits_is_told_when_the_bench_ends(tmp_path: Path, environment: dict[str, str]) -> None:
    """By its last words when it is ended, by its silence when it is killed: exit code 3 either way."""
    for number in (signal.SIGINT, signal.SIGKILL):
        bench = start("hilsat run nominal --clock realtime --inject", tmp_path, environment)
        wait = subprocess.Popen(
            [*HILSAT, "inject", "wheel.2", "loss", "effectiveness=0.5", "--at", "200", "--wait"],
            cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert wait.stdout is not None
        assert "acts from tick" in wait.stdout.readline()
        bench.send_signal(number)
        bench.communicate(timeout=60)
        _, said = wait.communicate(timeout=60)
        assert wait.returncode == 3, said
        assert "ended" in said
        for left in (tmp_path / "t").glob("hilsat-*/run.json"):
            left.unlink()
        done = hilsat("hilsat inject list", tmp_path, environment)
        assert (done.returncode, done.stdout) == (3, "")
        assert "no bench runs here" in done.stderr


@pytest.mark.slow
def test_ground_links_and_a_gateway_that_dies(tmp_path: Path, environment: dict[str, str]) -> None:
    """A run with a link: its gateway is killed, the run goes on, ends well and says so."""
    command = (
        "hilsat run nominal --clock realtime --mavlink udpin:0 --set duration_s=5 --set expect=[] --set faults=[] -q"
    ).replace(":0", f":{free_port()}")
    bench = start(command, tmp_path, environment)
    killed = False
    until_s = time.monotonic() + 20.0
    while not killed and time.monotonic() < until_s:
        for child in Path(f"/proc/{bench.pid}/task/{bench.pid}/children").read_text().split():
            if b"tools.ground.gateway" in Path(f"/proc/{child}/cmdline").read_bytes():
                os.kill(int(child), signal.SIGKILL)
                killed = True
        time.sleep(0.05)
    out, said = bench.communicate(timeout=60)
    assert killed
    assert "gateway was killed by SIGKILL before the run was over; the run went on without it" in said
    assert "simulated                          5 s" in out


@pytest.mark.slow
def test_two_sides_in_two_terminals_take_faults(tmp_path: Path, environment: dict[str, str]) -> None:
    """`hilsat plant --inject` has the socket; each side with a link has a gateway of its own, for itself."""
    ports = free_port(), free_port()
    both = f"nominal --clock realtime --bus hub:{tmp_path / 't' / 'bus'}"
    plant = start(f"hilsat plant {both} --inject --mavlink udpin:{ports[0]}", tmp_path, environment, plot=True)
    fsw = subprocess.Popen([*HILSAT, "fsw", *both.split()], cwd=tmp_path, env=environment, stderr=subprocess.PIPE)
    try:
        done = hilsat("hilsat inject wheel.2 loss effectiveness=0.3 --wait --timeout 30 --json", tmp_path, environment)
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["state"] == "bit"
        answer = ask_version(ports[0], 25)
        assert answer == [25]
        assert ask_version(ports[0], 1) == []
    finally:
        plant.send_signal(signal.SIGTERM)
        plant.communicate(timeout=60)
        fsw.communicate(timeout=60)
    assert not list((tmp_path / "t").glob("hilsat-*"))


def ask_version(port: int, component: int) -> list[int]:
    """Which components answer a request for AUTOPILOT_VERSION."""
    protocol = MAVLink(None, 255, 190)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.settimeout(0.5)
        message = MAVLink_command_long_message(1, component, 512, 0, 148.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        ground.sendto(bytes(message.pack(protocol)), ("127.0.0.1", port))
        heard = []
        until_s = time.monotonic() + 2.0
        while time.monotonic() < until_s:
            try:
                heard += Packets(0, 0).read(ground.recv(4096))
            except TimeoutError:
                continue
    return sorted({found.get_srcComponent() for found in heard if found.get_type() == "AUTOPILOT_VERSION"})


@pytest.mark.slow
def test_a_ground_station_breaks_a_wheel(tmp_path: Path, environment: dict[str, str]) -> None:
    """INJECT_FAILURE to the vehicle, from pymavlink: accepted as by the vehicle, and wheel 2 is broken in the log."""
    port = free_port()
    command = f"hilsat run nominal --clock realtime --inject --mavlink udpin:{port} -q"
    bench = start(command, tmp_path, environment)
    program = (
        "import os; os.environ['MAVLINK20'] = '1'\n"
        "from pymavlink import mavutil\n"
        f"link = mavutil.mavlink_connection('udpout:127.0.0.1:{port}', dialect='common')\n"
        "sources = set()\n"
        "for _ in range(100):\n"
        "    link.mav.heartbeat_send(6, 8, 0, 0, 4)\n"
        "    message = link.recv_match(type='HEARTBEAT', blocking=True, timeout=0.3)\n"
        "    if message is not None and message.get_srcComponent() == 25:\n"
        "        break\n"
        "link.mav.command_long_send(1, 1, 420, 0, 101, 1, 2, float('nan'), 0, 0, 0)\n"
        "message = link.recv_match(type='COMMAND_ACK', blocking=True, timeout=10)\n"
        "print(message.command, message.result, message.get_srcSystem(), message.get_srcComponent())\n"
    )
    try:
        done = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False, env=environment
        )
        assert done.stdout.split() == ["420", "0", "1", "1"], done.stderr
        time.sleep(1.0)
    finally:
        end(bench)
    log = read_run(next(tmp_path.glob("runs/*/run.mcap")))
    assert [fault["unit"] for fault in log.faults if fault["phase"] == "onset"] == ["wheel.2"]


@pytest.mark.slow
def test_a_link_and_a_flood_change_no_byte(tmp_path: Path, environment: dict[str, str]) -> None:
    """In lock-step, with sockets, a gateway and thousands of messages a second from the ground: the same digest."""
    quiet = hilsat("hilsat run zhang2018 -q --no-plot --json --out a", tmp_path, environment)
    port = free_port()
    flooded = subprocess.Popen(
        [*HILSAT, *f"run zhang2018 -q --no-plot --json --out b --inject --mavlink udpin:{port}".split()],
        cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    protocol = MAVLink(None, 255, 190)
    sent = 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        while flooded.poll() is None:
            for number in (512, 31000, 420):
                message = MAVLink_command_long_message(1, 25, number, 0, 9999.0, 9.0, 0.0, 0.0, 0.0, 0.0, 0.0)
                ground.sendto(bytes(message.pack(protocol)), ("127.0.0.1", port))
                sent += 1
            time.sleep(0.0005)
    out, said = flooded.communicate(timeout=60)
    assert sent > 1000
    assert f"gateway, udpin:{port}: refused" in said
    reports = [json.loads(quiet.stdout), json.loads(out)]
    assert [report["exit_code"] for report in reports] == [0, 0]
    assert reports[0]["figures"]["digest of the run"] == reports[1]["figures"]["digest of the run"]


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
