"""What every transport promises, proved on each of them: one set of tests, one rig per transport.

The SocketCAN rig needs vcan0. Without it its tests are skipped, but fail when HILSAT_REQUIRE_VCAN=1: a run that was
started to test real CAN must not pass by not testing it.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import select
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from bus.errors import BusInUseError, BusLostError
from bus.wire.address import open_transport
from bus.wire.frames import EFF_FLAG, ERR_FLAG, FRAME, FRAME_SIZE, RTR_FLAG
from bus.wire.hub.host import HubHost
from bus.wire.hub.hub import serve
from bus.wire.transport import Transport

ROOT = Path(__file__).resolve().parents[2]
ARRIVE_S = 10.0  # a frame that has not arrived by then is lost
VCAN = pytest.param("socketcan", marks=pytest.mark.vcan)
EVERY = ["memory", "hub-host", "hub-alone", "virtual", VCAN]
BOUNDED = ["memory", "hub-host", "hub-alone", VCAN]  # python-can does not tell what its drivers drop
HOSTED = ["memory", "hub-host", "hub-alone"]  # a kernel interface and a driver have no host and know no names
INTERPROCESS = ["hub-host", "hub-alone", VCAN]
# Between sender and sockets the kernel has a queue of its own (net.core.netdev_max_backlog, 1000 frames). On a busy
# machine it is emptied by a thread, and what does not fit is dropped without a count that any socket could see.
KERNEL_BACKLOG = 900
_serial = itertools.count()

ECHO = """
import sys
from bus.errors import BusLostError
from bus.wire.address import open_transport
peer = open_transport(sys.argv[1], node="echo")
peer.send(bytes.fromhex(sys.argv[2]))
try:
    while True:
        batch = peer.recv(20.0)
        if not batch:
            sys.exit("nothing came")
        peer.send(batch)
except BusLostError as lost:
    sys.exit(str(lost))
