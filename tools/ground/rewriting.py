"""Packets as bytes: given another number, sender or addressee, and a checksum to match."""

from __future__ import annotations

from bus.mavlink.dialect import MAVLink, mavlink_map, x25crc
from bus.mavlink.packets import CRC_SIZE, V1, V1_HEAD, V2_HEAD, Message

SEQUENCE_AT, SYSTEM_AT, COMPONENT_AT = 4, 5, 6  # in a MAVLink 2 head


def crc_extra_of(message: Message) -> int:
    """Return what a message's kind adds to its checksum."""
    return int(mavlink_map[message.get_msgId()].crc_extra)


def put_checksum(packet: bytearray, crc_extra: int) -> None:
    """Make the checksum of a MAVLink 2 packet without a signature right."""
    crc = x25crc(bytes(packet[1:-CRC_SIZE]) + bytes([crc_extra])).crc
    packet[-CRC_SIZE:] = crc.to_bytes(2, "little")


def renumber(message: Message, sequence: int, component: int) -> bytes:
    """Return a message's packet as it came, but for its number and the component that it is from, and unsigned."""
    packet = bytearray(message.get_msgbuf())
    if packet[0] == V1:
        packet = bytearray(_modernise(message, packet))
    packet = packet[: V2_HEAD + packet[1] + CRC_SIZE]
    packet[2] = 0
    packet[SEQUENCE_AT], packet[COMPONENT_AT] = sequence, component
    put_checksum(packet, crc_extra_of(message))
    return bytes(packet)


def readdress(message: Message, component: int) -> bytes:
    """Return a message that has a target component as a packet to another one, from the same sender, unsigned."""
    protocol = MAVLink(None, message.get_srcSystem(), message.get_srcComponent())
    protocol.seq = message.get_seq()
    message.target_component = component
    packet: bytes = message.pack(protocol)
    return packet


def _modernise(message: Message, packet: bytearray) -> bytes:
    """A MAVLink 1 packet as one of MAVLink 2, checksum left open."""
    number = int(message.get_msgId())
    head = bytes([0xFD, packet[1], 0, 0, packet[2], packet[3], packet[4]]) + number.to_bytes(3, "little")
    return head + bytes(packet[V1_HEAD:-CRC_SIZE]) + b"\0\0"
