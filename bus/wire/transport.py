"""What every transport is: frames in, frames out, and a count of what happened to them. `bus.wire.address` opens one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from bus.wire.frames import Filter

DEFAULT_QUEUE_FRAMES = 4096  # what a node of ours asks for: 3 s of its bus at 100 Hz
DEFAULT_BITRATE_BPS = 500_000
DEFAULT_PATIENCE_S = 5.0


@dataclass(slots=True)
class TransportCounters:
    """What happened on one attachment to a bus, in frames."""

    tx: int = 0
    rx: int = 0
    dropped: int = 0  # meant for this node and lost, because its queue was full
    tx_failed: int = 0  # given to send() and not sent, because the bus would not take them
    error_frames: int = 0  # received, and part of rx
    fd_frames: int = 0  # CAN FD frames met and left out
    malformed: int = 0  # datagrams or frames refused because they were none

    @property
    def lossy(self) -> bool:
        """True when a frame did not get through."""
        return self.dropped > 0 or self.tx_failed > 0

    def describe(self) -> str:
        """What was lost, in words."""
        return (
            f"{self.dropped} frames were lost in the receive buffer, {self.tx_failed} could not be sent "
            f"({self.rx} received, {self.tx} sent)"
        )


class Transport(Protocol):
    """One attachment to a bus. For use from one thread at a time."""

    address: str
    node: str
    counters: TransportCounters
    kernel_stamps_ns: list[int]  # CLOCK_REALTIME per frame of the last recv(), where the kernel stamps; else empty
    departed: list[str]  # names of the nodes seen to leave, where the transport can tell

    def send(self, batch: bytes) -> None:
        """Put the frames on the bus, in order. Never waits for a reader; what does not fit is counted in tx_failed.

        Raises ValueError unless the batch is whole frames, BusLostError when the bus is gone.
        """
        ...

    def recv(self, timeout_s: float | None = None) -> bytes:
        """Return all frames waiting, at least one; b"" after `timeout_s` [s] (None: no limit).

        On a bus that never falls silent it ends after READS_AT_ONCE reads.

        Also b"", before the time, when a node was seen to leave: see `departed`. Error frames are among the frames.
        Raises BusLostError when the bus is gone.
        """
        ...

    def set_filters(self, filters: Sequence[Filter] | None) -> None:
        """Receive only what passes one of the (id, mask) pairs from now on; None: everything."""
        ...

    def fileno(self) -> int:
        """Return a descriptor that is readable when recv() may have something."""
        ...

    def close(self) -> None:
        """Leave the bus. May be repeated."""
        ...