"""


def frame(can_id: int, number: int = 0, dlc: int = 8) -> bytes:
    """A frame whose data hold a number."""
    return FRAME.pack(can_id, dlc, number.to_bytes(8, "little"))


def numbers(batch: bytes) -> list[int]:
    return [int.from_bytes(data, "little") for _, _, data in FRAME.iter_unpack(batch)]


class Rig:
    """One bus under test. `open` gives nodes on it; the first one carries the bus where a node does."""

    def __init__(self, kind: str, address: str, stack: contextlib.ExitStack) -> None:
        self.kind = kind
        self.address = address
        self._stack = stack
        self._host: HubHost | None = None
        self._nodes = 0
        self.stop: Callable[[], None] = lambda: None  # takes the bus away

    def open(self, node: str, **settings: Any) -> Transport:
        first = self._nodes == 0
        self._nodes += 1
        settings.setdefault("host", first and self.kind in ("memory", "hub-host"))
        if self._host is None:
            transport = open_transport(self.address, node=node, **settings)
        else:
            transport = self._open_while_host_serves(node, settings)
        self._stack.callback(transport.close)
        if isinstance(transport, HubHost):
            self._host = transport
            self.stop = transport.close
        elif self.kind == "memory" and first:
            self.stop = transport.close
        return transport

    def turn(self) -> None:
        """Let the bus work, where it works only when its host does."""
        if self._host is not None:
            self._host.serve(0.0)

    def gather(self, node: Transport, count: int, timeout_s: float = ARRIVE_S) -> bytes:
        """Receive at least so many frames."""
        batch = b""
        deadline = time.monotonic() + timeout_s
        while len(batch) < count * FRAME_SIZE:
            assert time.monotonic() < deadline, f"{len(batch) // FRAME_SIZE} of {count} frames came"
            self.turn()
            part = node.recv(0.02)
            assert len(part) % FRAME_SIZE == 0
            batch += part
        return batch

    def silence(self, node: Transport) -> bool:
        """Tell whether nothing waits at the node, after the bus has passed a frame on behind it."""
        self.turn()
        return node.recv(0.05) == b""

    def _open_while_host_serves(self, node: str, settings: dict[str, Any]) -> Transport:
        opened: list[Transport] = []
        failed: list[Exception] = []

        def work() -> None:
            try:
                opened.append(open_transport(self.address, node=node, **settings))
            except Exception as error:
                failed.append(error)

        thread = threading.Thread(target=work)
        thread.start()
        while thread.is_alive():
            self.turn()
            thread.join(0.002)
        if failed:
            raise failed[0]
        return opened[0]


def start_hub(directory: Path, stack: contextlib.ExitStack) -> Callable[[], None]:
    """Run a hub of its own in a thread; return what ends it."""
    stop, ready = threading.Event(), threading.Event()
    thread = threading.Thread(target=serve, args=(str(directory),), kwargs={"stop": stop, "ready": ready.set})
    thread.start()

    def end() -> None:
        stop.set()
        thread.join()

    stack.callback(end)
    assert ready.wait(ARRIVE_S)
    return end


@pytest.fixture
def rig(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Rig]:
    kind = request.param
    with contextlib.ExitStack() as stack:
        name = f"contract-{os.getpid()}-{next(_serial)}"
        if kind == "socketcan":
            request.getfixturevalue("vcan")
        address = {
            "memory": f"memory:{name}",
            "hub-host": f"hub:{tmp_path}/bus",
            "hub-alone": f"hub:{tmp_path}/bus",
            "virtual": f"virtual:{name}",
            "socketcan": "socketcan:vcan0",
        }[kind]
        built = Rig(kind, address, stack)
        if kind == "hub-alone":
            built.stop = start_hub(tmp_path / "bus", stack)
        yield built


@pytest.mark.parametrize("rig", EVERY, indirect=True)
class TestTransport:
    def test_frames_arrive_whole_and_in_order(self, rig: Rig) -> None:
        """What is sent in several batches arrives as the same bytes in the same order."""
        near, far = rig.open("near"), rig.open("far")
        sent = [b"".join(frame(0x100 + k, 10 * batch + k) for k in range(batch + 1)) for batch in range(8)]
        for batch in sent:
            near.send(batch)
        assert rig.gather(far, 36) == b"".join(sent)
        assert (near.counters.tx, far.counters.rx) == (36, 36)

    def test_both_directions(self, rig: Rig) -> None:
        near, far = rig.open("near"), rig.open("far")
        near.send(frame(0x080, 1))
        assert rig.gather(far, 1) == frame(0x080, 1)
        far.send(frame(0x081, 2))
        assert rig.gather(near, 1) == frame(0x081, 2)

    def test_own_frames_do_not_come_back(self, rig: Rig) -> None:
        """The sender hears the others only: its own frame does not precede the answer to it."""
        near, far = rig.open("near"), rig.open("far")
        near.send(frame(0x100, 1))
        rig.gather(far, 1)
        far.send(frame(0x101, 2))
        assert rig.gather(near, 1) == frame(0x101, 2)
        assert rig.silence(near)

    def test_own_frames_come_back_when_asked_for(self, rig: Rig) -> None:
        near, far = rig.open("near"), rig.open("far", receive_own=True)
        far.send(frame(0x100, 1))
        assert rig.gather(far, 1) == frame(0x100, 1)
        assert rig.gather(near, 1) == frame(0x100, 1)

    def test_everybody_sees_one_order(self, rig: Rig) -> None:
        """Two nodes send in turns and at once; two listeners, and the senders who hear themselves, see one sequence."""
        nodes = [rig.open(name, receive_own=True) for name in ("a", "b", "c", "d")]
        for number in range(60):
            nodes[number % 2].send(frame(0x100 + number % 2, number))
            if number % 7 == 0:
                rig.turn()
        seen = [rig.gather(node, 60) for node in nodes]
        assert sorted(numbers(seen[0])) == list(range(60))
        assert seen[1:] == seen[:1] * 3

    def test_filters_choose_by_id_and_mask(self, rig: Rig) -> None:
        """Only frames with id & mask equal to the filter's pass; several filters add up."""
        near, far = rig.open("near"), rig.open("far", filters=[(0x110, 0x7FC), (0x081, 0x7FF)])
        near.send(b"".join(frame(can_id, can_id) for can_id in (0x080, 0x081, 0x10F, 0x110, 0x113, 0x114, 0x190)))
        assert numbers(rig.gather(far, 3)) == [0x081, 0x110, 0x113]
        assert rig.silence(far)

    def test_inverted_filter(self, rig: Rig) -> None:
        """CAN_INV_FILTER in the id lets everything else pass."""
        near, far = rig.open("near"), rig.open("far", filters=[(0x100 | ERR_FLAG, 0x7FF)])
        near.send(frame(0x100, 1) + frame(0x101, 2))
        assert numbers(rig.gather(far, 1)) == [2]
        assert rig.silence(far)

    def test_no_frame_passes_an_empty_list_of_filters_but_errors_do(self, rig: Rig) -> None:
        near, far = rig.open("near"), rig.open("far", filters=[])
        near.send(frame(0x100, 1) + frame(ERR_FLAG | 0x40, 2) + frame(0x101, 3))
        assert numbers(rig.gather(far, 1)) == [2]
        assert rig.silence(far)

    def test_filters_can_be_changed(self, rig: Rig) -> None:
        near, far = rig.open("near"), rig.open("far", filters=[(0x100, 0x7FF)])
        far.set_filters([(0x200, 0x7FF)])
        rig.turn()
        time.sleep(0.05)  # a hub on its own takes it up in its own time
        near.send(frame(0x100, 1) + frame(0x200, 2))
        assert numbers(rig.gather(far, 1)) == [2]
        far.set_filters(None)
        rig.turn()
        time.sleep(0.05)
        near.send(frame(0x100, 3) + frame(0x200, 4))
        assert numbers(rig.gather(far, 2)) == [3, 4]

    def test_all_kinds_of_classic_frames_pass_unchanged(self, rig: Rig) -> None:
        """Short data, remote, 29-bit and error frames arrive with their flags; errors are counted on arrival."""
        near, far = rig.open("near"), rig.open("far")
        kinds = [
            frame(0x123, 0, 0),
            frame(0x123, 0xAB, 1),
            frame(0x123 | RTR_FLAG, 0, 3),
            frame(0x1ABCDEF | EFF_FLAG, 7),
            frame(0x1ABCDEF | EFF_FLAG | RTR_FLAG, 0, 8),
            frame(ERR_FLAG | 0x40, 0x1122),
        ]
        for kind in kinds:
            near.send(kind)
        assert rig.gather(far, len(kinds)) == b"".join(kinds)
        assert far.counters.error_frames == 1

    def test_frames_that_no_controller_could_send_are_left_out(self, rig: Rig) -> None:
        """A dlc over 8 does not reach the others; its neighbours in the batch do."""
        near, far = rig.open("near"), rig.open("far")
        near.send(frame(0x100, 1) + frame(0x100, 2, 9) + frame(0x100, 3, 255) + frame(0x100, 4))
        assert numbers(rig.gather(far, 2)) == [1, 4]
        assert rig.silence(far)

    def test_a_batch_that_is_not_whole_frames_is_refused(self, rig: Rig) -> None:
        near, far = rig.open("near"), rig.open("far")
        with pytest.raises(ValueError, match="whole frames"):
            near.send(frame(0x100) + b"\0")
        near.send(b"")
        near.send(frame(0x100, 5))
        assert numbers(rig.gather(far, 1)) == [5]

    def test_all_that_waits_comes_at_once(self, rig: Rig) -> None:
        """Several batches sent before the reader looks are one recv."""
        near, far = rig.open("near"), rig.open("far")
        for number in range(5):
            near.send(frame(0x100, number))
        near.send(frame(0x100, 5) + frame(0x100, 6))
        rig.turn()
        time.sleep(0.1)  # for a hub in another thread
        assert numbers(far.recv(ARRIVE_S)) == list(range(7))

    def test_a_batch_longer_than_any_buffer_of_ours(self, rig: Rig) -> None:
        near, far = rig.open("near"), rig.open("far")
        length = 3000 if rig.kind != "socketcan" else KERNEL_BACKLOG
        batch = b"".join(frame(0x100, number) for number in range(length))
        near.send(batch)
        assert rig.gather(far, length) == batch

    def test_recv_ends_on_time(self, rig: Rig) -> None:
        """Nothing comes: recv waits as long as told and not less, to the microsecond, and zero is no wait."""
        near = rig.open("near")
        assert near.recv(0.0) == b""
        for wait_s in (0.0005, 0.0123, 0.05, 1.01):
            started = time.monotonic()
            assert near.recv(wait_s) == b""
            # The timer behind a wait of a second or more counts in ticks of the kernel, 10 ms at the most.
            assert time.monotonic() - started >= wait_s - (0.010 if wait_s > 1 else 1e-5)

    def test_recv_without_limit_ends_with_a_frame(self, rig: Rig) -> None:
        near, far = rig.open("near"), rig.open("far")
        timer = threading.Timer(0.1, far.send, (frame(0x100, 1),))
        timer.start()
        assert numbers(near.recv(None)) == [1]
        timer.join()

    def test_a_waiting_descriptor_becomes_readable(self, rig: Rig) -> None:
        near, far = rig.open("near"), rig.open("far")
        if far.fileno() < 0:
            assert rig.kind == "virtual"  # python-can's virtual interface has none, and we say so
            return
        assert not select.select([far], [], [], 0)[0]
        near.send(frame(0x100, 1))
        rig.turn()
        assert select.select([far], [], [], ARRIVE_S)[0]
        assert numbers(far.recv(0.0)) == [1]
        assert not select.select([far], [], [], 0)[0]

    def test_ten_thousand_frames_and_none_lost(self, rig: Rig) -> None:
        """A reader that keeps up loses nothing; nothing is counted as lost."""
        near, far = rig.open("near"), rig.open("far")
        got: list[int] = []
        for start in range(0, 10_000, 250):
            for number in range(start, start + 250, 10):
                near.send(b"".join(frame(0x100, number + k) for k in range(10)))
            rig.turn()
            got += numbers(far.recv(ARRIVE_S))
        got += numbers(rig.gather(far, 10_000 - len(got)))
        assert got == list(range(10_000))
        assert (near.counters.tx, near.counters.tx_failed) == (10_000, 0)
        assert (far.counters.rx, far.counters.dropped) == (10_000, 0)

    def test_after_close_the_bus_is_lost_and_close_repeats(self, rig: Rig) -> None:
        near, far = rig.open("near"), rig.open("far")
        far.close()
        far.close()
        with pytest.raises(BusLostError, match="far has left"):
            far.recv(0.1)
        with pytest.raises(BusLostError, match="far has left"):
            far.send(frame(0x100))
        near.send(frame(0x100))  # nobody hears it, and that is no error
        assert near.counters.tx_failed == 0


