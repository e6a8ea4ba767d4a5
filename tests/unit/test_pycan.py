"""python-can on our buses, and our transports on python-can's interfaces."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from can.interfaces.virtual import VirtualBus
from hypothesis import given
from hypothesis import strategies as st

from bus.errors import BusAddressError, BusLostError
from bus.wire.address import open_transport
from bus.wire.frames import EFF_FLAG, ERR_FLAG, FRAME, RTR_FLAG
from bus.wire.hub.host import HubHost
from bus.wire.python_can import PyCanTransport, pack_message, unpack_message
from bus.wire.python_can_plugin import HilsatBus

ROOT = Path(__file__).resolve().parents[2]
# As the entry point of an installed hilsat does it.
REGISTER = (
    "import can.interfaces as i; i.BACKENDS.setdefault('hilsat', ('bus.wire.python_can_plugin', 'HilsatBus'));"
    "i.VALID_INTERFACES = frozenset(i.BACKENDS); "
)
_serial = itertools.count()


def frame(can_id: int, number: int = 0, dlc: int = 8) -> bytes:
    return FRAME.pack(can_id, dlc, number.to_bytes(8, "little"))


@pytest.fixture
def address() -> str:
    return f"memory:pycan-{next(_serial)}"


@pytest.fixture
def pair(address: str) -> Iterator[tuple[HilsatBus, HilsatBus]]:
    with HilsatBus(address) as near, HilsatBus(address) as far:
        yield near, far


@given(
    can_id=st.one_of(
        st.integers(0, 0x7FF),
        st.integers(0, 0x1FFFFFFF).map(lambda value: value | EFF_FLAG),
        st.integers(0, 0x7FF).map(lambda value: value | RTR_FLAG),
        st.integers(0, 0x1FFFFFFF).map(lambda value: value | ERR_FLAG),
    ),
    data=st.binary(max_size=8),
)
def test_frames_survive_the_way_through_python_can(can_id: int, data: bytes) -> None:
    """Every classic frame becomes a message that python-can accepts as valid, and the same bytes again."""
    body = b"" if can_id & RTR_FLAG and not can_id & ERR_FLAG else data
    original = FRAME.pack(can_id, len(data), body)
    message = unpack_message(can_id, len(data), original[8:], 1.5)
    can.Message(
        arbitration_id=message.arbitration_id,
        is_extended_id=message.is_extended_id or message.is_error_frame,
        is_remote_frame=message.is_remote_frame,
        dlc=message.dlc,
        data=message.data,
        check=True,
    )
    assert message.timestamp == 1.5
    assert pack_message(message) == original


@pytest.mark.parametrize(
    "message",
    [
        can.Message(arbitration_id=0x100, is_fd=True, is_extended_id=False),
        can.Message(arbitration_id=0x800, is_extended_id=False),
        can.Message(arbitration_id=1 << 29, is_extended_id=True),
        can.Message(arbitration_id=-1),
        can.Message(arbitration_id=1, dlc=9),
    ],
)
def test_what_classic_can_cannot_carry_is_refused(message: can.Message, pair: tuple[HilsatBus, HilsatBus]) -> None:
    with pytest.raises(can.CanOperationError):
        pair[0].send(message)


class TestHilsatBus:
    def test_messages_pass_and_own_ones_do_not_come_back(self, pair: tuple[HilsatBus, HilsatBus]) -> None:
        near, far = pair
        before = time.time()
        near.send(can.Message(arbitration_id=0x123, data=b"abc", is_extended_id=False))
        got = far.recv(1.0)
        assert got is not None
        assert (got.arbitration_id, bytes(got.data), got.dlc, got.is_extended_id) == (0x123, b"abc", 3, False)
        assert before <= got.timestamp <= time.time()
        assert got.channel == far.transport.address
        assert near.recv(0.0) is None

    def test_receives_its_own_when_asked(self, address: str) -> None:
        with HilsatBus(address, receive_own_messages=True) as bus:
            bus.send(can.Message(arbitration_id=0x1, is_extended_id=False))
            assert bus.recv(1.0) is not None

    def test_filters_follow_python_cans_rules(self, address: str) -> None:
        """The same filters and messages through python-can's own virtual interface give the same answers."""
        rules = [
            [{"can_id": 0x100, "can_mask": 0x7F0}],
            [{"can_id": 0x100, "can_mask": 0x7FF, "extended": False}],
            [{"can_id": 0x100, "can_mask": 0x7FF, "extended": True}],
            [{"can_id": 0x101, "can_mask": 0x7FF}, {"can_id": 0x12345, "can_mask": 0x1FFFFFFF, "extended": True}],
            None,
            [],
        ]
        messages = [
            can.Message(arbitration_id=can_id, is_extended_id=extended)
            for can_id in (0x100, 0x101, 0x10F, 0x110)
            for extended in (False, True)
        ] + [can.Message(arbitration_id=0x12345, is_extended_id=True)]
        for rule in rules:
            with contextlib.ExitStack() as stack:
                ours = [stack.enter_context(HilsatBus(address, rule if k else None)) for k in (0, 1)]
                name = f"filters-{next(_serial)}"
                theirs = [stack.enter_context(VirtualBus(name, can_filters=rule if k else None)) for k in (0, 1)]
                heard = []
                for near, far in (ours, theirs):
                    for message in messages:
                        near.send(message)
                    heard.append(
                        [(m.arbitration_id, m.is_extended_id) for m in iter(lambda bus=far: bus.recv(0.05), None)]
                    )
                assert heard[0] == heard[1]

    def test_filters_set_later_hold_for_what_already_waits(self, pair: tuple[HilsatBus, HilsatBus]) -> None:
        near, far = pair
        for can_id in (1, 2, 1, 2):
            near.send(can.Message(arbitration_id=can_id, is_extended_id=False))
        first = far.recv(1.0)
        assert first is not None
        far.set_filters([{"can_id": 2, "can_mask": 0x7FF}])
        heard = [message.arbitration_id for message in iter(lambda: far.recv(0.0), None)]
        assert (first.arbitration_id, heard) == (1, [2, 2])

    def test_error_frames_arrive_as_such(self, pair: tuple[HilsatBus, HilsatBus]) -> None:
        pair[0].transport.send(frame(ERR_FLAG | 0x40, 0))
        got = pair[1].recv(1.0)
        assert got is not None
        assert got.is_error_frame
        assert got.arbitration_id == 0x40  # CAN_ERR_BUSOFF

    def test_a_notifier_delivers_from_its_thread(self, pair: tuple[HilsatBus, HilsatBus]) -> None:
        near, far = pair
        reader = can.BufferedReader()
        notifier = can.Notifier(far, [reader])
        for number in range(50):
            near.send(can.Message(arbitration_id=number, is_extended_id=False))
        got = [reader.get_message(5.0) for _ in range(50)]
        notifier.stop()
        assert [message.arbitration_id for message in got if message] == list(range(50))

    def test_periodic_messages(self, pair: tuple[HilsatBus, HilsatBus]) -> None:
        task = pair[0].send_periodic(can.Message(arbitration_id=0x77, is_extended_id=False), 0.01)
        assert all(pair[1].recv(5.0) is not None for _ in range(3))
        task.stop()

    def test_names_are_their_own_so_that_tools_do_not_collide(self, pair: tuple[HilsatBus, HilsatBus]) -> None:
        assert pair[0].transport.node != pair[1].transport.node
        assert str(os.getpid()) in pair[0].transport.node

    def test_errors_are_python_cans(self, address: str, tmp_path: Path) -> None:
        with pytest.raises(can.CanInitializationError, match="names no transport"):
            HilsatBus("nowhere")
        with pytest.raises(can.CanInitializationError, match="has no host"):
            HilsatBus(f"hub:{tmp_path}/bus", patience_s=0.01)
        with pytest.raises(can.CanInitializationError, match="classic"):
            HilsatBus(address, fd=True)
        owner = open_transport(address, node="owner", host=True)
        bus = HilsatBus(address)
        owner.close()
        with pytest.raises(can.CanOperationError, match="host"):
            bus.recv(1.0)
        with pytest.raises(can.CanOperationError, match="host"):
            bus.send(can.Message())
        bus.shutdown()

    def test_can_logger_attaches_to_a_running_hub(self, tmp_path: Path) -> None:
        """python-can's own program, unmodified, writes down what passes on our bus."""
        log = tmp_path / "traffic.log"
        with contextlib.closing(HubHost(f"{tmp_path}/bus", "plant")) as host:
            code = (
                REGISTER + "import sys; sys.argv = ['can_logger', *sys.argv[1:]]; import can.logger; can.logger.main()"
            )
            command = [sys.executable, "-P", "-c", code, "-i", "hilsat", "-c", host.address, "-f", str(log)]
            environment = {**os.environ, "PYTHONPATH": str(ROOT)}
            with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL) as logger:
                deadline = time.monotonic() + 20.0
                while not host.peers():
                    assert time.monotonic() < deadline
                    assert logger.poll() is None
                    host.serve(0.02)
                for number in range(20):
                    host.send(frame(0x100 + number, 0xAB, 2))
                deadline = time.monotonic() + 20.0
                while host.peers()[0].queued:
                    assert time.monotonic() < deadline
                    host.serve(0.02)
                time.sleep(0.5)  # what it has read it writes
                logger.send_signal(signal.SIGINT)  # its file is written through when it ends
                try:
                    assert logger.wait(20.0) == 0
                finally:
                    logger.kill()
        lines = log.read_text().splitlines()
        assert [line.split()[2] for line in lines] == [f"{0x100 + number:03X}#AB00" for number in range(20)]


