"""Whole runs on raw AF_CAN sockets: the same bytes as on the embedded bus, and everything that can go wrong on a real bus.

The tests marked vcan run where vcan0 and vcan1 are (`make test-vcan`); without them they are skipped, but fail when
HILSAT_REQUIRE_VCAN=1. Those marked vcan_host start the guest with virtual time themselves.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tools
from bus.errors import BusAddressError
from bus.icd.codec import encode_HEARTBEAT_PLANT
from bus.wire.address import open_transport
from bus.wire.frames import EFF_FLAG, ERR_FLAG, FRAME, RTR_FLAG
from tools.config.loader import load_scenario
from tools.config.scenario_files import find_scenario
from tools.log.mcap_reader import Run, read_run
from tools.run.in_process import run_in_process
from tools.vcan import kernel, packages

ROOT = Path(tools.__file__).resolve().parent.parent
HILSAT = [sys.executable, "-P", "-m", "tools.cli"]
QUICK = ["--set", "expect=[]", "--set", "faults=[]", "--no-plot", "--json", "-q"]
SIOCGIFFLAGS, SIOCSIFFLAGS, SIOCSIFMTU, IFF_UP = 0x8913, 0x8914, 0x8922, 1
CAN_MTU, CANFD_MTU = 16, 72
OUR_IDS = (0x080, 0x081, 0x110, 0x113, 0x190, 0x1A0, 0x1B0, 0x1B1, 0x701, 0x702)
LONG = ["zhang2018-flight", "--duration", "3000", *QUICK, "--bus"]
RUN_LIMIT_S = 120


on_vcan = [pytest.mark.vcan, pytest.mark.usefixtures("vcan")]


@dataclass
class Flown:
    """A `hilsat run` that has ended."""

    code: int
    result: dict[str, Any]
    stderr: str
    log: Path

    @property
    def run(self) -> Run:
        return read_run(self.log)

    @property
    def buses(self) -> dict[str, dict[str, int]]:
        """Counters of each side's attachment."""
        details: dict[str, dict[str, int]] = self.result["run"]["details"]
        return {side: details[f"{side}_bus"] for side in ("plant", "fsw")}


@dataclass
class Flight:
    """A `hilsat run` in progress."""

    out: Path
    words: list[str]
    popen: subprocess.Popen[str] = field(init=False)

    def __post_init__(self) -> None:
        command = [*HILSAT, "run", *self.words, "--out", str(self.out)]
        self.popen = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT)

    def wait_until_it_runs(self, interface: str, ticks: int = 1) -> None:
        """Return once it has gone through some ticks past its tenth, as its SYNC frames tell."""
        with stranger(interface) as sock:
            sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, struct.pack("=II", 0x080, 0x7FF))
            sock.settimeout(30.0)
            try:
                while ticks:
                    ticks -= int.from_bytes(sock.recv(16)[10:14], "little") >= 10
            except TimeoutError:
                pytest.fail(f"the run does not begin: {self.popen.poll()}")

    def stop(self) -> Flown:
        """Interrupt it when it has done what it was for; its log is whole."""
        assert self.popen.poll() is None, self.popen.communicate()
        self.popen.send_signal(signal.SIGINT)
        done = self.finish()
        assert done.code == 130, done.stderr
        return done

    def child(self, module: str) -> int:
        """Process id of one of its sides."""
        for path in Path("/proc").glob("[0-9]*/stat"):
            with contextlib.suppress(OSError):
                parent = int(path.read_text().rsplit(")", 1)[1].split()[1])
                words = path.with_name("cmdline").read_bytes().split(b"\0")
                if parent == self.popen.pid and module.encode() in words:
                    return int(path.parent.name)
        raise AssertionError(f"{module} is not running")

    def finish(self) -> Flown:
        out, err = self.popen.communicate(timeout=RUN_LIMIT_S)
        assert out, err
        return Flown(self.popen.returncode, json.loads(out), err, self.out / "run.mcap")


def fly(out: Path, scenario: str, bus: str, *words: str) -> Flown:
    return Flight(out, [scenario, "--bus", bus, *words]).finish()


@contextlib.contextmanager
def flying(out: Path, *words: str) -> Iterator[Flight]:
    flight = Flight(out, list(words))
    try:
        yield flight
    finally:
        flight.popen.kill()
        flight.popen.communicate()


