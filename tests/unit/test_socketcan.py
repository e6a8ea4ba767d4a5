"""Raw AF_CAN: what belongs to a kernel interface alone. Needs root's `ip link` on interfaces of its own.

What all transports share is in tests/contract/test_transport.py.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from bus.errors import BusAddressError, BusInUseError, BusLostError
from bus.wire.address import open_transport
from bus.wire.can_link import find_link, list_can_links
from bus.wire.frames import FRAME
from bus.wire.socketcan import CAN_RAW_FD_FRAMES, SOL_CAN_RAW, SocketCanTransport

pytestmark = pytest.mark.vcan

ROOT = Path(__file__).resolve().parents[2]
ARRIVE_S = 10.0
CLAIM = """
import sys, time
from bus.wire.address import open_transport
node = open_transport(sys.argv[1], node="fsw")
print("up", flush=True)
time.sleep(60)
"""


def frame(can_id: int, number: int = 0) -> bytes:
    return FRAME.pack(can_id, 8, number.to_bytes(8, "little"))


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True)


@pytest.fixture
def interface(kernel_can: None) -> Iterator[str]:
    """A vcan interface of this test's own, up."""
    name = f"vt{os.getpid() % 100_000}"
    ip("link", "add", "dev", name, "type", "vcan")
    try:
        ip("link", "set", name, "up")
        yield name
    finally:
        subprocess.run(["ip", "link", "del", name], capture_output=True)


@pytest.fixture
def pair(interface: str) -> Iterator[tuple[SocketCanTransport, SocketCanTransport]]:
    with (
        contextlib.closing(SocketCanTransport(interface, "near")) as near,
        contextlib.closing(SocketCanTransport(interface, "far")) as far,
    ):
        yield near, far


def test_the_kernels_stamp_comes_with_every_frame(pair: tuple[SocketCanTransport, SocketCanTransport]) -> None:
    """One stamp a frame, between the wall clock before sending and after receiving, in order."""
    near, far = pair
    before_ns = time.time_ns()
    near.send(frame(1) + frame(2) + frame(3))
    assert len(far.recv(ARRIVE_S)) == 48
    after_ns = time.time_ns()
    stamps_ns = far.kernel_stamps_ns
    assert len(stamps_ns) == 3
    assert before_ns <= stamps_ns[0] <= stamps_ns[1] <= stamps_ns[2] <= after_ns


def test_fd_frames_are_counted_and_left_out(
    interface: str, pair: tuple[SocketCanTransport, SocketCanTransport]
) -> None:
    _, far = pair
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as other:
        other.setsockopt(SOL_CAN_RAW, CAN_RAW_FD_FRAMES, 1)
        other.bind((interface,))
        other.send(struct.pack("=IBB2x64s", 0x100, 12, 0, bytes(12)))
        assert far.recv(0.2) == b""
        other.send(struct.pack("=IBB2x64s", 0x100, 12, 0, bytes(12)))
        other.send(frame(0x101, 7))
        deadline = time.monotonic() + ARRIVE_S
        while not (batch := far.recv(0.1)):
            assert time.monotonic() < deadline
        assert batch == frame(0x101, 7)
    assert (far.counters.fd_frames, far.counters.rx) == (2, 1)


def test_the_receive_buffer_has_the_size_asked_for(interface: str) -> None:
    """As root the kernel's own limit does not hold; an asked-for queue of 20 000 frames is one."""
    with contextlib.closing(SocketCanTransport(interface, "fsw", queue_frames=20_000)) as transport:
        assert transport.queue_frames >= 20_000


def test_an_interface_that_is_down_is_refused(interface: str) -> None:
    ip("link", "set", interface, "down")
    with pytest.raises(BusAddressError, match=f"{interface} is down; .* ip link set {interface} up"):
        open_transport(f"socketcan:{interface}", node="fsw")


def test_a_missing_interface_names_the_near_miss(interface: str) -> None:
    with pytest.raises(BusAddressError, match=rf"{interface}x is not there; did you mean {interface}\?"):
        open_transport(f"socketcan:{interface}x", node="fsw")


def test_lo_is_not_can(interface: str) -> None:
    with pytest.raises(BusAddressError, match="lo is not a CAN interface"):
        open_transport("socketcan:lo", node="fsw")


def test_a_virtual_interface_has_no_bit_rate(interface: str) -> None:
    """So that any bit rate of the scenario is accepted on it."""
    link = find_link(interface)
    assert link is not None
    assert (link.is_can, link.is_up, link.bitrate_bps) == (True, True, None)
    assert interface in list_can_links()
    open_transport(f"socketcan:{interface}", node="fsw", bitrate_bps=125_000).close()


@pytest.mark.parametrize("act", [("set", "down"), ("del",)])
def test_an_interface_that_goes_under_a_run_is_named(
    interface: str, pair: tuple[SocketCanTransport, SocketCanTransport], act: tuple[str, ...]
) -> None:
    """Down or deleted: receiver and sender are told which interface it was, and what waited is read before that."""
    near, far = pair
    near.send(frame(1, 9))
    assert far.recv(ARRIVE_S) == frame(1, 9)
    if act[0] == "set":
        ip("link", "set", interface, "down")
    else:
        ip("link", "del", interface)
    with pytest.raises(BusLostError, match=f"socketcan:{interface}: the interface"):
        far.recv(ARRIVE_S)
    with pytest.raises(BusLostError, match=f"socketcan:{interface}: the interface"):
        near.send(frame(1) * 3)  # the first one may meet what happened, the next what is


def test_a_busy_interface_is_counted_and_not_raised(
    pair: tuple[SocketCanTransport, SocketCanTransport], monkeypatch: pytest.MonkeyPatch
) -> None:
    """ENOBUFS is a full transmit queue: the frames behind it are still tried."""
    near, far = pair

    class Busy:
        """The sender, one frame a call, with every second call refused as a full queue refuses it."""

        def __init__(self) -> None:
            self._sender = near._sender
            self._calls = 0

        def send(self, fd: int, batch: bytes) -> int:
            self._calls += 1
            if self._calls % 2 == 0:
                raise OSError(errno.ENOBUFS, "No buffer space available")
            return self._sender.send(fd, batch[:16])

    with monkeypatch.context() as patch:
        patch.setattr(near, "_sender", Busy())
        near.send(frame(1, 1) + frame(1, 2) + frame(1, 3))
    assert far.recv(ARRIVE_S) == frame(1, 1) + frame(1, 3)
    assert (near.counters.tx, near.counters.tx_failed) == (2, 1)


def test_a_second_bench_is_refused_until_the_first_one_has_ended(interface: str) -> None:
    """The name is held by the process alone: killed, it leaves nothing behind."""
    address = f"socketcan:{interface}"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-P", "-c", CLAIM, address]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE) as first:
        assert first.stdout is not None
        first.stdout.readline()
        try:
            with pytest.raises(BusInUseError, match=f"{address} already has a fsw"):
                open_transport(address, node="fsw")
            open_transport(address, node="logger").close()
        finally:
            first.kill()
    open_transport(address, node="fsw").close()
