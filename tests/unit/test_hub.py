"""The embedded bus: what belongs to it alone. What all transports share is in tests/contract/test_transport.py."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bus.errors import BusAddressError, BusInUseError, BusLostError
from bus.wire.frames import FRAME
from bus.wire.hub.client import HubClient
from bus.wire.hub.datagrams import MAX_DATAGRAM, SOCKET_NAME, VCAN_QUEUE_FRAMES, pack_control, unpack_control
from bus.wire.hub.directory import default_directory
from bus.wire.hub.host import HubHost
from bus.wire.hub.hub import MAX_CLIENTS, MAX_STRANGERS

ROOT = Path(__file__).resolve().parents[2]
ARRIVE_S = 10.0
HOST = """
import sys
from bus.wire.hub.hub import serve
serve(sys.argv[1], node="plant", ready=lambda: print("up", flush=True))
"""
CLIENT = """
import sys, time
from bus.wire.hub.client import HubClient
client = HubClient(sys.argv[1], "fsw")
client.send(bytes(16))
time.sleep(60)
"""


def frame(can_id: int, number: int = 0) -> bytes:
    return FRAME.pack(can_id, 8, number.to_bytes(8, "little"))


def numbers(batch: bytes) -> list[int]:
    return [int.from_bytes(data, "little") for _, _, data in FRAME.iter_unpack(batch)]


def start(code: str, *arguments: str) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen([sys.executable, "-P", "-c", code, *arguments], env=environment, stdout=subprocess.PIPE)


def serve_until(host: HubHost, done: Callable[[], bool]) -> None:
    deadline = time.monotonic() + ARRIVE_S
    while not done():
        assert time.monotonic() < deadline, "it did not happen"
        host.serve(0.01)


def enter(host: HubHost, where: Path, node: str, **settings: object) -> HubClient:
    """A client of a host that lives in this thread."""
    found: list[HubClient | Exception] = []

    def work() -> None:
        try:
            found.append(HubClient(str(where), node, **settings))  # type: ignore[arg-type]
        except Exception as error:
            found.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    serve_until(host, lambda: not thread.is_alive())
    if isinstance(found[0], Exception):
        raise found[0]
    return found[0]


@pytest.fixture
def where(tmp_path: Path) -> Path:
    return tmp_path / "bus"


@pytest.fixture
def host(where: Path) -> Iterator[HubHost]:
    with contextlib.closing(HubHost(str(where), "plant")) as opened:
        yield opened


@pytest.fixture
def stranger(host: HubHost, where: Path) -> Iterator[socket.socket]:
    """A bare connection to the host's socket, as any other program could make one."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as sock:
        sock.connect(str(where / SOCKET_NAME))
        sock.settimeout(ARRIVE_S)
        yield sock


def hello(name: str, **changes: object) -> bytes:
    message = {"version": 1, "node": name, "receive_own": False, "queue_frames": 100, "filters": None}
    return pack_control(hello={**message, **changes})


