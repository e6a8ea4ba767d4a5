"""Network interfaces over rtnetlink: listed, made, removed and switched without the `ip` program.

Message layouts: linux/rtnetlink.h, linux/if_link.h, linux/can/netlink.h; rtnetlink(7), netlink(7).
"""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass

NLMSG_ERROR, NLMSG_DONE = 2, 3
RTM_NEWLINK, RTM_DELLINK, RTM_GETLINK = 16, 17, 18
NLM_F_REQUEST, NLM_F_ACK, NLM_F_EXCL, NLM_F_CREATE, NLM_F_DUMP = 0x1, 0x4, 0x200, 0x400, 0x300
IFLA_IFNAME, IFLA_MTU, IFLA_LINKINFO = 3, 4, 18
IFLA_INFO_KIND, IFLA_INFO_DATA, IFLA_CAN_BITTIMING = 1, 2, 1
NLA_TYPE_MASK = 0x3FFF
IFF_UP = 1
ARPHRD_CAN = 280
HEADER = struct.Struct("=IHHII")
LINK = struct.Struct("=BxHiII")
ATTRIBUTE = struct.Struct("=HH")
WORD = struct.Struct("=I")
RECEIVE_BYTES = 1 << 18
PATIENCE_S = 1.0  # the kernel answers at once


@dataclass(frozen=True, slots=True)
class Link:
    """One network interface. `kind` is the driver's rtnl name ("vcan", "vxcan", "can"), empty for most others.

    bitrate_bps : None for one that is virtual, or that the driver does not tell
    """

    index: int
    name: str
    kind: str
    mtu: int
    is_can: bool
    is_up: bool
    bitrate_bps: int | None = None


def list_links() -> list[Link]:
    """Return every interface of this network namespace, by index. Needs no privilege. Raises OSError."""
    request = LINK.pack(socket.AF_UNSPEC, 0, 0, 0, 0)
    bodies = exchange(RTM_GETLINK, NLM_F_DUMP, request)
    return sorted((parse_link(body) for body in bodies if len(body) >= LINK.size), key=lambda link: link.index)


def add_vcan(name: str) -> None:
    """Make the vcan interface `name` and switch it on. Raises OSError (EPERM, EEXIST; EOPNOTSUPP: no vcan driver)."""
    kind = pack_attribute(IFLA_INFO_KIND, b"vcan")
    body = LINK.pack(socket.AF_UNSPEC, 0, 0, IFF_UP, IFF_UP)
    body += pack_attribute(IFLA_IFNAME, os.fsencode(name) + b"\0") + pack_attribute(IFLA_LINKINFO, kind)
    run_command(RTM_NEWLINK, NLM_F_CREATE | NLM_F_EXCL, body)


def delete_link(name: str) -> None:
    """Remove the interface `name`. Raises OSError."""
    run_command(RTM_DELLINK, 0, LINK.pack(socket.AF_UNSPEC, 0, socket.if_nametoindex(name), 0, 0))


def switch_link(name: str, *, up: bool) -> None:
    """Switch the interface `name` on or off. Raises OSError."""
    flags = IFF_UP if up else 0
    run_command(RTM_NEWLINK, 0, LINK.pack(socket.AF_UNSPEC, 0, socket.if_nametoindex(name), flags, IFF_UP))


def run_command(message_type: int, flags: int, body: bytes) -> None:
    """Send one request and wait until the kernel has done it. Raises OSError."""
    for _ in exchange(message_type, NLM_F_ACK | flags, body):
        pass


def exchange(message_type: int, flags: int, body: bytes) -> Iterator[bytes]:
    """Send one request and yield the bodies of the answers until the kernel says it is done. Raises OSError."""
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as sock:
        sock.settimeout(PATIENCE_S)
        sock.bind((0, 0))
        sock.send(HEADER.pack(HEADER.size + len(body), message_type, NLM_F_REQUEST | flags, 1, 0) + body)
        while True:
            for answer_type, answer in split_messages(sock.recv(RECEIVE_BYTES)):
                if answer_type == NLMSG_DONE:
                    return
                if answer_type == NLMSG_ERROR:
                    (error,) = struct.unpack_from("=i", answer)
                    if error:
                        raise OSError(-error, os.strerror(-error))
                    return
                yield answer


def split_messages(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield (type, body) of each message of a datagram."""
    while len(data) >= HEADER.size:
        length, message_type, _, _, _ = HEADER.unpack_from(data)
        if length < HEADER.size:
            return
        yield message_type, data[HEADER.size : length]
        data = data[align(length) :]


def parse_link(body: bytes) -> Link:
    """Return the interface that an RTM_NEWLINK body describes."""
    _, hardware, index, flags, _ = LINK.unpack_from(body)
    found = dict(split_attributes(body[LINK.size :]))
    info = dict(split_attributes(found.get(IFLA_LINKINFO, b"")))
    timing = dict(split_attributes(info.get(IFLA_INFO_DATA, b""))).get(IFLA_CAN_BITTIMING, b"")
    is_can = hardware == ARPHRD_CAN
    return Link(
        index=index,
        name=os.fsdecode(found.get(IFLA_IFNAME, b"").rstrip(b"\0")),
        kind=os.fsdecode(info.get(IFLA_INFO_KIND, b"").rstrip(b"\0")),
        mtu=int.from_bytes(found.get(IFLA_MTU, b"\0"), "little"),
        is_can=is_can,
        is_up=bool(flags & IFF_UP),
        bitrate_bps=(WORD.unpack_from(timing)[0] or None) if is_can and len(timing) >= WORD.size else None,
    )


def split_attributes(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield (type, value) of each attribute."""
    while len(data) >= ATTRIBUTE.size:
        length, kind = ATTRIBUTE.unpack_from(data)
        if length < ATTRIBUTE.size:
            return
        yield kind & NLA_TYPE_MASK, data[ATTRIBUTE.size : length]
        data = data[align(length) :]


def pack_attribute(kind: int, value: bytes) -> bytes:
    """Return the attribute in wire form, padded to four bytes."""
    length = ATTRIBUTE.size + len(value)
    return ATTRIBUTE.pack(length, kind) + value + bytes(align(length) - length)


def align(length: int) -> int:
    """The length rounded up to whole words [bytes]."""
    return (length + 3) & ~3
