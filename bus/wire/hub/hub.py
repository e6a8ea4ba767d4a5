"""The embedded bus: SEQPACKET datagrams through one single-threaded router, with the manners of SocketCAN's vcan.

Every frame goes to every other client in one order, the order in which the hub took them. A client has filters and a
queue of so many frames; a hub never waits for a client, it drops and counts. The queue is the kernel's socket buffer,
so that a reader is woken by one hop; what the kernel will not hold spills into memory. Which frames are still unread is
known without acknowledgements: SIOCOUTQ tells the memory that unread datagrams hold, and each one's share is known.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import socket
import termios
import threading
from collections.abc import Callable
from typing import Any

from bus.errors import BusAddressError
from bus.wire.frames import FRAME_SIZE, drop_malformed
from bus.wire.hub.datagrams import (
    MAX_BATCH_FRAMES,
    MAX_DATAGRAM,
    MAX_QUEUE_FRAMES,
    VCAN_QUEUE_FRAMES,
    VERSION,
    pack_control,
    read_filters,
    unpack_control,
)
from bus.wire.hub.directory import HubDirectory, resolve_directory
from bus.wire.hub.member import Client, DatagramSizes, Peer, read_count

FINE_WAIT_S = 0.5  # epoll counts in ms: shorter waits go through select, which counts in us
DATAGRAMS_PER_TURN = 64  # from one client before the others have theirs
MAX_CLIENTS = 128
MAX_STRANGERS = 16  # connections that have not said hello
MAX_NAME = 64

_SEND_FLAGS = socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL
_LEFT = select.EPOLLHUP | select.EPOLLRDHUP
_READABLE = select.EPOLLIN | select.EPOLLRDHUP


class Hub:
    """Router of one bus directory. `pump()` does the work; nothing happens between two calls of it.

    accept_local : given each batch (and its frame count) that a client sends, for the node that the hub lives in
    """

    def __init__(self, where: str, node: str, accept_local: Callable[[bytes, int], object] | None = None) -> None:
        self.directory = HubDirectory.make(resolve_directory(where))
        self.address = self.directory.address
        self.node = node
        self.malformed = 0  # datagrams or frames refused
        self.refused = 0  # connections turned away
        self.departed: list[str] = []
        self._accept_local = accept_local
        self._clients: dict[int, Client] = {}
        self._members: tuple[Client, ...] = ()  # those that have said hello, in that order
        self._sizes = DatagramSizes()
        try:
            self._listener = self._listen()
        except BusAddressError:
            self.directory.release()
            raise
        self._epoll = select.epoll()
        self._epoll_fd = self._epoll.fileno()
        self._epoll.register(self._listener, select.EPOLLIN)
        self._closed = False

    def peers(self) -> tuple[Peer, ...]:
        """Return the clients that are on the bus."""
        for client in self._members:
            client.settle()
        return tuple(Peer(c.node, c.pid, c.queued, c.dropped) for c in self._members)

    def fileno(self) -> int:
        return self._epoll_fd

    def pump(self, timeout_s: float | None = 0.0) -> None:
        """Serve whoever has something, after waiting up to `timeout_s` [s] (None: no limit) for it."""
        if timeout_s is None:
            events = self._epoll.poll()
        elif 0.0 < timeout_s < FINE_WAIT_S and self._epoll_fd < 1024:
            if not select.select((self._epoll_fd,), (), (), timeout_s)[0]:
                return
            events = self._epoll.poll(0)
        else:
            events = self._epoll.poll(max(timeout_s, 0.0))
        for fd, event in events:
            client = self._clients.get(fd)
            if client is not None:
                self._serve(client, event)
            elif fd == self._listener.fileno():
                self._admit()

    def route(self, batch: bytes, origin: Client | None) -> int:
        """Give the frames to everybody who wants them; return how many there were. `origin` None: the local node."""
        sound = drop_malformed(batch)
        if sound is not batch:
            self.malformed += (len(batch) - len(sound)) // FRAME_SIZE
        count = len(sound) // FRAME_SIZE
        if not count:
            return 0
        for client in self._members:
            if client is origin and not client.receive_own:
                continue
            if client.passes_all:
                self._deliver(client, sound, count)
            else:
                wanted = client.filter.select(sound)
                if wanted:
                    self._deliver(client, wanted, len(wanted) // FRAME_SIZE)
        if self._accept_local is not None and origin is not None:
            self._accept_local(sound, count)
        return count

    def close(self) -> None:
        """End the bus: every client sees it go. What they have not read yet stays readable for them."""
        if self._closed:
            return
        self._closed = True
        with contextlib.suppress(BusAddressError):  # somebody took the name: what is there is not ours
            self.directory.remove_socket()
        self._listener.close()
        for client in self._clients.values():
            self._flush(client)
            client.sock.close()
        self._clients.clear()
        self._members = ()
        self._epoll.close()
        self._sizes.close()
        self.directory.release()

    # -- delivery ---------------------------------------------------------------------------------------------------

    def _deliver(self, client: Client, batch: bytes, count: int) -> None:
        if client.queued + count > client.limit:
            client.settle()
            room = max(client.limit - client.queued, 0)
            if count > room:
                client.dropped += count - room
                if not room:
                    return
                batch = batch[: room * FRAME_SIZE]
                count = room
        if client.dropped != client.reported:
            client.reported = client.dropped
            self._post(client, pack_control(dropped=client.dropped), 0)
        self._post(client, batch, count)

    def _post(self, client: Client, datagram: bytes, count: int) -> None:
        """Give one datagram to the kernel, or to the backlog while the kernel has no room."""
        if not client.backlog:
            try:
                client.sock.send(datagram, _SEND_FLAGS)
            except BlockingIOError:
                self._watch(client, select.EPOLLOUT)
            except OSError:
                return  # it has gone; its end of file is on its way and tells the rest
            else:
                size = self._sizes[len(datagram)]
                client.flights.append((count, size))
                client.kernel_bytes += size
                client.queued += count
                return
        client.queued += count
        last = client.backlog[-1] if client.backlog else None
        if count and last is not None and not len(last) % FRAME_SIZE and len(last) + len(datagram) <= MAX_DATAGRAM:
            last += datagram
        elif count or len(client.backlog) < MAX_QUEUE_FRAMES // MAX_BATCH_FRAMES:
            client.backlog.append(bytearray(datagram))

    def _flush(self, client: Client) -> None:
        while client.backlog:
            datagram = client.backlog[0]
            try:
                client.sock.send(datagram, _SEND_FLAGS)
            except BlockingIOError:
                return
            except OSError:
                break
            client.backlog.popleft()
            size = self._sizes[len(datagram)]
            client.flights.append((0 if len(datagram) % FRAME_SIZE else len(datagram) // FRAME_SIZE, size))
            client.kernel_bytes += size
        client.backlog.clear()
        self._watch(client, 0)

    def _watch(self, client: Client, extra: int) -> None:
        with contextlib.suppress(OSError, ValueError):
            self._epoll.modify(client.fd, _READABLE | extra)

    # -- what clients send ------------------------------------------------------------------------------------------

    def _serve(self, client: Client, event: int) -> None:
        if event & select.EPOLLOUT:
            self._flush(client)
        for _ in range(DATAGRAMS_PER_TURN):
            try:
                datagram = client.sock.recv(MAX_DATAGRAM + 1, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return
            except OSError:  # reset: it left without reading all it had; what it sent is still to be read
                continue
            length = len(datagram)
            if not length:
                if event & _LEFT and not read_count(client.fd, termios.FIONREAD):
                    self._dismiss(client)
                    return
                self.malformed += 1
            elif length % FRAME_SIZE == 0 and client.node:
                self.route(datagram, client)
            elif not self._obey(client, unpack_control(datagram)):
                return
            fcntl.ioctl(client.fd, termios.FIONREAD, client.bytes_waiting)
            if not client.bytes_waiting[0]:
                return

    def _obey(self, client: Client, message: dict[str, Any] | None) -> bool:
        """Do what a control message says; False when the connection ended over it."""
        try:
            if message is not None and "filters" in message and client.node:
                client.set_filters(read_filters(message["filters"]))
                return True
            if message is not None and isinstance(message.get("hello"), dict) and not client.node:
                return self._welcome(client, message["hello"])
        except ValueError as error:
            if not client.node:
                return self._refuse(client, str(error))
        self.malformed += 1
        return True

    def _welcome(self, client: Client, hello: dict[str, Any]) -> bool:
        node, queue_frames = hello.get("node"), hello.get("queue_frames", VCAN_QUEUE_FRAMES)
        if not isinstance(node, str) or not 0 < len(node) <= MAX_NAME or not node.isprintable():
            return self._refuse(client, f"a node name is 1 to {MAX_NAME} printable characters")
        if hello.get("version") != VERSION:
            return self._refuse(client, f"it speaks version {VERSION} of the hub's protocol, and {node} another one")
        if type(queue_frames) is not int or not 0 < queue_frames <= MAX_QUEUE_FRAMES:
            return self._refuse(client, f"a queue is 1 to {MAX_QUEUE_FRAMES} frames")
        if node == self.node:
            return self._refuse(client, f"{node} is already on this bus, as its host (process {os.getpid()})")
        for other in self._members:
            if other.node == node and not self._has_left(other):
                return self._refuse(client, f"{node} is already on this bus (process {other.pid})")
        client.set_filters(read_filters(hello.get("filters")))  # its ValueError refuses as well
        client.receive_own = bool(hello.get("receive_own"))
        client.limit = queue_frames
        client.node = node
        client.sock.setsockopt(
            socket.SOL_SOCKET, socket.SO_SNDBUF, max(queue_frames * self._sizes[FRAME_SIZE] // 2, 4096)
        )
        self._members = (*self._members, client)
        self._post(client, pack_control(welcome={"node": self.node}), 0)
        return True

    def _refuse(self, client: Client, why: str) -> bool:
        self.refused += 1
        self._post(client, pack_control(refused=why), 0)
        self._remove(client)
        return False

    def _has_left(self, client: Client) -> bool:
        """Tell whether a client whose end has not been read yet is gone, and dismiss it then."""
        poll = select.poll()
        poll.register(client.fd, select.POLLRDHUP)
        if not poll.poll(0):
            return False
        self._serve(client, _LEFT)
        if client.fd in self._clients:
            self._dismiss(client)
        return True

    # -- connections ------------------------------------------------------------------------------------------------

    def _listen(self) -> socket.socket:
        self.directory.remove_socket()  # the lock is ours: whoever made it is dead
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        listener.bind(self.directory.socket_path)
        listener.listen(MAX_CLIENTS)
        return listener

    def _admit(self) -> None:
        while True:
            try:
                sock, _ = self._listener.accept()
            except OSError:  # none left, or gone again, or no descriptors
                return
            strangers = [client for client in self._clients.values() if not client.node]
            if len(strangers) >= MAX_STRANGERS:
                self.refused += 1
                self._remove(strangers[0])
            if len(self._clients) >= MAX_CLIENTS:
                self.refused += 1
                with contextlib.suppress(OSError):
                    sock.send(pack_control(refused=f"it has {MAX_CLIENTS} nodes, and room for no more"), _SEND_FLAGS)
                sock.close()
                continue
            sock.setblocking(False)
            client = Client(sock)
            self._clients[client.fd] = client
            self._epoll.register(client.fd, _READABLE)

    def _dismiss(self, client: Client) -> None:
        """Take out a client that left, and tell the others."""
        self._remove(client)
        if client.node:
            self.departed.append(client.node)
            for other in self._members:
                self._post(other, pack_control(gone=client.node), 0)

    def _remove(self, client: Client) -> None:
        del self._clients[client.fd]
        self._members = tuple(member for member in self._members if member is not client)
        with contextlib.suppress(OSError, ValueError):
            self._epoll.unregister(client.fd)
        client.sock.close()


def serve(
    where: str, *, node: str = "hub", stop: threading.Event | None = None, ready: Callable[[], None] | None = None
) -> None:
    """Carry a bus for others, and nothing else, until `stop` is set (or for ever).

    Raises BusInUseError, BusAddressError.
    """
    hub = Hub(where, node)
    try:
        if ready is not None:
            ready()
        while stop is None or not stop.is_set():
            hub.pump(None if stop is None else 0.1)
    finally:
        hub.close()
