"""One way to open a bus and move batches of frames over it, whatever carries them.

An address is `<transport>:<where>`:

    memory:<name>           in this process
    hub:<dir>               embedded bus, several processes of one user, no privileges; empty: a default directory
    socketcan:<interface>   a CAN interface of this kernel (can0, vcan0)
    <interface>:<channel>   anything python-can drives: pcan:PCAN_USBBUS1, kvaser:0, slcan:/dev/ttyACM0, virtual:x;
                            further settings as in a URL: gs_usb:0?index=1
    python-can:<interface>:<channel>   the same, said outright: python-can:socketcan:can0 is python-can's driver, not ours
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from bus.errors import BusAddressError
from bus.frames import Filter

DEFAULT_QUEUE_FRAMES = 4096  # what a node of ours asks for: 3 s of its bus at 100 Hz
DEFAULT_BITRATE_BPS = 500_000
DEFAULT_PATIENCE_S = 5.0
BUILT_IN = ("memory", "hub", "socketcan")
EXPLICIT = "python-can"


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


def open_transport(
    address: str,
    *,
    node: str,
    host: bool = False,
    filters: Sequence[Filter] | None = None,
    receive_own: bool = False,
    bitrate_bps: int = DEFAULT_BITRATE_BPS,
    queue_frames: int = DEFAULT_QUEUE_FRAMES,
    patience_s: float = DEFAULT_PATIENCE_S,
) -> Transport:
    """Return an open attachment to the bus at `address`.

    node         : this program's name on the bus; where the transport can tell, it must be the only one of that name
    host         : this program carries the bus (hub:) or owns it (memory:); elsewhere without meaning
    filters      : (id, mask) pairs as CAN_RAW_FILTER has them; None: everything
    receive_own  : what this node sends comes back to it, in its place in the order of the bus
    bitrate_bps  : of a real adapter [bit/s]; a kernel interface set to another one is refused
    queue_frames : frames kept for this node until it reads; what comes after that is dropped and counted
    patience_s   : how long a hub: client waits for its host [s]

    Raises BusAddressError (no such transport, or not on this machine), BusInUseError (the bus already has a host, or
    a node of this name), BusLostError (nobody carries the bus).
    """
    scheme, colon, where = address.partition(":")
    if not colon:
        raise BusAddressError(describe_unknown(address, scheme, python_can_interfaces()))
    if queue_frames < 1:
        raise ValueError(f"queue_frames is {queue_frames}; a node needs a queue of at least 1 frame")
    if scheme == "memory":
        from bus.memory import MemoryTransport

        return MemoryTransport(where, node, host, filters, receive_own, queue_frames)
    if scheme == "hub":
        if host:
            from bus.hub_host import HubHost

            return HubHost(where, node, filters, receive_own, queue_frames)
        from bus.hub_client import HubClient

        return HubClient(where, node, filters, receive_own, queue_frames, patience_s)
    if scheme == "socketcan":
        from bus.socketcan import SocketCanTransport

        return SocketCanTransport(where, node, filters, receive_own, queue_frames, bitrate_bps)
    if scheme == EXPLICIT:
        from bus.pycan import PyCanTransport

        return PyCanTransport(where, node, filters, receive_own, bitrate_bps)
    if scheme not in python_can_interfaces():
        raise BusAddressError(describe_unknown(address, scheme, python_can_interfaces()))
    from bus.pycan import PyCanTransport

    return PyCanTransport(address, node, filters, receive_own, bitrate_bps)


def python_can_interfaces() -> frozenset[str]:
    """Return the names of the interfaces that python-can can drive and we do not, sorted; empty without python-can."""
    try:
        from can.interfaces import VALID_INTERFACES
    except ImportError:
        return frozenset()
    return frozenset(VALID_INTERFACES) - {*BUILT_IN, "hilsat"}


def describe_unknown(address: str, scheme: str, interfaces: frozenset[str]) -> str:
    """Return the message for an address that names no transport: what there is, and what was perhaps meant."""
    known = [*BUILT_IN, EXPLICIT, *sorted(interfaces)]
    if ":" not in address:
        meant = f"socketcan:{address}" if "can" in address else f"hub:{address}" if "/" in address else ""
    else:
        near = difflib.get_close_matches(scheme, known, 1, 0.6)
        meant = near[0] + address[len(scheme) :] if near else ""
    if scheme in known:
        meant = f"{scheme}:<where>"
    ours = "memory:<name>, hub:<dir>, socketcan:<interface>"
    rest = f"; through python-can <interface>:<channel> with {', '.join(sorted(interfaces))}" if interfaces else ""
    hint = f"; did you mean {meant}?" if meant else "."
    return f'bus address "{address}" names no transport{hint} There are: {ours}{rest}'
