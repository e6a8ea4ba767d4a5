"""Network interfaces over rtnetlink: listed, made, removed and switched without the `ip` program.

Message layouts: linux/rtnetlink.h, linux/if_link.h; rtnetlink(7), netlink(7).
"""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

NLMSG_ERROR, NLMSG_DONE = 2, 3
RTM_NEWLINK, RTM_DELLINK, RTM_GETLINK = 16, 17, 18
NLM_F_REQUEST, NLM_F_ACK, NLM_F_EXCL, NLM_F_CREATE, NLM_F_DUMP = 0x1, 0x4, 0x200, 0x400, 0x300
IFLA_IFNAME, IFLA_MTU, IFLA_LINKINFO, IFLA_INFO_KIND = 3, 4, 18, 1
IFF_UP = 1
ARPHRD_CAN = 280
HEADER = struct.Struct("=IHHII")
LINK = struct.Struct("=BxHiII")
ATTRIBUTE = struct.Struct("=HH")
RECEIVE_BYTES = 1 << 18


@dataclass(frozen=True, slots=True)
class Link:
    """One network interface. `kind` is the driver's rtnl name ("vcan", "vxcan", "can"), empty for most others."""

    index: int
    name: str
    kind: str
    mtu: int
    is_can: bool
    is_up: bool


def list_links() -> list[Link]:
    """Return every interface of this network namespace, by index. Needs no privilege. Raises OSError."""
    request = LINK.pack(socket.AF_UNSPEC, 0, 0, 0, 0)
    return sorted(
        (parse_link(body) for body in exchange(RTM_GETLINK, NLM_F_DUMP, request)), key=lambda link: link.index
    )


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


def start_network(can: Sequence[str]) -> None:
    """Furnish a fresh network namespace: loopback and the named vcan interfaces up, raw CAN sockets. Raises OSError."""
    switch_link("lo", up=True)
    for name in can:
        add_vcan(name)
    socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()


def run_command(message_type: int, flags: int, body: bytes) -> None:
    for _ in exchange(message_type, NLM_F_ACK | flags, body):
        pass


def exchange(message_type: int, flags: int, body: bytes) -> Iterator[bytes]:
    """Send one request and yield the bodies of the answers until the kernel says it is done. Raises OSError."""
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as sock:
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
        yield message_type, data[HEADER.size : length]
        data = data[align(length) :]


def parse_link(body: bytes) -> Link:
    """Return the interface that an RTM_NEWLINK body describes."""
    _, hardware, index, flags, _ = LINK.unpack_from(body)
    found = dict(split_attributes(body[LINK.size :]))
    info = dict(split_attributes(found.get(IFLA_LINKINFO, b"")))
    return Link(
        index=index,
        name=os.fsdecode(found.get(IFLA_IFNAME, b"").rstrip(b"\0")),
        kind=os.fsdecode(info.get(IFLA_INFO_KIND, b"").rstrip(b"\0")),
        mtu=int.from_bytes(found.get(IFLA_MTU, b"\0"), "little"),
        is_can=hardware == ARPHRD_CAN,
        is_up=bool(flags & IFF_UP),
    )


def split_attributes(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield (type, value) of each attribute."""
    while len(data) >= ATTRIBUTE.size:
        length, kind = ATTRIBUTE.unpack_from(data)
        if length < ATTRIBUTE.size:
            return
        yield kind & 0x3FFF, data[ATTRIBUTE.size : length]
        data = data[align(length) :]


def pack_attribute(kind: int, value: bytes) -> bytes:
    """Return the attribute in wire form, padded to four bytes."""
    length = ATTRIBUTE.size + len(value)
    return ATTRIBUTE.pack(length, kind) + value + bytes(align(length) - length)


def align(length: int) -> int:
    return (length + 3) & ~3
