"""The bus inside one process, `memory:<name>`. Order, filters and queues as on the others; threads may share it."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Sequence

from bus.errors import BusInUseError, BusLostError
from bus.wire.frames import FRAME_SIZE, Filter, check_batch, drop_malformed
from bus.wire.inbox import Inbox
from bus.wire.transport import TransportCounters

_buses: dict[str, MemoryBus] = {}
_buses_lock = threading.Lock()


class MemoryBus:
    """The nodes of one name, and the lock that makes their order one."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.lock = threading.Lock()
        self.nodes: list[MemoryTransport] = []
        self.lost = False  # its owner left


class MemoryTransport:
    """One node on a memory bus. `host=True` owns it: when the owner leaves, the bus is lost for the others."""

    def __init__(
        self,
        name: str,
        node: str,
        host: bool = False,
        filters: Sequence[Filter] | None = None,
        receive_own: bool = False,
        queue_frames: int = 4096,
    ) -> None:
        self.address = f"memory:{name}"
        self.node = node
        self.counters = TransportCounters()
        self.kernel_stamps_ns: list[int] = []
        self.departed: list[str] = []
        self.host = host
        self._inbox = Inbox(filters, queue_frames, self.counters)
        self._receive_own = receive_own
        self._woken = False  # somebody left: recv() returns early
        self._event_fd = -1
        self._closed = False
        self._bus = self._join(name)
        self._ready = threading.Condition(self._bus.lock)
        self._waiting = False

    def send(self, batch: bytes) -> None:
        """Put the frames on the bus, in order. Raises ValueError unless the batch is whole frames."""
        count = check_batch(batch)
        if self._closed:
            raise BusLostError(f"{self.address}: {self.node} has left this bus")
        sound = drop_malformed(batch)
        if sound is not batch:
            count = len(sound) // FRAME_SIZE
            self.counters.malformed += (len(batch) - len(sound)) // FRAME_SIZE
        if not count:
            return
        with self._bus.lock:
            if self._bus.lost:
                raise self._lost()
            for node in self._bus.nodes:
                if node is not self or self._receive_own:
                    node._accept(sound, count)
        self.counters.tx += count

    def recv(self, timeout_s: float | None = None) -> bytes:
        """Return all frames waiting, at least one; b"" after `timeout_s` [s] or when a node has left."""
        with self._bus.lock:
            if not self._inbox:
                self._wait(timeout_s)
            if not self._inbox:
                self._woken = False
                self._clear_event()
                if self._bus.lost or self._closed:
                    raise self._lost()
                return b""
            batch = self._inbox.take()
            self._clear_event()
        return batch

    def set_filters(self, filters: Sequence[Filter] | None) -> None:
        """Receive only what passes one of the (id, mask) pairs from now on; None: everything."""
        self._inbox.set_filters(filters)

    def fileno(self) -> int:
        """Return a descriptor that is readable while frames wait. Made at the first call: sending then costs more."""
        with self._bus.lock:
            if self._event_fd < 0:
                self._event_fd = os.eventfd(1 if self._inbox else 0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
            return self._event_fd

    def close(self) -> None:
        """Leave the bus."""
        with _buses_lock, self._bus.lock:
            if self._closed:
                return
            self._closed = True
            bus = self._bus
            bus.nodes.remove(self)
            bus.lost = bus.lost or self.host
            if (bus.lost or not bus.nodes) and _buses.get(bus.name) is bus:
                del _buses[bus.name]
            for node in (*bus.nodes, self):
                node.departed.extend([self.node] if node is not self else [])
                node._woken = True
                node._signal()
            if self._event_fd >= 0:
                os.close(self._event_fd)
                self._event_fd = -1

    def _join(self, name: str) -> MemoryBus:
        with _buses_lock:
            bus = _buses.setdefault(name, MemoryBus(name))
            with bus.lock:
                for other in bus.nodes:
                    if other.node == self.node or (other.host and self.host):
                        raise BusInUseError(
                            f"{self.address}: {other.node} is already {'the host' if self.host else 'a node'} of this"
                            f" bus; {self.node} needs another name or another bus"
                        )
                bus.nodes.append(self)
            return bus

    def _wait(self, timeout_s: float | None) -> None:
        if timeout_s == 0.0:
            return
        self._waiting = True
        try:
            self._ready.wait_for(lambda: self._inbox or self._woken or self._bus.lost or self._closed, timeout_s)
        finally:
            self._waiting = False

    def _accept(self, batch: bytes, count: int) -> None:
        if self._inbox.put(batch, count) and (self._waiting or self._event_fd >= 0):
            self._signal()

    def _signal(self) -> None:
        if self._event_fd >= 0:
            os.eventfd_write(self._event_fd, 1)
        if self._waiting:
            self._ready.notify_all()

    def _clear_event(self) -> None:
        if self._event_fd >= 0:
            with contextlib.suppress(BlockingIOError):
                os.eventfd_read(self._event_fd)

    def _lost(self) -> BusLostError:
        if self._closed:
            return BusLostError(f"{self.address}: {self.node} has left this bus")
        return BusLostError(f"{self.address}: the host of the bus left; {self.node} cannot go on")
