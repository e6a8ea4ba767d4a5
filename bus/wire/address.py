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

from collections.abc import Sequence

from bus.errors import BusAddressError
from bus.wire.frames import Filter
from bus.wire.transport import DEFAULT_BITRATE_BPS, DEFAULT_PATIENCE_S, DEFAULT_QUEUE_FRAMES, Transport
from bus.words import nearest

BUILT_IN = ("memory", "hub", "socketcan")
EXPLICIT = "python-can"


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
        from bus.wire.memory import MemoryTransport

        return MemoryTransport(where, node, host, filters, receive_own, queue_frames)
    if scheme == "hub":
        if host:
            from bus.wire.hub.host import HubHost

            return HubHost(where, node, filters, receive_own, queue_frames)
        from bus.wire.hub.client import HubClient

        return HubClient(where, node, filters, receive_own, queue_frames, patience_s)
    if scheme == "socketcan":
        from bus.wire.socketcan import SocketCanTransport

        return SocketCanTransport(where, node, filters, receive_own, queue_frames, bitrate_bps)
    if scheme == EXPLICIT:
        from bus.wire.python_can import PyCanTransport

        return PyCanTransport(where, node, filters, receive_own, bitrate_bps)
    if scheme not in python_can_interfaces():
        raise BusAddressError(describe_unknown(address, scheme, python_can_interfaces()))
    from bus.wire.python_can import PyCanTransport

    return PyCanTransport(address, node, filters, receive_own, bitrate_bps)


def may_carry_error_frames(address: str) -> bool:
    """Return whether simulated error frames may be put on a bus: on none with an adapter, which reports its own."""
    scheme, _, where = address.partition(":")
    return scheme in ("hub", "memory") or (scheme == "socketcan" and where.startswith("vcan"))


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
        near = nearest(scheme, known)
        meant = near + address[len(scheme) :] if near else ""
    if scheme in known:
        meant = f"{scheme}:<where>"
    ours = "memory:<name>, hub:<dir>, socketcan:<interface>"
    rest = f"; through python-can <interface>:<channel> with {', '.join(sorted(interfaces))}" if interfaces else ""
    hint = f"; did you mean {meant}?" if meant else "."
    return f'bus address "{address}" names no transport{hint} There are: {ours}{rest}'