class TestPyCanTransport:
    def test_speaks_with_python_can_on_its_own_interface(self) -> None:
        """The second interface of python-can stands in for hardware: frames pass both ways, flags and all."""
        name = f"virtual:{next(_serial)}-pycan"
        with VirtualBus(name.partition(":")[2]) as other:
            transport = open_transport(name, node="fsw")
            transport.send(frame(0x1ABCDEF | EFF_FLAG, 5) + frame(0x80, 6))
            first, second = other.recv(1.0), other.recv(1.0)
            assert first is not None
            assert second is not None
            assert (first.arbitration_id, first.is_extended_id, first.data[0]) == (0x1ABCDEF, True, 5)
            assert (second.arbitration_id, second.is_extended_id, second.data[0]) == (0x80, False, 6)
            other.send(can.Message(arbitration_id=0x190, data=b"\7" + bytes(7), is_extended_id=False))
            assert transport.recv(1.0) == frame(0x190, 7)
            transport.close()

    def test_fd_frames_and_nonsense_are_counted_and_left_out(self) -> None:
        with VirtualBus("fd-pycan", protocol=can.CanProtocol.CAN_FD) as other:
            transport = open_transport("virtual:fd-pycan", node="fsw")
            other.send(can.Message(arbitration_id=0x100, data=bytes(12), is_fd=True, is_extended_id=False))
            other.send(can.Message(arbitration_id=0x900, is_extended_id=False))
            other.send(can.Message(arbitration_id=0x101, dlc=8, data=bytes(8), is_extended_id=False))
            assert transport.recv(1.0) == frame(0x101)
            assert (transport.counters.fd_frames, transport.counters.malformed) == (1, 1)
            transport.close()

    def test_settings_in_the_address_reach_the_driver(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Channel, bit rate and further settings arrive; the user's own python-can configuration does not."""
        seen: dict[str, object] = {}

        def fake(**settings: object) -> VirtualBus:
            seen.update(settings)
            return VirtualBus("settings")

        monkeypatch.setattr(can, "Bus", fake)
        PyCanTransport("gs_usb:0?index=1&loopback=true&name=x", "fsw", bitrate_bps=250_000).close()
        assert seen == {
            "interface": "gs_usb",
            "channel": "0",
            "ignore_config": True,
            "bitrate": 250_000,
            "receive_own_messages": False,
            "index": 1,
            "loopback": True,
            "name": "x",
        }

    def test_an_interface_that_cannot_be_opened_is_named(self) -> None:
        """No such device here, or no driver library: the reason of python-can is in the message."""
        for address in ("slcan:/dev/nothing", "kvaser:0", "socketcand:x"):
            with pytest.raises(BusAddressError, match=f"{address} cannot be opened by python-can: ."):
                open_transport(address, node="fsw")

    def test_a_driver_that_fails_is_counted_when_sending_and_lost_when_receiving(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        transport = PyCanTransport("virtual:fails-pycan", "fsw")

        def fail(*_: object, **__: object) -> None:
            raise can.CanOperationError("unplugged")

        monkeypatch.setattr(VirtualBus, "send", fail)
        transport.send(frame(1) + frame(2))
        assert (transport.counters.tx, transport.counters.tx_failed) == (0, 2)
        monkeypatch.setattr(VirtualBus, "_recv_internal", fail)
        with pytest.raises(BusLostError, match="unplugged"):
            transport.recv(0.1)
        transport.close()

    def test_waits_for_the_time_it_was_told_while_foreign_frames_pass(self) -> None:
        """Frames that the filter keeps out do not end the wait early, nor do they lengthen it."""
        with VirtualBus("foreign-pycan") as other:
            transport = open_transport("virtual:foreign-pycan", node="fsw", filters=[(0x80, 0x7FF)])
            stop = threading.Event()

            def chatter() -> None:
                while not stop.wait(0.005):
                    other.send(can.Message(arbitration_id=0x55, is_extended_id=False))

            thread = threading.Thread(target=chatter)
            thread.start()
            started = time.monotonic()
            assert transport.recv(0.1) == b""
            assert time.monotonic() - started >= 0.0999
            stop.set()
            thread.join()
            transport.close()