@contextlib.contextmanager
def stranger(interface: str) -> Iterator[socket.socket]:
    """A raw socket of somebody else on the bus."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as sock:
        sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        sock.bind((interface,))
        yield sock


def say(sock: socket.socket, frame: bytes) -> None:
    """Put one frame on the bus, waiting for room."""
    with contextlib.suppress(OSError):
        sock.send(frame)


def set_up(interface: str, up: bool, mtu: int | None = None) -> None:
    """Take an interface down or up, as root of the guest or namespace; the MTU can be set while it is down."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        flags = struct.unpack_from("H", fcntl.ioctl(sock, SIOCGIFFLAGS, struct.pack("16s24x", interface.encode())), 16)[
            0
        ]
        if mtu is not None:
            fcntl.ioctl(sock, SIOCSIFMTU, struct.pack("16si20x", interface.encode(), mtu))
        wanted = flags | IFF_UP if up else flags & ~IFF_UP
        fcntl.ioctl(sock, SIOCSIFFLAGS, struct.pack("16sH22x", interface.encode(), wanted))


def fly_in_process(out: Path, duration_s: float) -> Run:
    """The same scenario without a bus: what an undisturbed run comes to."""
    keys = [f"duration_s={duration_s}", "expect=[]", "faults=[]"]
    return read_run(run_in_process(load_scenario(find_scenario("zhang2018-flight"), keys), out, lambda tick: None).log)


