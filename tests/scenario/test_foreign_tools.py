"""Other people's CAN tools on a running bench, unmodified: can-utils, python-can's and cantools' commands.

Each of them is run as docs/can-tools.md shows it and must do its job: on vcan0 (`make test-vcan`), and those that know
python-can's interface plugins also on the embedded bus, on any host.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import can
import pyte
import pytest

import tools
from bus.icd.messages import dbc_path
from bus.wire.address import open_transport
from bus.wire.frames import FRAME
from bus.wire.transport import Transport
from tools.vcan import packages

ROOT = Path(tools.__file__).resolve().parent.parent
BIN = Path(sys.executable).parent
OUR_IDS = {
    0x080,
    0x081,
    0x100,
    *range(0x110, 0x114),
    *range(0x190, 0x194),
    *range(0x1A0, 0x1A3),
    0x1B0,
    0x1B1,
    0x701,
    0x702,
}
PATIENCE_S = 30.0


@contextlib.contextmanager
def bench(bus: str, out: Path) -> Iterator[str]:
    """A real-time run on that bus, at 10 Hz, for as long as the tests need it. It must survive them all."""
    command = [sys.executable, "-P", "-m", "tools.cli", "run", "zhang2018", "--bus", bus, "--clock", "realtime"]
    run = subprocess.Popen(
        [*command, "--duration", "3000", "--set", "expect=[]", "--no-plot", "-q", "--out", str(out)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
    )  # fmt: skip
    try:
        with contextlib.closing(open_transport(bus, node="waiting", filters=[(0x080, 0x7FF)], patience_s=30)) as node:
            assert node.recv(PATIENCE_S), run.poll()
        yield bus
        assert run.poll() is None, run.communicate()
    finally:
        run.send_signal(signal.SIGINT)
        try:
            run.communicate(timeout=20)
        finally:
            run.kill()
    assert run.returncode == 130


@pytest.fixture(scope="module")
def vcan_bench(vcan: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with bench("socketcan:vcan0", tmp_path_factory.mktemp("bench") / "run") as address:
        yield address


@pytest.fixture(scope="module")
def hub_bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    place = tmp_path_factory.mktemp("bench")
    with bench(f"hub:{place}/bus", place / "run") as address:
        yield address


def find_can_util(name: str) -> str:
    """The program: the host's, else of Debian's package unpacked in the cache."""
    if found := packages.find_program(name):
        return found
    root = packages.find_unpacked("can-utils")
    assert root is not None, "can-utils is missing; `make test-vcan` fetches it"
    return str(root / "usr/bin" / name)


def run_tool(*command: str, cwd: Path | None = None, text: str | None = None) -> str:
    """What a tool that ends by itself prints; it must end well."""
    done = subprocess.run(
        command, cwd=cwd or ROOT, input=text, capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def interrupt_tool(*command: str, after_s: float) -> str:
    """What a tool prints that runs until Ctrl-C, which is pressed after a while."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=ROOT) as tool:
        with contextlib.suppress(subprocess.TimeoutExpired):
            pytest.fail(f"{command[0]} ended by itself: {tool.communicate(timeout=after_s)[0]}")
        tool.send_signal(signal.SIGINT)
        return tool.communicate(timeout=PATIENCE_S)[0]


def watch_screen(*command: str, wanted: Sequence[str]) -> str:
    """What a full-screen program shows on a 120x120 terminal once all of `wanted` is on it; then it is told to quit.

    Such programs send only what changed since the last picture, so the picture is kept by a terminal emulator.
    """
    pid, terminal = pty.fork()
    if pid == 0:
        fcntl.ioctl(0, termios.TIOCSWINSZ, struct.pack("HHHH", 120, 120, 0, 0))
        os.environ |= {"TERM": "linux", "LINES": "120", "COLUMNS": "120"}
        os.execv(command[0], command)
    picture = pyte.Screen(120, 120)
    stream = pyte.ByteStream(picture)
    shown, until = "", time.monotonic() + PATIENCE_S
    try:
        while not all(text in shown for text in wanted) and time.monotonic() < until:
            if select.select([terminal], [], [], 0.2)[0]:
                stream.feed(os.read(terminal, 65536))
                shown = "\n".join(picture.display)
        os.write(terminal, b"q")
        while time.monotonic() < until and os.waitpid(pid, os.WNOHANG) == (0, 0):
            if select.select([terminal], [], [], 0.05)[0]:
                with contextlib.suppress(OSError):
                    os.read(terminal, 65536)
        else:
            pid = 0
    except OSError as error:
        shown += f"\n{error}"
    finally:
        if pid:
            with contextlib.suppress(ProcessLookupError, ChildProcessError):
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
        os.close(terminal)
    return shown


def await_foreign_frame(node: Transport) -> bool:
    """True once the frame 7A5#DEADBEEF came. python-can fills one of the spare bytes, which is nobody's business."""
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until:
        if (0x7A5, 4, b"\xde\xad\xbe\xef\0\0\0\0") in FRAME.iter_unpack(node.recv(0.5)):
            return True
    return False


def read_log(path: Path) -> list[can.Message]:
    with can.LogReader(path) as reader:
        return list(reader)


def assert_bench_traffic(ids: set[int]) -> None:
    assert ids <= OUR_IDS | {0x7A5}
    assert {0x080, 0x081, 0x110, 0x190, 0x1A2} <= ids


