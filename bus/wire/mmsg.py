"""Many CAN frames with one system call: sendmmsg(2) and recvmmsg(2) over buffers that are laid out once.

Python's own socket methods cost one system call a frame. In user-mode Linux, where a system call costs 10 us and more,
that is most of a bus cycle.
"""

from __future__ import annotations

import ctypes
import errno
import socket
import struct

from bus.wire.frames import FRAME_SIZE

BURST = 64  # frames a call
FD_REST = 56  # what a CAN FD frame has beyond a classic one
SO_TIMESTAMPNS = 35  # asm-generic/socket.h; also the type of the control messages
SO_RXQ_OVFL = 40
STAMP_SPACE = socket.CMSG_SPACE(16)
CONTROL_SPACE = STAMP_SPACE + socket.CMSG_SPACE(4)
WAIT_FOR_ONE = 0x10000  # MSG_WAITFORONE: block for the first message only

_STAMP = struct.Struct(f"@{socket.CMSG_LEN(0)}xll{CONTROL_SPACE - socket.CMSG_LEN(16)}x")
_CONTROL_HEAD = struct.Struct("@Lii")
_U32 = struct.Struct("=I")


class IoVector(ctypes.Structure):
    """struct iovec."""

    _fields_ = (("base", ctypes.c_void_p), ("size", ctypes.c_size_t))


class MessageHead(ctypes.Structure):
    """struct msghdr."""

    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_size", ctypes.c_uint),
        ("pieces", ctypes.POINTER(IoVector)),
        ("piece_count", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_size", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class Message(ctypes.Structure):
    """struct mmsghdr."""

    _fields_ = (("head", MessageHead), ("size", ctypes.c_uint))


_SIZE = ctypes.sizeof(Message)
_GAP = Message.size.offset - MessageHead.control_size.offset - struct.calcsize("N")
_HEAD = struct.Struct(
    f"={MessageHead.control_size.offset}x{'Q' if struct.calcsize('N') == 8 else 'I'}{_GAP}xI"
    f"{_SIZE - Message.size.offset - 4}x"
)  # control_size, size
_USUAL = [(STAMP_SPACE, FRAME_SIZE)] * BURST  # a stamped classic frame, nothing dropped

_LIBC = ctypes.CDLL(None, use_errno=True)
_SENDMMSG = _LIBC.sendmmsg
_SENDMMSG.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int)
_RECVMMSG = _LIBC.recvmmsg
_RECVMMSG.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p)


