"""python-can on both sides of the bench: their tools on our buses, and their interfaces under our transports.

`HilsatBus` is python-can's interface "hilsat", with one of our addresses as its channel:

    can_logger -i hilsat -c hub:/tmp/bench

`PyCanTransport` is a transport over any interface that python-can drives.
"""

from __future__ import annotations

import itertools
import os
import sys
import time
from collections import deque
from collections.abc import Sequence
from typing import Any
from urllib.parse import parse_qsl

import can

from bus.errors import BusAddressError, BusLostError, HilsatError
from bus.frames import (
    EFF_FLAG,
    EFF_MASK,
    ERR_FLAG,
    FRAME,
    FRAME_SIZE,
    READS_AT_ONCE,
    RTR_FLAG,
    SFF_MASK,
    Filter,
    FrameFilter,
    check_batch,
    count_error_frames,
    drop_malformed,
    unpack_batch,
)  # fmt: skip
from bus.transport import (
    DEFAULT_BITRATE_BPS,
    DEFAULT_PATIENCE_S,
    DEFAULT_QUEUE_FRAMES,
    TransportCounters,
    open_transport,
)

_serial = itertools.count(1)


def pack_message(message: can.Message) -> bytes:
    """Return the 16-byte frame of a python-can message. Raises ValueError for what classic CAN cannot carry."""
    if message.is_fd:
        raise ValueError(f"frame {message.arbitration_id:#x}: CAN FD frames do not fit a classic CAN bus")
    limit = EFF_MASK if message.is_extended_id or message.is_error_frame else SFF_MASK
    if not 0 <= message.arbitration_id <= limit or not 0 <= message.dlc <= 8:
        raise ValueError(f"frame {message.arbitration_id:#x}, dlc {message.dlc}: ids are 0 to {limit:#x}, dlc 0 to 8")
    can_id = message.arbitration_id
    if message.is_error_frame:
        can_id |= ERR_FLAG
    else:
        can_id |= (EFF_FLAG if message.is_extended_id else 0) | (RTR_FLAG if message.is_remote_frame else 0)
    return FRAME.pack(can_id, message.dlc, bytes(message.data))


def unpack_message(can_id: int, dlc: int, data: bytes, timestamp_s: float, channel: str | None = None) -> can.Message:
    """Return the python-can message of one frame. timestamp_s: seconds since 1970, as python-can has it."""
    remote = bool(can_id & RTR_FLAG) and not can_id & ERR_FLAG
    return can.Message(
        timestamp=timestamp_s,
        arbitration_id=can_id & (EFF_MASK if can_id & (EFF_FLAG | ERR_FLAG) else SFF_MASK),
        is_extended_id=bool(can_id & EFF_FLAG),
        is_remote_frame=remote,
        is_error_frame=bool(can_id & ERR_FLAG),
        dlc=dlc,
        data=None if remote else data[:dlc],
        channel=channel,
    )


class HilsatBus(can.BusABC):
    """python-can interface "hilsat": one more node on one of our buses.

    channel              : address, as bus.transport has it
    receive_own_messages : what this bus sends comes back to it
    node                 : name on the bus; by default made of the program's name and process id
    host                 : this program carries the hub
    bitrate              : [bit/s], of a real adapter
    queue_frames         : kept until they are read; what comes after is dropped (`transport.counters.dropped`)
    patience_s           : how long to wait for the host of a hub [s]
    Raises can.CanInitializationError where a transport raises BusAddressError, BusInUseError or BusLostError.
    """

    def __init__(
        self,
        channel: Any = None,
        can_filters: Any = None,
        *,
        receive_own_messages: bool = False,
        node: str | None = None,
        host: bool = False,
        bitrate: int = DEFAULT_BITRATE_BPS,
        queue_frames: int = DEFAULT_QUEUE_FRAMES,
        patience_s: float = DEFAULT_PATIENCE_S,
        fd: bool = False,
        **kwargs: Any,
    ) -> None:
        if fd:
            raise can.CanInitializationError("the hilsat interface is classic CAN; leave fd out")
        program = os.path.basename(sys.argv[0] if sys.argv and sys.argv[0] else "python")[:40]
        try:
            self.transport = open_transport(
                str(channel or "hub:"),
                node=node or f"{program}-{os.getpid()}-{next(_serial)}",
                host=host,
                filters=pack_filters(can_filters),
                receive_own=receive_own_messages,
                bitrate_bps=int(bitrate),
                queue_frames=int(queue_frames),
                patience_s=float(patience_s),
            )
        except HilsatError as error:
            raise can.CanInitializationError(str(error)) from error
        self.channel_info = f"hilsat {self.transport.address}"
        self._waiting: deque[can.Message] = deque()
        super().__init__(channel, can_filters, **kwargs)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Put one message on the bus. Raises can.CanOperationError when the bus would not take it or is gone."""
        failed = self.transport.counters.tx_failed
        try:
            self.transport.send(pack_message(msg))
        except (BusLostError, ValueError) as error:
            raise can.CanOperationError(str(error)) from error
        if self.transport.counters.tx_failed != failed:
            raise can.CanOperationError(f"{self.transport.address} is busy and did not take the frame")

    def fileno(self) -> int:
        """Return a descriptor to wait on. Raises NotImplementedError where the interface below has none.

        Read until recv(0) returns None before waiting on it: one wake-up may stand for many messages.
        """
        descriptor = self.transport.fileno()
        if descriptor < 0:
            raise NotImplementedError(f"{self.transport.address} has no descriptor")
        return descriptor

    def shutdown(self) -> None:
        """Leave the bus."""
        super().shutdown()
        if hasattr(self, "transport"):
            self.transport.close()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._waiting:
            try:
                batch = self.transport.recv(timeout)
            except BusLostError as error:
                raise can.CanOperationError(str(error)) from error
            now_s = time.time()
            stamps_ns = self.transport.kernel_stamps_ns
            for index, (can_id, dlc, data) in enumerate(unpack_batch(batch)):
                stamp_s = stamps_ns[index] / 1e9 if index < len(stamps_ns) else now_s
                self._waiting.append(unpack_message(can_id, dlc, data, stamp_s, self.transport.address))
        return (self._waiting.popleft() if self._waiting else None), True

    def _apply_filters(self, filters: Any) -> None:
        self.transport.set_filters(pack_filters(filters))
        accepted = FrameFilter(pack_filters(filters))
        self._waiting = deque(message for message in self._waiting if accepted.select(pack_message(message)))

    @staticmethod
    def _detect_available_configs() -> Sequence[Any]:
        from bus.hub_directory import default_directory
        from bus.hub_wire import SOCKET_NAME

        there = (default_directory() / SOCKET_NAME).exists()
        return [{"interface": "hilsat", "channel": "hub:"}] if there else []


def pack_filters(filters: Any) -> list[Filter] | None:
    """Return python-can's filters (None or empty: everything) as (id, mask) pairs."""
    if not filters:
        return None
    pairs = []
    for rule in filters:
        can_id, mask = rule["can_id"], rule["can_mask"]
        if "extended" in rule:
            mask |= EFF_FLAG
            can_id |= EFF_FLAG if rule["extended"] else 0
        pairs.append((can_id & ~ERR_FLAG, mask & ~ERR_FLAG))
    return pairs


