"""The node that carries the embedded bus inside its own program."""

from __future__ import annotations

import time
from collections.abc import Sequence

from bus.errors import BusLostError
from bus.wire.frames import FRAME_SIZE, Filter, check_batch, drop_malformed
from bus.wire.hub.datagrams import VCAN_QUEUE_FRAMES, cut_datagrams
from bus.wire.hub.hub import Hub
from bus.wire.hub.member import Peer
from bus.wire.inbox import Inbox
from bus.wire.transport import TransportCounters

SENDS_PER_PUMP = 16  # a host that only sends still serves its clients this often


class HubHost:
    """The transport of the program that carries the bus: to every client it is one hop.

    The hub is served inside recv() and send(). A host that computes for long without either leaves the others waiting.
    """

    def __init__(
        self,
        where: str,
        node: str,
        filters: Sequence[Filter] | None = None,
        receive_own: bool = False,
        queue_frames: int = VCAN_QUEUE_FRAMES,
    ) -> None:
        self.counters = TransportCounters()
        self._inbox = Inbox(filters, queue_frames, self.counters)
        self._hub = Hub(where, node, self._inbox.put)
        self.address = self._hub.address
        self.node = node
        self.kernel_stamps_ns: list[int] = []
        self.departed = self._hub.departed
        self._receive_own = receive_own
        self._sends = 0
        self._closed = False

    def peers(self) -> tuple[Peer, ...]:
        """Return the clients that are on the bus."""
        return self._hub.peers()

    def serve(self, timeout_s: float | None = 0.0) -> None:
        """Serve the clients without taking frames: for a host that is busy with something else for long."""
        self._hub.pump(timeout_s)

    def send(self, batch: bytes) -> None:
        """Put the frames on the bus, in order. Never waits. Raises ValueError unless the batch is whole frames."""
        if len(batch) % FRAME_SIZE:
            check_batch(batch)
        if self._closed:
            raise BusLostError(f"{self.address}: {self.node} has left this bus")
        self._sends += 1
        if self._sends >= SENDS_PER_PUMP:
            self._sends = 0
            self._hub.pump(0.0)
        for part in cut_datagrams(batch):
            self._send_part(part)

    def recv(self, timeout_s: float | None = None) -> bytes:
        """Return all frames waiting, at least one; b"" after `timeout_s` [s] or when a node has left."""
        if self._closed:
            raise BusLostError(f"{self.address}: {self.node} has left this bus")
        hub = self._hub
        self._sends = 0
        departures = len(self.departed)
        if self._inbox:
            hub.pump(0.0)
        elif timeout_s is None:
            while not self._inbox and len(self.departed) == departures:
                hub.pump(None)
        else:
            started = time.monotonic()
            hub.pump(timeout_s)
            while not self._inbox and len(self.departed) == departures:
                left_s = started + timeout_s - time.monotonic()
                if left_s <= 0.0:
                    break
                hub.pump(left_s)
        self.counters.malformed = hub.malformed
        return self._inbox.take()

    def set_filters(self, filters: Sequence[Filter] | None) -> None:
        """Receive only what passes one of the (id, mask) pairs from now on; None: everything."""
        self._inbox.set_filters(filters)

    def fileno(self) -> int:
        """Return a descriptor that is readable when a client wants something: not always a frame."""
        return self._hub.fileno()

    def close(self) -> None:
        """End the bus for everybody on it."""
        self._closed = True
        self._hub.close()

    def _send_part(self, batch: bytes) -> None:
        count = self._hub.route(batch, None)
        self.counters.tx += count
        if self._receive_own and count:
            self._inbox.put(drop_malformed(batch), count)