@pytest.mark.parametrize("rig", BOUNDED, indirect=True)
class TestQueue:
    def test_a_reader_that_does_not_read_loses_the_newest_frames_and_is_told(self, rig: Rig) -> None:
        """The sender is never held up. The first frames are kept, in order; the count comes with the next frame."""
        near, far = rig.open("near"), rig.open("far", queue_frames=50)
        limit = getattr(far, "queue_frames", 50)  # the kernel rounds its own buffers up
        witness = rig.open("witness")
        for number in range(limit + 150):
            near.send(frame(0x100, number))
            rig.turn()
        rig.gather(witness, limit + 150)  # the bus has passed everything on
        kept = numbers(rig.gather(far, min(limit, 50)))
        kept += numbers(far.recv(0.1))
        assert kept == list(range(len(kept)))
        assert abs(len(kept) - limit) <= (2 if rig.kind == "socketcan" else 0)
        near.send(frame(0x100, 9999))
        assert numbers(rig.gather(far, 1))[-1] == 9999
        assert far.counters.dropped == limit + 150 - len(kept)
        assert (near.counters.tx, near.counters.tx_failed, near.counters.dropped) == (limit + 151, 0, 0)

    def test_a_slow_reader_takes_nothing_from_a_quick_one(self, rig: Rig) -> None:
        near, slow, quick = rig.open("near"), rig.open("slow", queue_frames=20), rig.open("quick")
        for start in range(0, 2000, 100):
            for number in range(start, start + 100):
                near.send(frame(0x100, number))
            assert numbers(rig.gather(quick, 100)) == list(range(start, start + 100))
        assert quick.counters.dropped == 0
        assert numbers(rig.gather(slow, 20))[:20] == list(range(20))

    def test_a_queue_as_long_as_the_burst_holds_all_of_it(self, rig: Rig) -> None:
        near, far = rig.open("near"), rig.open("far", queue_frames=10_000)
        if getattr(far, "queue_frames", 10_000) < 10_000:
            assert rig.kind == "socketcan"  # the kernel's limit for this user, and it is told
            return
        for number in range(10_000):
            near.send(frame(0x100, number))
            rig.turn()
            if number % KERNEL_BACKLOG == 0 and rig.kind == "socketcan":
                time.sleep(0.01)
        assert numbers(rig.gather(far, 10_000)) == list(range(10_000))
        assert far.counters.dropped == 0

    def test_a_queue_recovers(self, rig: Rig) -> None:
        """What was read makes room again, with batches of all lengths: the count of unread frames does not drift."""
        near, far = rig.open("near"), rig.open("far", queue_frames=300)
        sent = 0
        for round_ in range(200):
            length = 1 + round_ * 37 % 290
            near.send(b"".join(frame(0x100, sent + k) for k in range(length)))
            assert numbers(rig.gather(far, length)) == list(range(sent, sent + length))
            sent += length
        assert far.counters.dropped == 0


