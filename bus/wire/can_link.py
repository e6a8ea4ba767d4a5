"""What the kernel says of a CAN interface: there or not, up or down, CAN or not, its bit rate."""

from __future__ import annotations

import difflib
import fcntl
import socket
import struct
from dataclasses import dataclass

from bus.errors import BusAddressError

# linux/if.h, if_arp.h, sockios.h
SIOCGIFFLAGS, SIOCGIFHWADDR = 0x8913, 0x8927
IFF_UP = 0x1
ARPHRD_CAN = 280
# linux/rtnetlink.h, if_link.h, can/netlink.h
RTM_NEWLINK, RTM_GETLINK, NLM_F_REQUEST = 16, 18, 1
IFLA_LINKINFO, IFLA_INFO_DATA, IFLA_CAN_BITTIMING = 18, 2, 1
NLA_TYPE_MASK = 0x3FFF


@dataclass(frozen=True, slots=True)
class CanLink:
    """One network interface as the kernel has it now."""

    name: str
    index: int
    is_can: bool
    is_up: bool
    bitrate_bps: int | None  # None: virtual, or not told


def find_link(name: str) -> CanLink | None:
    """Return the interface of this name in this network namespace; None when there is none."""
    try:
        index = socket.if_nametoindex(name)
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as any_socket:
            request = struct.pack("16s24x", name.encode())
            flags = struct.unpack_from("H", fcntl.ioctl(any_socket, SIOCGIFFLAGS, request), 16)[0]
            hardware = struct.unpack_from("H", fcntl.ioctl(any_socket, SIOCGIFHWADDR, request), 16)[0]
    except (OSError, ValueError):
        return None
    is_can = hardware == ARPHRD_CAN
    return CanLink(name, index, is_can, bool(flags & IFF_UP), ask_bitrate_bps(index) if is_can else None)


def list_can_links() -> list[str]:
    """Return the names of the CAN interfaces of this network namespace."""
    links = (find_link(name) for _, name in socket.if_nameindex())
    return sorted(link.name for link in links if link is not None and link.is_can)


def check_link(name: str, bitrate_bps: int) -> CanLink:
    """Return the interface if it can carry the bus. Raises BusAddressError: what is wrong with it and what to do."""
    if not kernel_has_can():
        raise BusAddressError(
            f"{name} is not there (this kernel has no CAN); use --bus hub: or run inside `hilsat vcan exec`"
        )
    link = find_link(name)
    if link is None:
        there = list_can_links()
        near = difflib.get_close_matches(name, there, 1, 0.6)
        hint = f"did you mean {near[0]}? " if near else ""
        listing = (
            f"there are: {', '.join(there)}" if there else "there is no CAN interface: make one with `hilsat vcan up`"
        )
        raise BusAddressError(f"{name} is not there; {hint}{listing}")
    if not link.is_can:
        raise BusAddressError(
            f"{name} is not a CAN interface; CAN interfaces here: {', '.join(list_can_links()) or 'none'}"
        )
    if not link.is_up:
        raise BusAddressError(f"{name} is down; bring it up as root: ip link set {name} up")
    if link.bitrate_bps is not None and link.bitrate_bps != bitrate_bps:
        raise BusAddressError(
            f"{name} runs at {link.bitrate_bps} bit/s, the bus is to run at {bitrate_bps} bit/s; as root:"
            f" ip link set {name} down && ip link set {name} up type can bitrate {bitrate_bps}"
        )
    return link


def kernel_has_can() -> bool:
    """Tell whether this kernel opens raw CAN sockets."""
    if not hasattr(socket, "AF_CAN"):
        return False
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return True


def ask_bitrate_bps(index: int) -> int | None:
    """Return the bit rate that an interface is set to [bit/s]; None for virtual ones, which have none."""
    request = struct.pack("=IHHII", 32, RTM_GETLINK, NLM_F_REQUEST, 1, 0) + struct.pack("=BxHiII", 0, 0, index, 0, 0)
    try:
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, 0) as route:
            route.settimeout(1.0)
            route.send(request)
            return read_bitrate_bps(route.recv(65536))
    except OSError:
        return None


def read_bitrate_bps(message: bytes) -> int | None:
    """Return the bit rate in an RTM_NEWLINK message [bit/s]; None when it has none."""
    if len(message) < 32 or struct.unpack_from("=H", message, 4)[0] != RTM_NEWLINK:
        return None
    payload: bytes | None = message[32:]
    for wanted in (IFLA_LINKINFO, IFLA_INFO_DATA, IFLA_CAN_BITTIMING):
        payload = _find_attribute(payload, wanted) if payload is not None else None
    if payload is None or len(payload) < 4:
        return None
    bitrate: int = struct.unpack_from("=I", payload)[0]
    return bitrate or None


def _find_attribute(data: bytes, wanted: int) -> bytes | None:
    at = 0
    while at + 4 <= len(data):
        length, kind = struct.unpack_from("=HH", data, at)
        if length < 4:
            return None
        if kind & NLA_TYPE_MASK == wanted:
            return data[at + 4 : at + length]
        at += (length + 3) & ~3
    return None