class TestDirectory:
    def test_is_made_private_and_taken_away(self, where: Path) -> None:
        host = HubHost(str(where), "plant")
        assert stat.S_IMODE(where.stat().st_mode) == 0o700
        host.close()
        assert not where.exists()

    def test_that_was_there_stays(self, where: Path) -> None:
        where.mkdir(mode=0o700)
        HubHost(str(where), "plant").close()
        assert list(where.iterdir()) == []

    def test_open_to_others_is_refused_by_host_and_client(self, where: Path) -> None:
        where.mkdir()
        where.chmod(0o755)
        for open_it in (HubHost, HubClient):
            with pytest.raises(BusAddressError, match=r"mode 0755.*chmod 700"):
                open_it(str(where), "node")

    def test_of_somebody_else_is_refused(self, where: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        where.mkdir(mode=0o700)
        monkeypatch.setattr(os, "geteuid", lambda: where.stat().st_uid + 1)
        with pytest.raises(BusAddressError, match="belongs to user id"):
            HubHost(str(where), "plant")

    def test_that_is_a_file_is_refused(self, where: Path) -> None:
        where.write_text("")
        for open_it in (HubHost, HubClient):
            with pytest.raises(BusAddressError, match="not a directory"):
                open_it(str(where), "node")

    def test_that_cannot_be_made_is_named(self, where: Path) -> None:
        where.write_text("")
        with pytest.raises(BusAddressError, match="cannot be made"):
            HubHost(str(where / "below"), "plant")

    def test_path_longer_than_a_socket_address(self, tmp_path: Path) -> None:
        """The kernel takes 107 bytes of path; the bus works beyond."""
        where = tmp_path / ("d" * 120)
        with (
            contextlib.closing(HubHost(str(where), "plant")) as host,
            contextlib.closing(enter(host, where, "fsw")) as client,
        ):
            host.send(frame(0x80, 7))
            assert numbers(client.recv(ARRIVE_S)) == [7]
        assert not where.exists()

    def test_default_is_one_per_user(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
        assert default_directory().parent == tmp_path
        with contextlib.closing(HubHost("", "plant")) as host:
            assert host.address == f"hub:{default_directory()}"
        monkeypatch.delenv("XDG_RUNTIME_DIR")
        assert str(os.geteuid()) in default_directory().name

    def test_in_use_by_another_process_names_it(self, where: Path) -> None:
        with start(HOST, str(where)) as other:
            assert other.stdout is not None
            other.stdout.readline()
            try:
                with pytest.raises(BusInUseError, match=f"process {other.pid}"):
                    HubHost(str(where), "plant")
            finally:
                other.kill()

    def test_of_a_killed_host_is_taken_over(self, where: Path) -> None:
        """kill -9 of the host: its client is told at once; the socket left behind does not stop the next host."""
        with start(HOST, str(where)) as other:
            assert other.stdout is not None
            other.stdout.readline()
            client = HubClient(str(where), "fsw")
            other.kill()
            with pytest.raises(BusLostError, match=r"host of the bus \(plant\) has gone"):
                client.recv(ARRIVE_S)
        assert (where / SOCKET_NAME).exists()
        with contextlib.closing(HubHost(str(where), "plant")) as host:
            enter(host, where, "fsw").close()

    def test_hub_process_ends_clean_on_sigterm(self, where: Path) -> None:
        """A handler that raises ends a hub that waits, and nothing stays behind."""
        with start("import signal; signal.signal(signal.SIGTERM, lambda *_: sys.exit(0)); " + HOST, str(where)) as hub:
            assert hub.stdout is not None
            hub.stdout.readline()
            hub.send_signal(signal.SIGTERM)
            assert hub.wait(ARRIVE_S) == 0
        assert not where.exists()


class TestEntering:
    def test_without_a_host_is_a_clear_error(self, where: Path) -> None:
        with pytest.raises(BusLostError, match=r"has no host: none appeared within 0.05 s"):
            HubClient(str(where), "fsw", patience_s=0.05)

    def test_waits_for_the_host(self, where: Path) -> None:
        """The client may be started first."""
        found: list[HubClient] = []
        thread = threading.Thread(target=lambda: found.append(HubClient(str(where), "fsw")))
        thread.start()
        time.sleep(0.1)
        with contextlib.closing(HubHost(str(where), "plant")) as host:
            serve_until(host, lambda: not thread.is_alive())
            assert [peer.node for peer in host.peers()] == ["fsw"]
            assert found[0].host == "plant"
        found[0].close()

    def test_a_host_that_hangs_is_a_clear_error(self, host: HubHost, where: Path) -> None:
        with pytest.raises(BusLostError, match=r"did not answer fsw within 0.05 s"):
            HubClient(str(where), "fsw", patience_s=0.05)

    def test_the_name_of_the_host_is_taken(self, host: HubHost, where: Path) -> None:
        with pytest.raises(BusInUseError, match=r"plant is already on this bus, as its host"):
            enter(host, where, "plant")

    @pytest.mark.parametrize(
        ("changes", "why"),
        [
            ({"node": ""}, "1 to 64"),
            ({"node": "x" * 65}, "1 to 64"),
            ({"node": "a\nb"}, "1 to 64"),
            ({"node": 5}, "1 to 64"),
            ({"version": 2}, "version"),
            ({"queue_frames": 0}, "queue"),
            ({"queue_frames": True}, "queue"),
            ({"queue_frames": 1 << 30}, "queue"),
            ({"filters": 5}, "filters"),
            ({"filters": [[1]]}, "filter is a pair"),
            ({"filters": [[1, -1]]}, "filter is a pair"),
            ({"filters": [[0, 0]] * 513}, "512"),
        ],
    )
    def test_a_hello_that_makes_no_sense_is_refused_with_a_reason(
        self, host: HubHost, stranger: socket.socket, changes: dict[str, object], why: str
    ) -> None:
        stranger.send(hello("x", **changes))
        serve_until(host, lambda: host._hub.refused == 1)
        answer = unpack_control(stranger.recv(4096))
        assert answer is not None
        assert why in answer["refused"]
        assert stranger.recv(4096) == b""
        assert host.peers() == ()

    def test_a_client_that_names_no_queue_gets_that_of_vcan(self, host: HubHost, stranger: socket.socket) -> None:
        stranger.send(pack_control(hello={"version": 1, "node": "x"}))
        serve_until(host, lambda: len(host.peers()) == 1)
        for number in range(400):
            host.send(frame(0x100, number))
        assert host.peers()[0].queued == VCAN_QUEUE_FRAMES == 278
        assert host.peers()[0].dropped == 400 - 278


class TestTrouble:
    @pytest.mark.parametrize(
        "garbage",
        [b"", b"\1", b"\xff" * 17, b"\xffHil" + b"{" * 20, b"\xffHil{}      ", bytes(MAX_DATAGRAM + 16), bytes(15)],
    )
    def test_garbage_is_counted_and_survived(
        self, host: HubHost, where: Path, stranger: socket.socket, garbage: bytes
    ) -> None:
        """A zero-length datagram, odd lengths, broken and empty control messages, and one longer than any of ours."""
        client = enter(host, where, "fsw")
        stranger.send(hello("x"))
        serve_until(host, lambda: len(host.peers()) == 2)
        before = host._hub.malformed
        stranger.send(garbage)
        serve_until(host, lambda: host._hub.malformed > before)
        stranger.send(frame(0x123, 5))
        assert numbers(host.recv(ARRIVE_S)) == [5]
        assert numbers(client.recv(ARRIVE_S)) == [5]
        assert host.counters.malformed == before + 1

    def test_frames_of_one_who_said_no_hello_go_nowhere(self, host: HubHost, stranger: socket.socket) -> None:
        stranger.send(frame(0x123))
        serve_until(host, lambda: host._hub.malformed == 1)
        assert host.recv(0.0) == b""

    def test_half_open_connections_do_not_keep_others_out(self, host: HubHost, where: Path) -> None:
        """More strangers than there is patience for: the oldest go; a client that speaks gets in."""
        with contextlib.ExitStack() as stack:
            for _ in range(3 * MAX_STRANGERS):
                sock = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
                sock.connect(str(where / SOCKET_NAME))
            client = enter(host, where, "fsw")
            stack.callback(client.close)
            host.send(frame(0x80, 3))
            assert numbers(client.recv(ARRIVE_S)) == [3]
            assert host._hub.refused >= 2 * MAX_STRANGERS

    def test_the_number_of_clients_is_limited(self, host: HubHost, where: Path) -> None:
        with contextlib.ExitStack() as stack:
            for number in range(MAX_CLIENTS):
                stack.callback(enter(host, where, f"n{number}").close)
            with pytest.raises(BusInUseError, match=f"{MAX_CLIENTS} nodes"):
                enter(host, where, "one too many")
            assert len(host.peers()) == MAX_CLIENTS

    def test_what_a_client_sent_before_it_left_still_counts(self, host: HubHost, where: Path) -> None:
        """It leaves without reading what waits for it; its own frames are all routed before its name goes."""
        client = enter(host, where, "fsw")
        host.send(frame(0x80))
        for number in range(5):
            client.send(frame(0x110, number))
        client.close()
        got: list[int] = []
        while host.departed != ["fsw"]:
            got += numbers(host.recv(ARRIVE_S))
        assert got == [0, 1, 2, 3, 4]

    def test_zero_length_datagrams_hide_no_frames_of_a_leaving_client(
        self, host: HubHost, stranger: socket.socket
    ) -> None:
        stranger.send(hello("x"))
        serve_until(host, lambda: len(host.peers()) == 1)
        stranger.send(b"")
        stranger.send(frame(0x110, 9))
        stranger.close()
        assert numbers(host.recv(ARRIVE_S)) == [9]
        serve_until(host, lambda: host.departed == ["x"])

    def test_a_killed_client_is_noticed(self, host: HubHost, where: Path) -> None:
        with start(CLIENT, str(where)) as fsw:
            assert host.recv(ARRIVE_S) == bytes(16)
            assert [(peer.node, peer.pid) for peer in host.peers()] == [("fsw", fsw.pid)]
            fsw.kill()
            assert host.recv(ARRIVE_S) == b""
        assert host.departed == ["fsw"]
        assert host.peers() == ()

    def test_the_name_of_a_killed_client_is_free_at_once(self, host: HubHost, where: Path) -> None:
        """Its end and the next one's hello wait together: the hub looks before it refuses."""
        first = enter(host, where, "fsw")
        found: list[HubClient] = []
        thread = threading.Thread(target=lambda: found.append(HubClient(str(where), "fsw")))
        thread.start()
        time.sleep(0.1)  # its hello is in the hub's socket
        first.close()
        serve_until(host, lambda: not thread.is_alive())
        assert [peer.node for peer in host.peers()] == ["fsw"]
        found[0].close()


class TestQueues:
    def test_more_than_the_kernel_holds_waits_in_memory(self, host: HubHost, where: Path) -> None:
        """60 000 unread single frames: past any socket buffer, none lost, order kept, also across the spill."""
        client = enter(host, where, "fsw", queue_frames=60_000)
        for number in range(60_000):
            host.send(frame(0x100, number))
        got: list[int] = []
        while len(got) < 60_000:
            got += numbers(client.recv(0.1))
            host.serve()
        assert got == list(range(60_000))
        assert client.counters.dropped == 0

    def test_news_keeps_its_place_behind_spilled_frames(self, host: HubHost, where: Path) -> None:
        """A departure is told after the frames that came before it, and frames after it follow."""
        client, other = enter(host, where, "fsw", queue_frames=60_000), enter(host, where, "other", queue_frames=1)
        for number in range(30_000):
            host.send(frame(0x100, number))
        other.close()
        serve_until(host, lambda: host.departed == ["other"])
        host.send(frame(0x100, 30_000))
        got: list[int] = []
        while len(got) < 30_001:
            got += numbers(client.recv(0.1))
            host.serve()
        assert got == list(range(30_001))
        assert client.departed == ["other"]

    def test_what_does_not_fit_is_cut_off_a_batch(self, host: HubHost, where: Path) -> None:
        client = enter(host, where, "fsw", queue_frames=8)
        host.send(b"".join(frame(0x100, number) for number in range(20)))
        assert numbers(client.recv(ARRIVE_S)) == list(range(8))
        host.send(frame(0x100, 20))
        assert numbers(client.recv(ARRIVE_S)) == [20]
        assert client.counters.dropped == 12

    def test_the_host_has_a_limit_too(self, where: Path) -> None:
        with contextlib.closing(HubHost(str(where), "plant", queue_frames=10)) as host:
            client = enter(host, where, "fsw")
            for number in range(100):
                client.send(frame(0x100, number))
            serve_until(host, lambda: host.counters.dropped == 90)
            assert numbers(host.recv(0.0)) == list(range(10))
            client.send(frame(0x100, 100))
            assert numbers(host.recv(ARRIVE_S)) == [100]

    def test_a_hub_that_does_not_serve_holds_a_sender_up_no_longer_than_its_patience(
        self, host: HubHost, where: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """The host hangs: frames that find no room are counted as not sent; those with room are all routed later."""
        monkeypatch.setattr("bus.wire.hub.client.SEND_PATIENCE_S", 0.05)
        client = enter(host, where, "fsw")
        while not client.counters.tx_failed:
            client.send(frame(0x110, client.counters.tx))
        sent = client.counters.tx
        got: list[int] = []
        while len(got) < sent:
            got += numbers(host.recv(ARRIVE_S))
        assert got == list(range(sent))

    def test_a_host_that_only_sends_still_serves(self, host: HubHost, where: Path) -> None:
        """A client enters and speaks while the host does nothing but send."""
        found: list[HubClient] = []
        thread = threading.Thread(target=lambda: found.append(HubClient(str(where), "fsw")))
        thread.start()
        deadline = time.monotonic() + ARRIVE_S
        while thread.is_alive() and time.monotonic() < deadline:
            host.send(frame(0x100))
        assert found
        found[0].close()