@pytest.mark.vcan
class TestCanUtils:
    def test_candump_shows_every_message_of_the_bench(self, vcan_bench: str) -> None:
        shown = run_tool(find_can_util("candump"), "-n", "60", "vcan0")
        assert_bench_traffic({int(line.split()[1], 16) for line in shown.splitlines()})

    def test_cansend_reaches_the_bus(self, vcan_bench: str) -> None:
        with contextlib.closing(open_transport(vcan_bench, node="listener", filters=[(0x7A5, 0x7FF)])) as node:
            run_tool(find_can_util("cansend"), "vcan0", "7A5#DEADBEEF")
            assert await_foreign_frame(node)

    def test_cangen_reaches_the_bus(self, vcan_bench: str) -> None:
        with contextlib.closing(open_transport(vcan_bench, node="listener", filters=[(0x7A6, 0x7FF)])) as node:
            run_tool(find_can_util("cangen"), "vcan0", "-I", "7A6", "-L", "8", "-D", "i", "-g", "1", "-n", "50")
            count, until = 0, time.monotonic() + PATIENCE_S
            while count < 50 and time.monotonic() < until:
                count += len(node.recv(0.5)) // 16
            assert count == 50

    def test_canplayer_plays_what_candump_logged(self, vcan_bench: str, tmp_path: Path) -> None:
        """A candump log of vcan0 played on vcan1: the same frames in the same order."""
        logged = run_tool(find_can_util("candump"), "-L", "-n", "40", "vcan0")
        with contextlib.closing(open_transport("socketcan:vcan1", node="listener")) as node:
            run_tool(find_can_util("canplayer"), "-t", "vcan1=vcan0", text=logged)
            played = b""
            while len(played) < 40 * 16 and (batch := node.recv(5.0)):
                played += batch
        words = [line.split()[2] for line in logged.splitlines()]
        assert [f"{can_id:03X}#{data[:dlc].hex().upper()}" for can_id, dlc, data in FRAME.iter_unpack(played)] == words

    def test_canbusload_sees_the_load(self, vcan_bench: str) -> None:
        """About 13 frames a tenth of a second: 110 to 160 frames a second, 2 to 4 % of 500 kbit/s."""
        shown = interrupt_tool(find_can_util("canbusload"), "vcan0@500000", after_s=4.5)
        rows = re.findall(r"vcan0@500000 +(\d+) +(\d+) +(\d+) +(\d+)%", shown)
        assert rows, shown
        frames, _, _, percent = (int(value) for value in rows[-1])
        assert 100 <= frames <= 170
        assert 2 <= percent <= 5

    def test_cantools_decodes_a_candump_with_our_dbc(self, vcan_bench: str) -> None:
        logged = run_tool(find_can_util("candump"), "-L", "-n", "60", "vcan0")
        decoded = run_tool(str(BIN / "cantools"), "decode", "--single-line", dbc_path(), text=logged)
        for name in ("SYNC", "CYCLE_DONE", "RW1_CMD", "RW4_TLM", "FOGX_RATE", "STR_QA"):
            assert re.search(rf":: {name}\(", decoded), decoded
        assert "Unknown" not in decoded


def log_with_can_logger(out: Path, interface: str, channel: str) -> None:
    interrupt_tool(str(BIN / "can_logger"), "-i", interface, "-c", channel, "-f", str(out), after_s=4.0)
    assert_bench_traffic({message.arbitration_id for message in read_log(out)})


def play_with_can_player(path: Path, interface: str, channel: str, bus: str) -> None:
    path.write_text("(1.000000) vcan0 7A5#DEADBEEF\n(1.010000) vcan0 7A5#DEADBEEF\n")
    with contextlib.closing(open_transport(bus, node=f"listener-{interface}", filters=[(0x7A5, 0x7FF)])) as node:
        run_tool(str(BIN / "can_player"), "-i", interface, "-c", channel, str(path))
        assert await_foreign_frame(node)


def monitor_with_cantools(interface: str, channel: str) -> None:
    wanted = ("RW1_TLM(", "SPEED: ", " rad/s", "SYNC(", "TICK: ", "FOGZ_RATE(")
    command = [str(BIN / "cantools"), "monitor", "-i", interface, "-c", channel, dbc_path()]
    screen = watch_screen(*command, wanted=wanted)
    assert [text for text in wanted if text not in screen] == [], screen[-2000:]


@pytest.mark.vcan
@pytest.mark.parametrize(("interface", "channel"), [("socketcan", "vcan0"), ("hilsat", "socketcan:vcan0")])
class TestPythonToolsOnVcan:
    """Through python-can's own driver, and through the interface that comes with hilsat."""

    def test_can_logger(self, vcan_bench: str, tmp_path: Path, interface: str, channel: str) -> None:
        log_with_can_logger(tmp_path / "run.asc", interface, channel)

    def test_can_player(self, vcan_bench: str, tmp_path: Path, interface: str, channel: str) -> None:
        play_with_can_player(tmp_path / "play.log", interface, channel, vcan_bench)

    def test_cantools_monitor(self, vcan_bench: str, interface: str, channel: str) -> None:
        monitor_with_cantools(interface, channel)


@pytest.mark.slow
class TestPythonToolsOnTheEmbeddedBus:
    """`-i hilsat -c hub:DIR`: the same programs where no kernel has CAN."""

    def test_can_logger(self, hub_bench: str, tmp_path: Path) -> None:
        log_with_can_logger(tmp_path / "run.blf", "hilsat", hub_bench)

    def test_can_player(self, hub_bench: str, tmp_path: Path) -> None:
        play_with_can_player(tmp_path / "play.log", "hilsat", hub_bench, hub_bench)

    def test_cantools_monitor(self, hub_bench: str) -> None:
        monitor_with_cantools("hilsat", hub_bench)

    def test_can_viewer(self, hub_bench: str) -> None:
        wanted = ("0x190", "0x080", "0x1A2")
        screen = watch_screen(str(BIN / "can_viewer"), "-i", "hilsat", "-c", hub_bench, wanted=wanted)
        assert [text for text in wanted if text not in screen] == [], screen[-2000:]