class FrameSender:
    """Sends up to BURST frames a call."""

    def __init__(self) -> None:
        buffer = (ctypes.c_char * (BURST * FRAME_SIZE))()
        self._pieces = (IoVector * BURST)()
        self._messages = (Message * BURST)()
        start = ctypes.addressof(buffer)
        for index in range(BURST):
            self._pieces[index] = IoVector(start + index * FRAME_SIZE, FRAME_SIZE)
            self._messages[index].head.pieces = ctypes.pointer(self._pieces[index])
            self._messages[index].head.piece_count = 1
        self._view = memoryview(buffer).cast("B")
        self._address = ctypes.addressof(self._messages)

    def send(self, fd: int, batch: bytes) -> int:
        """Send the first frames of the batch; return how many were taken. Raises OSError when the first one was not."""
        size = min(len(batch), BURST * FRAME_SIZE)
        self._view[:size] = batch if size == len(batch) else batch[:size]
        while True:
            count: int = _SENDMMSG(fd, self._address, size // FRAME_SIZE, socket.MSG_DONTWAIT)
            if count >= 0:
                return count
            number = ctypes.get_errno()
            if number != errno.EINTR:
                raise OSError(number, errno.errorcode.get(number, "?"))


class FrameReceiver:
    """Receives up to BURST frames a call, with the kernel's stamps and drop count.

    After a call: `stamps_ns` per frame (0: not stamped), `dropped` since the socket was opened, `fd_frames` left out.
    """

    def __init__(self) -> None:
        frames = (ctypes.c_char * (BURST * FRAME_SIZE))()
        self._rest = (ctypes.c_char * FD_REST)()  # where all tails go: nobody reads them
        control = (ctypes.c_char * (BURST * CONTROL_SPACE))()
        self._pieces = (IoVector * (2 * BURST))()
        self._messages = (Message * BURST)()
        for index in range(BURST):
            self._pieces[2 * index] = IoVector(ctypes.addressof(frames) + index * FRAME_SIZE, FRAME_SIZE)
            self._pieces[2 * index + 1] = IoVector(ctypes.addressof(self._rest), FD_REST)
            message = self._messages[index].head
            message.pieces = ctypes.pointer(self._pieces[2 * index])
            message.piece_count = 2
            message.control = ctypes.addressof(control) + index * CONTROL_SPACE
            message.control_size = CONTROL_SPACE
        self._address = ctypes.addressof(self._messages)
        self._frames = memoryview(frames).cast("B")
        self._control = memoryview(control).cast("B")
        self._heads = memoryview(self._messages).cast("B")
        self._fresh = bytes(self._heads)  # the kernel overwrites the sizes
        self.stamps_ns: list[int] = []
        self.dropped = 0
        self.fd_frames = 0

    def receive(self, fd: int, flags: int) -> tuple[bytes, int]:
        """Return the classic frames of one call and how many messages it took, at least one. Raises OSError."""
        count: int = _RECVMMSG(fd, self._address, BURST, flags, None)
        if count < 0:
            number = ctypes.get_errno()
            raise OSError(number, errno.errorcode.get(number, "?"))
        heads = list(_HEAD.iter_unpack(self._heads[: count * _SIZE]))
        self._heads[: count * _SIZE] = self._fresh[: count * _SIZE]
        stamps = [s * 1_000_000_000 + ns for s, ns in _STAMP.iter_unpack(self._control[: count * CONTROL_SPACE])]
        batch = bytes(self._frames[: count * FRAME_SIZE])
        if heads != _USUAL[:count]:
            batch, stamps = self._sort_out(batch, stamps, heads)
        self.stamps_ns = stamps
        return batch, count

    def _sort_out(self, batch: bytes, stamps: list[int], heads: list[tuple[int, int]]) -> tuple[bytes, list[int]]:
        """Read control messages that are not the usual single stamp, and leave CAN FD frames out."""
        for index, (control_size, _) in enumerate(heads):
            if control_size != STAMP_SPACE:
                stamps[index] = self._read_control(index, control_size)
        classic = [index for index, (_, size) in enumerate(heads) if size == FRAME_SIZE]
        if len(classic) == len(heads):
            return batch, stamps
        self.fd_frames += len(heads) - len(classic)
        return (
            b"".join(batch[index * FRAME_SIZE : (index + 1) * FRAME_SIZE] for index in classic),
            [stamps[index] for index in classic],
        )

    def _read_control(self, index: int, size: int) -> int:
        """Take the drop count out of one frame's control messages and return its stamp [ns]."""
        stamp_ns = 0
        at = index * CONTROL_SPACE
        end = at + size
        while at + _CONTROL_HEAD.size <= end:
            length, _, kind = _CONTROL_HEAD.unpack_from(self._control, at)
            if length < _CONTROL_HEAD.size:
                break
            if kind == SO_TIMESTAMPNS:
                seconds, nanoseconds = struct.unpack_from("@ll", self._control, at + socket.CMSG_LEN(0))
                stamp_ns = seconds * 1_000_000_000 + nanoseconds
            elif kind == SO_RXQ_OVFL:
                self.dropped = _U32.unpack_from(self._control, at + socket.CMSG_LEN(0))[0]
            at += socket.CMSG_SPACE(length - socket.CMSG_LEN(0))
        return stamp_ns