@pytest.mark.parametrize("rig", HOSTED, indirect=True)
class TestHost:
    def test_when_the_bus_goes_the_others_are_told_after_the_last_frames(self, rig: Rig) -> None:
        near, far = rig.open("near"), rig.open("far")
        near.send(frame(0x100, 1) + frame(0x100, 2))
        rig.turn()
        time.sleep(0.05)
        rig.stop()
        assert numbers(far.recv(ARRIVE_S)) == [1, 2]
        with pytest.raises(BusLostError, match="host"):
            far.recv(ARRIVE_S)
        with pytest.raises(BusLostError, match="host"):
            far.send(frame(0x100))

    def test_a_node_that_leaves_is_named(self, rig: Rig) -> None:
        """The wait of the others ends early, and the name is on their list."""
        near, far, third = rig.open("near"), rig.open("far"), rig.open("third")
        far.close()
        assert near.recv(ARRIVE_S) == b""
        assert near.departed == ["far"]
        assert third.recv(ARRIVE_S) == b""
        assert third.departed == ["far"]
        again = rig.open("far")  # the name is free again
        near.send(frame(0x100, 1))
        assert numbers(rig.gather(again, 1)) == [1]

    def test_a_second_host_is_refused(self, rig: Rig) -> None:
        rig.open("near")
        rig.turn()
        with pytest.raises(BusInUseError, match="host"):
            open_transport(rig.address, node="other", host=True)


@pytest.mark.parametrize("rig", BOUNDED, indirect=True)
def test_a_second_node_of_one_name_is_refused(rig: Rig) -> None:
    """A second bench on one bus is told so, and the first one goes on."""
    near, far = rig.open("near"), rig.open("far")
    with pytest.raises(BusInUseError, match="already"):
        rig.open("far")
    near.send(frame(0x100, 1))
    assert numbers(rig.gather(far, 1)) == [1]


@pytest.mark.parametrize("rig", INTERPROCESS, indirect=True)
def test_two_processes(rig: Rig) -> None:
    """Another process sends every frame back: 500 rounds, batches of several lengths, the same bytes."""
    near = rig.open("near")
    hello = frame(0x700, 1)
    command = [sys.executable, "-P", "-c", ECHO, rig.address, hello.hex()]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, env=environment) as echo:
        try:
            assert rig.gather(near, 1) == hello
            for number in range(500):
                batch = b"".join(frame(0x190 + k, number * 16 + k) for k in range(number % 13 + 1))
                near.send(batch)
                assert rig.gather(near, number % 13 + 1) == batch
        finally:
            echo.kill()