class PyCanTransport:
    """A transport over one python-can interface. The user's python-can configuration files are not read.

    Drops are where the driver keeps them: `counters.dropped` stays 0. Raises BusAddressError when python-can cannot
    open it.
    """

    def __init__(
        self,
        address: str,
        node: str,
        filters: Sequence[Filter] | None = None,
        receive_own: bool = False,
        bitrate_bps: int = DEFAULT_BITRATE_BPS,
    ) -> None:
        interface, _, where = address.partition(":")
        channel, _, query = where.partition("?")
        settings: dict[str, Any] = {key: read_setting(value) for key, value in parse_qsl(query)}
        self.address = address
        self.node = node
        self.counters = TransportCounters()
        self.kernel_stamps_ns: list[int] = []
        self.departed: list[str] = []
        self._filter = FrameFilter(filters)
        self._closed = False
        try:
            self._bus: can.BusABC = can.Bus(
                interface=interface,
                channel=channel or None,
                ignore_config=True,
                bitrate=bitrate_bps,
                receive_own_messages=receive_own,
                **settings,
            )
        except Exception as error:  # a driver without its library ends in anything, NameError included
            raise BusAddressError(f"{address} cannot be opened by python-can: {error}") from error

    def send(self, batch: bytes) -> None:
        """Put the frames on the bus, in order. Raises ValueError unless the batch is whole frames."""
        check_batch(batch)
        if self._closed:
            raise BusLostError(f"{self.address}: {self.node} has left this bus")
        counters = self.counters
        sound = drop_malformed(batch)
        counters.malformed += (len(batch) - len(sound)) // FRAME_SIZE
        for can_id, dlc, data in unpack_batch(sound):
            try:
                self._bus.send(unpack_message(can_id, dlc, data, 0.0))
            except (can.CanError, OSError):
                counters.tx_failed += 1
            else:
                counters.tx += 1

    def recv(self, timeout_s: float | None = None) -> bytes:
        """Return all frames waiting, at least one; b"" after `timeout_s` [s]. CAN FD frames are only counted."""
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            batch = self._filter.select(self._collect(timeout_s))
            if batch:
                self.counters.rx += len(batch) // FRAME_SIZE
                self.counters.error_frames += count_error_frames(batch)
                return batch
            if deadline is not None:
                timeout_s = deadline - time.monotonic()
                if timeout_s <= 0.0:
                    return b""

    def set_filters(self, filters: Sequence[Filter] | None) -> None:
        """Receive only what passes one of the (id, mask) pairs from now on; None: everything."""
        self._filter = FrameFilter(filters)

    def fileno(self) -> int:
        """Return the interface's descriptor; -1 where it has none."""
        try:
            return self._bus.fileno()
        except NotImplementedError:
            return -1

    def close(self) -> None:
        """Leave the bus."""
        if not self._closed:
            self._closed = True
            self._bus.shutdown()

    def _collect(self, timeout_s: float | None) -> bytes:
        if self._closed:
            raise BusLostError(f"{self.address}: {self.node} has left this bus")
        frames = []
        try:
            for _ in range(READS_AT_ONCE):
                message = self._bus.recv(timeout_s)
                if message is None:
                    break
                timeout_s = 0.0
                if message.is_fd:
                    self.counters.fd_frames += 1
                else:
                    frames.append(pack_message(message))
        except ValueError:
            self.counters.malformed += 1
        except (can.CanError, OSError) as error:
            if not frames:
                raise BusLostError(f"{self.address}: {error}") from error
        return b"".join(frames)


def read_setting(text: str) -> int | bool | str:
    """Return a setting of an address as python-can wants it: a number, a truth value or the text."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    try:
        return int(text, 0)
    except ValueError:
        return text
