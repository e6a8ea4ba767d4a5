"""A node on an embedded bus that another process carries."""

from __future__ import annotations

import contextlib
import fcntl
import select
import socket
import struct
import termios
import time
from array import array
from collections.abc import Sequence

from bus.errors import BusInUseError, BusLostError
from bus.wire.frames import FRAME_SIZE, READS_AT_ONCE, Filter, check_batch, count_error_frames
from bus.wire.hub.datagrams import MAX_DATAGRAM, VCAN_QUEUE_FRAMES, VERSION, cut_datagrams, pack_control, unpack_control
from bus.wire.hub.directory import HubDirectory, resolve_directory
from bus.wire.transport import DEFAULT_PATIENCE_S, TransportCounters

SEND_PATIENCE_S = 1.0  # a hub that has not taken a frame for so long is not taking this one either
COARSE_WAIT_S = 0.5  # from here on the kernel's own receive timeout is exact enough, and saves a system call
RETRY_S = 0.01
_SEND_FLAGS = socket.MSG_NOSIGNAL


class HubClient:
    """The transport of every program on a hub except its host.

    Raises BusLostError when no host appears within `patience_s`, BusInUseError when a node of this name is there
    already, BusAddressError when the directory is not private.
    """

    def __init__(
        self,
        where: str,
        node: str,
        filters: Sequence[Filter] | None = None,
        receive_own: bool = False,
        queue_frames: int = VCAN_QUEUE_FRAMES,
        patience_s: float = DEFAULT_PATIENCE_S,
    ) -> None:
        self.path = resolve_directory(where)
        self.address = f"hub:{self.path}"
        self.node = node
        self.counters = TransportCounters()
        self.kernel_stamps_ns: list[int] = []
        self.departed: list[str] = []
        self.host = ""  # node name of the host
        self._timeout_s: float | None = None  # as set on the socket
        self._bytes_waiting = array("i", (0,))  # for FIONREAD to fill
        self._early: list[bytes] = []  # frames that came before anybody asked
        deadline = time.monotonic() + patience_s
        self._sock = self._connect(deadline, patience_s)
        try:
            self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, pack_timeout(SEND_PATIENCE_S))
            self._introduce(filters, receive_own, queue_frames, deadline, patience_s)
        except BaseException:
            self._sock.close()
            raise
        self._fd = self._sock.fileno()

    def send(self, batch: bytes) -> None:
        """Put the frames on the bus, in order. Raises ValueError unless the batch is whole frames.

        Waits for a hub that is behind, up to SEND_PATIENCE_S; what it does not take by then is counted in tx_failed.
        """
        if len(batch) % FRAME_SIZE:
            check_batch(batch)
        for part in cut_datagrams(batch):
            self._send_part(part)

    def recv(self, timeout_s: float | None = None) -> bytes:
        """Return all frames waiting, at least one; b"" after `timeout_s` [s] or when a node has left."""
        if self._early:
            return self._drain(self._early)
        deadline = 0.0
        while True:
            datagram = self._receive(timeout_s)
            if not datagram:
                return b""
            if not len(datagram) % FRAME_SIZE:
                fcntl.ioctl(self._fd, termios.FIONREAD, self._bytes_waiting)
                if not self._bytes_waiting[0]:
                    counters = self.counters
                    counters.rx += len(datagram) // FRAME_SIZE
                    counters.error_frames += count_error_frames(datagram)
                    return datagram
                return self._drain([datagram])
            if self._obey(datagram):
                return b""
            if timeout_s:
                now = time.monotonic()
                deadline = deadline or now + timeout_s
                timeout_s = max(deadline - now, 0.0)

    def set_filters(self, filters: Sequence[Filter] | None) -> None:
        """Receive only what passes one of the (id, mask) pairs from now on; None: everything."""
        try:
            self._sock.send(pack_control(filters=None if filters is None else list(filters)), _SEND_FLAGS)
        except OSError:
            raise self._lost() from None

    def fileno(self) -> int:
        """Return a descriptor that is readable when recv() may have something."""
        return self._sock.fileno()

    def close(self) -> None:
        """Leave the bus."""
        self._sock.close()
        self._fd = -1

    def _send_part(self, batch: bytes) -> None:
        try:
            self._sock.send(batch, _SEND_FLAGS)
        except BlockingIOError:
            self.counters.tx_failed += len(batch) // FRAME_SIZE
        except OSError:
            raise self._lost() from None
        else:
            self.counters.tx += len(batch) // FRAME_SIZE

    def _receive(self, timeout_s: float | None) -> bytes:
        """Return the next datagram, b"" when none came in time. Raises BusLostError at the end of the connection."""
        flags = 0
        if timeout_s is None or timeout_s >= COARSE_WAIT_S:
            if timeout_s != self._timeout_s:
                self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, pack_timeout(timeout_s or 0.0))
                self._timeout_s = timeout_s
        else:
            flags = socket.MSG_DONTWAIT
            if self._fd < 0:
                raise self._lost()
            if timeout_s > 0.0 and not wait_readable(self._fd, timeout_s):
                return b""
        try:
            datagram = self._sock.recv(MAX_DATAGRAM + 1, flags)
        except BlockingIOError:
            return b""
        except OSError:  # reset: the host left with something of ours unread; what it sent may still be there
            try:
                datagram = self._sock.recv(MAX_DATAGRAM + 1, socket.MSG_DONTWAIT)
            except OSError:
                datagram = b""
        if not datagram:
            raise self._lost()
        return datagram

    def _drain(self, batches: list[bytes]) -> bytes:
        """Return the batches and all frames that wait behind them as one batch."""
        self._early = []
        with contextlib.suppress(BusLostError):  # the next call meets it again
            for _ in range(READS_AT_ONCE):
                datagram = self._receive(0.0)
                if not datagram:
                    break
                if not len(datagram) % FRAME_SIZE:
                    batches.append(datagram)
                else:
                    self._obey(datagram)
        batch = b"".join(batches)
        self.counters.rx += len(batch) // FRAME_SIZE
        self.counters.error_frames += count_error_frames(batch)
        return batch

    def _obey(self, datagram: bytes) -> bool:
        """Do what a control message of the hub says; True when it says that a node has left."""
        message = unpack_control(datagram) or {}
        if isinstance(message.get("dropped"), int):
            self.counters.dropped = message["dropped"]
        elif isinstance(message.get("gone"), str):
            self.departed.append(message["gone"])
            return True
        elif isinstance(message.get("refused"), str):
            raise BusInUseError(f"{self.address}: the hub refused {self.node}: {message['refused']}")
        elif isinstance(message.get("welcome"), dict):
            self.host = str(message["welcome"].get("node"))
        else:
            self.counters.malformed += 1
        return False

    def _connect(self, deadline: float, patience_s: float) -> socket.socket:
        while True:
            with contextlib.suppress(FileNotFoundError):
                directory = HubDirectory(self.path)
                sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                try:
                    sock.connect(directory.socket_path)
                except (FileNotFoundError, ConnectionRefusedError):
                    sock.close()
                except OSError as error:
                    sock.close()
                    raise BusLostError(f"{self.address} cannot be entered: {error.strerror}") from None
                else:
                    return sock
                finally:
                    directory.release()
            if time.monotonic() >= deadline:
                raise BusLostError(
                    f"{self.address} has no host: none appeared within {patience_s:g} s;"
                    f" start the program that carries the bus (the plant) on this address first"
                )
            time.sleep(RETRY_S)

    def _introduce(
        self, filters: Sequence[Filter] | None, receive_own: bool, queue_frames: int, deadline: float, patience_s: float
    ) -> None:
        """Say hello and wait for the answer. From the welcome on, nothing on the bus is missed."""
        hello = {
            "version": VERSION,
            "node": self.node,
            "receive_own": receive_own,
            "queue_frames": queue_frames,
            "filters": None if filters is None else list(filters),
        }
        self._fd = self._sock.fileno()
        with contextlib.suppress(OSError):  # a hub that hung up has perhaps said why
            self._sock.send(pack_control(hello=hello), _SEND_FLAGS)
        while not self.host:
            left_s = deadline - time.monotonic()
            datagram = self._receive(left_s) if left_s > 0.0 else b""
            if not datagram:
                raise BusLostError(
                    f"{self.address}: the host did not answer {self.node} within {patience_s:g} s;"
                    f" it hangs, or it does not serve the bus while it starts"
                )
            if len(datagram) % FRAME_SIZE:
                self._obey(datagram)
            else:
                self._early.append(datagram)

    def _lost(self) -> BusLostError:
        if self._sock.fileno() < 0:
            return BusLostError(f"{self.address}: {self.node} has left this bus")
        return BusLostError(f"{self.address}: the host of the bus{f' ({self.host})' if self.host else ''} has gone")


def pack_timeout(timeout_s: float) -> bytes:
    """Return a struct timeval; zero means no limit."""
    seconds = int(timeout_s)
    return struct.pack("@ll", seconds, max(int((timeout_s - seconds) * 1e6), 0 if seconds or not timeout_s else 1))


def wait_readable(fd: int, timeout_s: float) -> bool:
    """Wait until the descriptor is readable, to the microsecond where select can be used; False after `timeout_s`."""
    if fd < 1024:
        return bool(select.select((fd,), (), (), timeout_s)[0])
    poll = select.poll()
    poll.register(fd, select.POLLIN)
    return bool(poll.poll(timeout_s * 1e3))
