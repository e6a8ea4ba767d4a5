"""A transport over any interface that python-can drives, and python-can's messages as frames."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any
from urllib.parse import parse_qsl

import can

from bus.errors import BusAddressError, BusLostError
from bus.wire.frames import (
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
from bus.wire.transport import DEFAULT_BITRATE_BPS, TransportCounters


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