@pytest.fixture(scope="module")
def quiet(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return fly_in_process(tmp_path_factory.mktemp("quiet"), 60.0)


def assert_same_truth(run: Run, quiet: Run) -> None:
    """What really happened is what happens undisturbed, bit for bit, as far as both went; at least 200 ticks."""
    for topic in sorted(topic for topic in quiet.topics if topic.startswith("/truth/")):
        ours, theirs = run.payloads(topic), quiet.payloads(topic)
        common = min(len(ours), len(theirs))
        assert common >= 200
        assert ours[:common] == theirs[:common], topic


class TestSameBytes:
    pytestmark = on_vcan

    def test_the_published_scenario_passes_and_is_the_embedded_bus_bit_for_bit(self, tmp_path: Path) -> None:
        """All requirements of the paper met over AF_CAN; every frame and every deterministic record equal to the hub's."""
        one = fly(tmp_path / "vcan", "zhang2018", "socketcan:vcan0", "--no-plot", "--json", "-q")
        two = fly(tmp_path / "hub", "zhang2018", "hub:", "--no-plot", "--json", "-q")
        assert (one.code, one.result["grade"]["passed"]) == (0, True), one.stderr
        assert one.run.frames().tobytes() == two.run.frames().tobytes()
        assert one.run.digest() == two.run.digest()
        diff = [*HILSAT, "diff", str(one.log), str(two.log)]
        assert subprocess.run(diff, capture_output=True, cwd=ROOT, check=False).returncode == 0
        assert {bus["dropped"] for bus in one.buses.values()} == {0}

    def test_a_noisy_scenario_with_late_commands(self, tmp_path: Path) -> None:
        """Noise, a delayed star tracker and a Kalman filter: the same bytes as in one process without a bus."""
        one = fly(tmp_path / "a", "zhang2018-flight", "socketcan:vcan1", "--duration", "20", *QUICK).run
        two = fly_in_process(tmp_path / "b", 20.0)
        assert one.frames().tobytes() == two.frames().tobytes()
        assert one.digest() == two.digest()

    def test_a_controller_that_goes_off(self, tmp_path: Path) -> None:
        """Error frames go through the kernel as they go over the hub: the same bytes, and they are counted."""
        fault = "faults=[{unit: bus, kind: bus_off, node: fsw, at_s: 2, until_s: 4}]"
        words = ["--set", "duration_s=6", "--set", "expect=[]", "--set", fault, "--no-plot", "--json", "-q"]
        one = fly(tmp_path / "vcan", "zhang2018-flight", "socketcan:vcan0", *words).run
        two = fly(tmp_path / "hub", "zhang2018-flight", "hub:", *words).run
        assert one.frames().tobytes() == two.frames().tobytes()
        assert one.digest() == two.digest()
        assert one.signals("/fsw/link_health")["error_frames"][-1] == 6

    def test_kernel_stamps_are_logged_apart(self, tmp_path: Path) -> None:
        """One stamp for every frame that the plant received, in order, within the time of the run; not in the digest."""
        before_ns = time.time_ns()
        run = fly(tmp_path / "a", "zhang2018", "socketcan:vcan0", "--duration", "10", *QUICK).run
        stamps = run.signals("/can/bus0_kernel_stamps")
        assert not run.topics["/can/bus0_kernel_stamps"].deterministic
        frames = run.frames()
        from_fsw = frames["id"][np.isin(frames["id"], [0x081, 0x110, 0x111, 0x112, 0x113, 0x702])]
        assert stamps["can_id"].tolist() == from_fsw.tolist()
        assert len(from_fsw) == 100 * 5 + 10
        received_ns = stamps["received_ns"].astype(np.int64)
        assert before_ns <= received_ns[0]
        assert (np.diff(received_ns) >= 0).all()
        assert received_ns[-1] <= time.time_ns()


class TestTrouble:
    pytestmark = on_vcan

    def test_a_second_bench_on_the_bus_is_refused_by_name_and_the_first_goes_on(
        self, tmp_path: Path, quiet: Run
    ) -> None:
        """The first run is that of an undisturbed bench."""
        with flying(tmp_path / "first", *LONG, "socketcan:vcan0") as first:
            first.wait_until_it_runs("vcan0")
            second = fly(tmp_path / "second", "zhang2018-flight", "socketcan:vcan0", "--duration", "3", *QUICK)
            done = first.stop()
        assert second.code == 3
        assert "another bench runs on" in second.stderr
        assert_same_truth(done.run, quiet)

    def test_two_benches_on_two_interfaces_do_not_meet(self, tmp_path: Path, quiet: Run) -> None:
        with flying(tmp_path / "first", *LONG, "socketcan:vcan0", "--clock", "realtime") as first:
            first.wait_until_it_runs("vcan0")
            other = fly(tmp_path / "other", "zhang2018-flight", "socketcan:vcan1", "--duration", "3", *QUICK)
            done = first.stop()
        assert other.result["run"]["exit_code"] == 0, other.stderr
        assert_same_truth(other.run, quiet)
        assert done.run.signals("/fsw/executive")["foreign"][-1] == 0

    def test_sides_of_different_scenarios_refuse_each_other(self) -> None:
        """Plant and flight software started apart with another seed: exit code 2, and why."""
        sides = [
            subprocess.Popen(
                [*HILSAT, side, "zhang2018", "--bus", "socketcan:vcan1", "--seed", seed],
                stderr=subprocess.PIPE, text=True, cwd=ROOT,
            )
            for side, seed in (("plant", "1"), ("fsw", "2"))
        ]  # fmt: skip
        try:
            until = time.monotonic() + 30
            while all(side.poll() is None for side in sides) and time.monotonic() < until:
                time.sleep(0.05)
            refusing = [side for side in sides if side.poll() is not None]
            assert {side.returncode for side in refusing} == {2}
            assert refusing[0].stderr is not None
            assert "runs another scenario" in refusing[0].stderr.read()
        finally:
            for side in sides:
                side.kill()
                side.wait()

    def test_the_heartbeat_of_another_bench_does_not_end_the_run(self, tmp_path: Path, quiet: Run) -> None:
        """Well-formed heartbeats 'stopped' of a plant with another run hash: ignored and counted."""
        with stranger("vcan0") as sock, flying(tmp_path / "a", *LONG, "socketcan:vcan0") as flight:
            flight.wait_until_it_runs("vcan0")
            for count in range(300):
                say(sock, encode_HEARTBEAT_PLANT(count % 15, 0, 4, 0xBADBAD))
                time.sleep(0.001)
            time.sleep(0.5)
            done = flight.stop()
        assert done.run.signals("/fsw/executive")["foreign"][-1] >= 100
        assert_same_truth(done.run, quiet)

    def test_foreign_frames_of_every_kind_change_nothing(self, tmp_path: Path, quiet: Run) -> None:
        """Remote, extended, error and CAN FD frames, wrong lengths and checksums on our ids: counted, truth untouched."""
        set_up("vcan1", up=False)
        set_up("vcan1", up=True, mtu=CANFD_MTU)
        try:
            with stranger("vcan1") as sock, flying(tmp_path / "a", *LONG, "socketcan:vcan1") as flight:
                flight.wait_until_it_runs("vcan1")
                for can_id in OUR_IDS * 10:
                    say(sock, FRAME.pack(can_id | RTR_FLAG, 8, b""))
                    say(sock, FRAME.pack(can_id | EFF_FLAG, 8, b"\x11" * 8))
                    say(sock, FRAME.pack(can_id | ERR_FLAG, 8, b"\x22" * 8))
                    say(sock, FRAME.pack(can_id, 3, b"\x33" * 3))
                    say(sock, FRAME.pack(can_id, 0, b""))
                    say(sock, FRAME.pack(can_id, 8, b"\x0f" * 8))  # alive counter 15: never valid
                    say(sock, struct.pack("=IBBBB64s", can_id, 64, 0, 0, 0, b"\x44" * 64))
                    time.sleep(0.002)
                time.sleep(0.5)
                done = flight.stop()
        finally:
            set_up("vcan1", up=False)
            set_up("vcan1", up=True, mtu=CAN_MTU)
        for side in ("plant", "fsw"):
            assert done.buses[side]["error_frames"] == 100
            assert done.buses[side]["fd_frames"] == 100
        counts = done.run.signals("/fsw/executive")
        assert counts["foreign"][-1] > 100
        assert counts["refused"][-1] > 100
        assert_same_truth(done.run, quiet)

    @pytest.mark.parametrize("clock", ["lockstep", "realtime"])
    def test_a_flood_from_cangen_on_our_ids_is_survived_and_counted(self, tmp_path: Path, clock: str) -> None:
        """Random frames as fast as cangen sends them, on the ids of a wheel, a gyro axis and a command, for a second."""
        with flying(tmp_path / "a", *LONG, "socketcan:vcan0", "--clock", clock) as flight:
            flight.wait_until_it_runs("vcan0")
            floods = [
                subprocess.Popen([find_can_util("cangen"), "vcan0", "-g", "0.3", "-I", can_id, "-L", "8", "-i"])
                for can_id in ("190", "1A0", "113")
            ]
            time.sleep(1.0)
            for flood in floods:
                flood.kill()
                flood.wait()
            flight.wait_until_it_runs("vcan0")  # it still goes on
            done = flight.stop()
        run = done.run
        assert run.signals("/fsw/executive")["refused"][-1] > 100
        frames = run.frames()
        flooded = np.count_nonzero(frames["id"] == 0x113) - np.count_nonzero(frames["id"] == 0x112)
        assert flooded > 100

    def test_frames_lost_in_the_receive_buffer_are_counted_and_reported(self, tmp_path: Path) -> None:
        """A stopped flight software and 12 000 frames: SO_RXQ_OVFL tells, the summary and the log say it."""
        with stranger("vcan0") as sock, flying(tmp_path / "a", *LONG, "socketcan:vcan0") as flight:
            flight.wait_until_it_runs("vcan0")
            victim = flight.child("fsw")
            os.kill(victim, signal.SIGSTOP)
            for _ in range(60):
                for _ in range(200):
                    say(sock, FRAME.pack(0x7AA, 8, b"\x55" * 8))
                time.sleep(0.005)  # the kernel's own backlog takes 1000 frames, and what it drops no socket counts
            os.kill(victim, signal.SIGCONT)
            flight.wait_until_it_runs("vcan0", ticks=50)  # the first frame that found room again brings the count along
            done = flight.stop()
        lost = done.buses["fsw"]["dropped"]
        assert 1000 < lost < 12_000
        assert f"flight software {lost}" in done.result["figures"]["frames lost in receive buffers"]
        assert any(f"{lost} frames were lost" in event["message"] for event in done.run.events)

    def test_an_interface_that_goes_down_ends_the_run_by_name(self, tmp_path: Path) -> None:
        with flying(tmp_path / "a", *LONG, "socketcan:vcan1") as flight:
            flight.wait_until_it_runs("vcan1")
            time.sleep(0.5)
            set_up("vcan1", up=False)
            try:
                started_s = time.monotonic()
                done = flight.finish()
                took_s = time.monotonic() - started_s
            finally:
                set_up("vcan1", up=True)
        assert done.code == 3
        assert "socketcan:vcan1: the interface went down" in done.stderr
        assert took_s < 20.0
        assert done.run.t_ns("/truth/attitude").size > 10

    def test_a_killed_peer_is_named_though_a_bus_tells_nothing(self, tmp_path: Path) -> None:
        """No notice of departure on CAN: the runner names the process that was killed."""
        with flying(tmp_path / "a", *LONG, "socketcan:vcan0") as flight:
            flight.wait_until_it_runs("vcan0")
            os.kill(flight.child("fsw"), signal.SIGKILL)
            done = flight.finish()
        assert done.code == 3
        assert "flight software was killed by SIGKILL" in done.stderr

    @pytest.mark.parametrize(
        ("address", "words"),
        [
            ("socketcan:lo", "not a CAN interface"),
            ("socketcan:vcan7", "vcan7 is not there; did you mean vcan[01]"),
            ("vcan0", "did you mean socketcan:vcan0"),
            ("python-can:nonsense:0", "cannot be opened by python-can"),
        ],
    )
    def test_a_bus_that_is_none_is_named(self, address: str, words: str) -> None:
        with pytest.raises(BusAddressError, match=words):
            open_transport(address, node="plant")


class TestPythonCan:
    """python-can's own interface, opened by name, as any adapter of its list would be."""

    pytestmark = on_vcan

    def test_lock_step_over_the_driver_of_another_library(self, tmp_path: Path, quiet: Run) -> None:
        """Two processes whose transport is python-can's SocketCAN driver: the undisturbed run, bit for bit."""
        bus = "python-can:socketcan:vcan0"
        done = fly(tmp_path / "a", "zhang2018-flight", bus, "--duration", "4", *QUICK)
        assert done.result["run"]["exit_code"] == 0, done.stderr
        assert_same_truth(done.run, quiet)
        frames = fly_in_process(tmp_path / "b", 4.0).frames()
        assert done.run.frames().tobytes() == frames.tobytes()


def find_can_util(name: str) -> str:
    """The program: the host's, else of Debian's package unpacked in the cache."""
    if found := packages.find_program(name):
        return found
    root = packages.find_unpacked("can-utils")
    assert root is not None, "can-utils is missing; `make test-vcan` fetches it"
    return str(root / "usr/bin" / name)


@pytest.mark.vcan_host
class TestVirtualTime:
    """HILSAT_REPEATS: how many runs are compared (2)."""

    def test_a_real_time_run_of_300_s_repeats_bit_for_bit_and_faster_than_real_time(self, tmp_path: Path) -> None:
        """100 Hz, two processes on AF_CAN, the real-time executive: the same log, down to the kernel's time stamps."""
        if kernel.find_kernel() is None:
            pytest.fail(f"no time-travel kernel; run `hilsat vcan kernel build` once ({kernel.COST})")
        repeats = int(os.environ.get("HILSAT_REPEATS", "2"))
        with ThreadPoolExecutor(2) as pool:
            flown = list(pool.map(lambda number: self.fly(tmp_path, number), range(repeats)))
        first = flown[0]
        assert first.result["grade"]["passed"], first.result["grade"]
        assert first.run.t_ns("/truth/attitude").size == 30_000
        assert first.run.signals("/fsw/executive")["slips"][-1] == 0
        stamps_ns = first.run.signals("/can/bus0_kernel_stamps")["received_ns"].astype(np.int64)
        assert abs((stamps_ns[-1] - stamps_ns[0]) * 1e-9 - 300.0) < 0.1
        for other in flown[1:]:
            assert other.run.digest() == first.run.digest()
            assert set(other.run.topics) == set(first.run.topics)
            for topic in first.run.topics:
                assert first.run.payloads(topic) == other.run.payloads(topic), topic

    def fly(self, out: Path, number: int) -> Flown:
        words = [
            "run",
            "zhang2018-flight",
            "--clock",
            "realtime",
            "--bus",
            "socketcan:vcan0",
            "--no-plot",
            "--json",
            "-q",
        ]
        inner = [*HILSAT, *words, "--out", str(out / str(number))]
        done = subprocess.run(
            [*HILSAT, "vcan", "exec", "--virtual-time", "--rw", str(out), "--", *inner],
            capture_output=True, text=True, cwd=ROOT, timeout=280, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return Flown(done.returncode, json.loads(done.stdout), done.stderr, out / str(number) / "run.mcap")
