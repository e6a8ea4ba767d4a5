"""A node on a CAN interface of this kernel, through a raw AF_CAN socket. Options: linux/can/raw.h."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import struct
from collections.abc import Sequence

from bus.errors import BusAddressError, BusInUseError, BusLostError
from bus.wire.can_link import check_link
from bus.wire.frames import FRAME_SIZE, READS_AT_ONCE, Filter, check_batch, count_error_frames, drop_malformed
from bus.wire.hub.client import COARSE_WAIT_S, pack_timeout, wait_readable
from bus.wire.mmsg import BURST, SO_RXQ_OVFL, SO_TIMESTAMPNS, WAIT_FOR_ONE, FrameReceiver, FrameSender
from bus.wire.transport import DEFAULT_BITRATE_BPS, DEFAULT_QUEUE_FRAMES, TransportCounters

# asm-generic/socket.h, linux/can/raw.h; Python names only some of them
SO_RCVBUFFORCE = 33
SOL_CAN_RAW = 101
CAN_RAW_FILTER, CAN_RAW_ERR_FILTER, CAN_RAW_RECV_OWN_MSGS, CAN_RAW_FD_FRAMES = 1, 2, 4, 5
CAN_ERR_MASK = 0x1FFFFFFF
SKB_BYTES = 768  # receive buffer that one queued frame holds

_BUSY = (errno.ENOBUFS, errno.EAGAIN)


class SocketCanTransport:
    """One raw CAN socket. `send()` counts what the interface will not take; it raises only when the interface is gone.

    queue_frames : what the socket really got; without CAP_NET_ADMIN the kernel caps it at net.core.rmem_max
    Raises BusAddressError (not there, down, not CAN, another bit rate), BusInUseError (a node of this name is there).
    """

    def __init__(
        self,
        interface: str,
        node: str,
        filters: Sequence[Filter] | None = None,
        receive_own: bool = False,
        queue_frames: int = DEFAULT_QUEUE_FRAMES,
        bitrate_bps: int = DEFAULT_BITRATE_BPS,
    ) -> None:
        self.address = f"socketcan:{interface}"
        self.interface = interface
        self.node = node
        self.counters = TransportCounters()
        self.kernel_stamps_ns: list[int] = []
        self.departed: list[str] = []  # a CAN bus does not tell
        self._sender = FrameSender()
        self._receiver = FrameReceiver()
        self._timeout_s: float | None = None  # as set on the socket
        self._failure: OSError | None = None  # met behind frames, for the next recv()
        check_link(interface, bitrate_bps)
        self._claim = claim_name(self.address, node)
        self._sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self._fd = self._sock.fileno()
        try:
            self.queue_frames = size_queue(self._sock, queue_frames)
            self._sock.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
            self._sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            self._sock.setsockopt(SOL_CAN_RAW, CAN_RAW_ERR_FILTER, CAN_ERR_MASK)
            self._sock.setsockopt(SOL_CAN_RAW, CAN_RAW_RECV_OWN_MSGS, int(receive_own))
            with contextlib.suppress(OSError):  # kernels before 3.6 have no CAN FD to count
                self._sock.setsockopt(SOL_CAN_RAW, CAN_RAW_FD_FRAMES, 1)
            self.set_filters(filters)
            self._sock.bind((interface,))
        except OSError as error:
            self.close()
            raise BusAddressError(f"{self.address} cannot be opened: {error.strerror}") from None

    def send(self, batch: bytes) -> None:
        """Put the frames on the bus, in order, with one system call for up to 64 of them."""
        check_batch(batch)
        counters = self.counters
        sound = drop_malformed(batch)
        if sound is not batch:
            counters.malformed += (len(batch) - len(sound)) // FRAME_SIZE
        while sound:
            try:
                taken = self._sender.send(self._fd, sound)
                counters.tx += taken
            except OSError as error:
                if error.errno not in _BUSY:
                    raise self._lost(error) from None
                taken = 1  # the first of them; the next ones may find room
                counters.tx_failed += 1
            sound = sound[taken * FRAME_SIZE :]

    def recv(self, timeout_s: float | None = None) -> bytes:
        """Return all frames waiting, at least one; b"" after `timeout_s` [s]. CAN FD frames are only counted."""
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise self._lost(failure)
        batch = b""
        while not batch:
            flags = int(socket.MSG_DONTWAIT)
            if timeout_s is None or timeout_s >= COARSE_WAIT_S:
                flags = WAIT_FOR_ONE
                if timeout_s != self._timeout_s:
                    self._set_timeout(timeout_s)
            elif timeout_s > 0.0 and self._fd >= 0 and not wait_readable(self._fd, timeout_s):
                return b""
            batch = self._collect(flags)
            if not batch and timeout_s is not None:  # nothing, or CAN FD frames only
                return b""
        counters = self.counters
        counters.rx += len(batch) // FRAME_SIZE
        counters.error_frames += count_error_frames(batch)
        return batch

    def set_filters(self, filters: Sequence[Filter] | None) -> None:
        """Receive only what passes one of the (id, mask) pairs from now on; None: everything."""
        pairs = [(0, 0)] if filters is None else filters
        packed = b"".join(struct.pack("=II", can_id, mask) for can_id, mask in pairs)
        self._sock.setsockopt(SOL_CAN_RAW, CAN_RAW_FILTER, packed)

    def fileno(self) -> int:
        """Return the socket's descriptor."""
        return self._sock.fileno()

    def close(self) -> None:
        """Leave the bus."""
        self._fd = -1
        self._sock.close()
        self._claim.close()

    def _collect(self, flags: int) -> bytes:
        """Return the classic frames that wait in the socket; note their stamps, the drop count and CAN FD frames."""
        receiver = self._receiver
        batches: list[bytes] = []
        stamps: list[int] = []
        for _ in range(READS_AT_ONCE // BURST):
            try:
                batch, count = receiver.receive(self._fd, flags)
            except OSError as error:
                if error.errno in (errno.EAGAIN, errno.EINTR):
                    break
                if not batches:
                    raise self._lost(error) from None
                self._failure = error
                break
            flags = socket.MSG_DONTWAIT
            batches.append(batch)
            stamps += receiver.stamps_ns
            if count < BURST:
                break
        self.kernel_stamps_ns = stamps
        self.counters.dropped = receiver.dropped
        self.counters.fd_frames = receiver.fd_frames
        return b"".join(batches)

    def _set_timeout(self, timeout_s: float | None) -> None:
        with contextlib.suppress(OSError):  # a closed socket is told by the read that follows
            self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, pack_timeout(timeout_s or 0.0))
            self._timeout_s = timeout_s

    def _lost(self, error: OSError) -> BusLostError:
        if self._sock.fileno() < 0:
            return BusLostError(f"{self.address}: {self.node} has left this bus")
        reasons = {
            errno.ENETDOWN: "the interface went down",
            errno.ENODEV: "the interface was taken away",
            errno.ENXIO: "the interface was taken away",
        }
        return BusLostError(
            f"{self.address}: {reasons.get(error.errno or 0) or os.strerror(error.errno or 0)} under {self.node}"
        )


def claim_name(address: str, node: str) -> socket.socket:
    """Return a socket that holds this node's name on this interface until it is closed or its process ends.

    The name is an abstract AF_UNIX address: like the interface, it belongs to the network namespace, and nothing is
    left behind. Raises BusInUseError when another process holds it.
    """
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind(f"\0hilsat/{address}/{node}")
    except OSError:
        claim.close()
        raise BusInUseError(
            f"{address} already has a {node}: another bench runs on it; end that run, or use another interface"
        ) from None
    return claim


def size_queue(sock: socket.socket, frames: int) -> int:
    """Give the socket a receive buffer for so many frames, and return for how many it really has one."""
    wanted = frames * SKB_BYTES // 2  # the kernel doubles it
    try:
        sock.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, wanted)
    except OSError:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, wanted)
    return sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // SKB_BYTES
