"""python-can's interface "hilsat": other people's tools on our buses, with one of our addresses as its channel.

can_logger -i hilsat -c hub:/tmp/bench
"""

from __future__ import annotations

import itertools
import os
import sys
import time
from collections import deque
from collections.abc import Sequence
from typing import Any

import can

from bus.errors import BusLostError, HilsatError
from bus.wire.address import open_transport
from bus.wire.frames import EFF_FLAG, ERR_FLAG, Filter, FrameFilter, unpack_batch
from bus.wire.python_can import pack_message, unpack_message
from bus.wire.transport import DEFAULT_BITRATE_BPS, DEFAULT_PATIENCE_S, DEFAULT_QUEUE_FRAMES

_serial = itertools.count(1)


class HilsatBus(can.BusABC):
    """python-can interface "hilsat": one more node on one of our buses.

    channel              : address, as bus.wire.address has it
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
        from bus.wire.hub.datagrams import SOCKET_NAME
        from bus.wire.hub.directory import default_directory

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
