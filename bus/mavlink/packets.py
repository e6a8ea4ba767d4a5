"""Datagrams to messages and back. Nothing that comes in raises: what is no message is counted by what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from bus.mavlink.dialect import MAVError, MAVLink, MAVLink_unknown

Message = Any  # one of the dialect's generated classes

V1, V2 = 0xFE, 0xFD
V1_HEAD, V2_HEAD, CRC_SIZE, SIGNATURE_SIZE = 6, 10, 2, 13
SIGNED: Final = 1


@dataclass(slots=True)
class LinkCounters:
    """What came over a link and what became of it, in packets (datagrams where it says so)."""

    received: int = 0  # good messages
    sent: int = 0
    garbage: int = 0  # datagrams that are not, or do not end as, MAVLink packets
    bad_checksum: int = 0  # or a length or flag that cannot be
    unknown: int = 0  # well formed as far as can be told, of a message that is not in the dialect
    version_1: int = 0  # MAVLink 1, taken all the same; part of received
    foreign: int = 0  # for another system or component
    bad_signature: int = 0  # unsigned, wrongly signed, or signed at a time that has been
    dropped: int = 0  # not sent: the receiver's queue was full


class Packets:
    """Reads and writes the packets of one component."""

    def __init__(self, system: int, component: int, counters: LinkCounters | None = None) -> None:
        self.counters = LinkCounters() if counters is None else counters
        self._protocol = MAVLink(None, system, component)

    def read(self, datagram: bytes) -> list[Message]:
        """Return the messages of a datagram; what is none is counted."""
        return self.read_some(datagram, len(datagram))[0]

    def read_some(self, datagram: bytes, most: int) -> tuple[list[Message], bytes, int]:
        """Return the messages of the first packets of a datagram, what stands behind them, and how many they were."""
        messages: list[Message] = []
        at = packets = 0
        while at < len(datagram) and packets < most:
            packets += 1
            size = _find_size(datagram, at)
            if size == 0 or at + size > len(datagram):
                self.counters.garbage += 1
                return messages, b"", packets
            message = self._decode(datagram[at : at + size])
            if message is not None:
                self.counters.received += 1
                messages.append(message)
            at += size
        return messages, datagram[at:], packets

    def write(self, message: Message, sequence: int) -> bytes:
        """Return the packet of a message with this sequence number, 0..255."""
        protocol = self._protocol
        protocol.seq = sequence
        packet: bytes = message.pack(protocol)
        return packet

    def _decode(self, packet: bytes) -> Message | None:
        counters = self.counters
        if packet[0] == V1:
            counters.version_1 += 1
        elif packet[2] & ~SIGNED:
            counters.bad_checksum += 1
            return None
        try:
            message = self._protocol.decode(bytearray(packet))
        except (MAVError, ValueError):  # ValueError: text that is none, where the generated code decodes it
            counters.bad_checksum += 1
            return None
        if isinstance(message, MAVLink_unknown):
            counters.unknown += 1
            return None
        return message


def _find_size(datagram: bytes, at: int) -> int:
    """Return how long the packet that begins here says it is; 0: none begins here."""
    left = len(datagram) - at
    if left < V1_HEAD + CRC_SIZE:
        return 0
    magic, length, flags = datagram[at : at + 3]
    if magic == V1:
        return V1_HEAD + length + CRC_SIZE
    if magic != V2:
        return 0
    return V2_HEAD + length + CRC_SIZE + (SIGNATURE_SIZE if flags & SIGNED else 0)


def text_of(value: str | bytes) -> str:
    """Return a text field as text, up to its end mark; what is not UTF-8 is shown escaped."""
    raw = value if isinstance(value, bytes) else value.encode("utf-8", "replace")
    return raw.split(b"\0", 1)[0].decode("utf-8", "backslashreplace")
