"""What a hub keeps of each client: who it is, what it wants, and which of its frames it has not read yet."""

from __future__ import annotations

import fcntl
import socket
import struct
import termios
from array import array
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from bus.wire.frames import Filter, FrameFilter
from bus.wire.hub.datagrams import VCAN_QUEUE_FRAMES


def read_count(fd: int, request: int) -> int:
    """Return what an ioctl that reads one int says of a descriptor [B]."""
    count = array("i", (0,))
    fcntl.ioctl(fd, request, count)
    return count[0]


@dataclass(frozen=True, slots=True)
class Peer:
    """One client as the hub sees it."""

    node: str
    pid: int
    queued: int  # frames that it has not read (an upper bound)
    dropped: int  # frames lost for it because its queue was full


class DatagramSizes(dict[int, int]):
    """Kernel memory that one unread datagram of so many bytes holds [B]; measured once per length."""

    def __init__(self) -> None:
        super().__init__()
        self._pair = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)

    def __missing__(self, length: int) -> int:
        self._pair[0].send(bytes(length))
        size = self[length] = read_count(self._pair[0].fileno(), termios.TIOCOUTQ)
        self._pair[1].recv(length)
        return size

    def close(self) -> None:
        for end in self._pair:
            end.close()


class Client:
    """The hub's book on one connection."""

    __slots__ = (
        "backlog", "bytes_waiting", "dropped", "fd", "filter", "flights", "kernel_bytes", "limit", "node", "passes_all",
        "pid", "queued", "receive_own", "reported", "sock",
    )  # fmt: skip

    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        self.fd = sock.fileno()
        self.pid: int = struct.unpack("3i", sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))[0]
        self.node = ""  # until it says hello
        self.bytes_waiting = array("i", (0,))  # for FIONREAD to fill
        self.filter = FrameFilter(None)
        self.passes_all = True
        self.receive_own = False
        self.limit = VCAN_QUEUE_FRAMES
        self.queued = 0  # frames not known to be read: in the kernel and in the backlog
        self.flights: deque[tuple[int, int]] = deque()  # (frames, memory [B]) of each datagram given to the kernel
        self.kernel_bytes = 0  # sum of the latter
        self.backlog: deque[bytearray] = deque()  # what the kernel would not take yet, in order
        self.dropped = 0
        self.reported = 0  # of these, told to the client

    def set_filters(self, filters: Sequence[Filter] | None) -> None:
        self.filter = FrameFilter(filters)
        self.passes_all = filters is None

    def settle(self) -> None:
        """Strike what the client has read off its queue."""
        held = read_count(self.fd, termios.TIOCOUTQ)
        flights = self.flights
        while flights and self.kernel_bytes > held:
            count, size = flights.popleft()
            self.kernel_bytes -= size
            self.queued -= count
