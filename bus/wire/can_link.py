"""Whether a CAN interface can carry the bus: there or not, up or down, CAN or not, its bit rate."""

from __future__ import annotations

import socket

from bus.errors import BusAddressError
from bus.wire.rtnetlink import Link, list_links
from bus.words import suggest


def find_link(name: str) -> Link | None:
    """Return the interface of this name in this network namespace; None when there is none or the kernel does not say."""
    try:
        return next((link for link in list_links() if link.name == name), None)
    except OSError:
        return None


def list_can_links() -> list[str]:
    """Return the names of the CAN interfaces of this network namespace."""
    try:
        return sorted(link.name for link in list_links() if link.is_can)
    except OSError:
        return []


def check_link(name: str, bitrate_bps: int) -> Link:
    """Return the interface if it can carry the bus. Raises BusAddressError: what is wrong with it and what to do."""
    if not kernel_has_can():
        raise BusAddressError(
            f"{name} is not there (this kernel has no CAN); use --bus hub: or run inside `hilsat vcan exec`"
        )
    link = find_link(name)
    if link is None:
        there = list_can_links()
        hint = suggest(name, there)
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
