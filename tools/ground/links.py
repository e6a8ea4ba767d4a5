"""Links to ground stations: their addresses as people write them, and their sockets. Nothing leaves this machine."""

from __future__ import annotations

import socket
from dataclasses import dataclass
from typing import Final

from bus.errors import UsageError
from bus.words import describe, suggest

HOST: Final = "127.0.0.1"
WAYS: Final = ("udp", "udpin")
HELP: Final = "udp:PORT sends to a ground station that listens there, udpin:PORT waits there for whoever comes"


@dataclass(frozen=True, slots=True)
class LinkAddress:
    """One link: `udp` speaks to a port, `udpin` waits on one. The host is always 127.0.0.1."""

    way: str
    port: int

    def __str__(self) -> str:
        return f"{self.way}:{self.port}"

    def open(self) -> socket.socket:
        """Return its socket, bound. Raises UsageError when the port is taken."""
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)
        try:
            opened.bind((HOST, self.port if self.way == "udpin" else 0))
        except OSError as error:
            opened.close()
            raise UsageError(
                f"{self}: cannot wait on {HOST} port {self.port}: {error.strerror or error}; name another port"
            ) from None
        return opened


def parse_link(text: str) -> LinkAddress:
    """Return the address that a text stands for. Raises UsageError."""
    way, colon, rest = text.partition(":")
    host, _, number = rest.rpartition(":")
    if not colon or way not in WAYS:
        raise UsageError(f"{describe(text)} is no MAVLink address; {suggest(way, WAYS)}{HELP}")
    if host not in ("", HOST, "localhost"):
        raise UsageError(
            f"{describe(text)}: {host} is another machine; the gateway speaks to {HOST} alone; write {way}:PORT, and "
            "carry it further with a tunnel such as ssh or mavlink-router"
        )
    if not number.isascii() or not number.isdecimal() or not 0 < int(number[:6]) < 65536:
        raise UsageError(f"{describe(text)}: {number or 'nothing'} is no port; give 1 to 65535, such as {way}:14550")
    return LinkAddress(way, int(number))
