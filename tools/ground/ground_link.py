"""A link to ground stations: who is there, which messages are believed, and how many of them get through."""

from __future__ import annotations

import socket
import time
from typing import Final

from bus.mavlink.endpoint import LARGEST
from bus.mavlink.packets import LinkCounters, Message, Packets
from bus.mavlink.words import GATEWAY_COMPONENT, GROUND_SYSTEM_ID
from tools.ground.links import HOST, LinkAddress
from tools.ground.signing import Signing

AT_ONCE: Final = 64  # datagrams of one socket in a turn
RATE_HZ: Final = 200.0  # messages from one link to the sides
BURST: Final = 100.0
PEERS: Final = 8  # ground stations of a link that waits; the one not heard for longest makes room


class GroundLink:
    """One link to ground stations: its socket, who is there, and what came of what came."""

    def __init__(self, address: LinkAddress, opened: socket.socket) -> None:
        self.address = address
        self.socket = opened
        self.counters = LinkCounters()
        self.waits = address.way == "udpin"
        self.peers: dict[tuple[str, int], None] = {} if self.waits else {(HOST, address.port): None}
        self._packets = Packets(GROUND_SYSTEM_ID, GATEWAY_COMPONENT, self.counters)
        self._allowed = BURST
        self._seen_s = time.monotonic()

    def receive(self, signing: Signing | None) -> list[Message]:
        """Return the messages of at most AT_ONCE datagrams that are to be believed and that there is room for."""
        found: list[Message] = []
        self._refill()
        for _ in range(AT_ONCE):
            try:
                datagram, sender = self.socket.recvfrom(LARGEST)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:  # a datagram of ours met nobody
                continue
            if not self.waits and sender not in self.peers:
                self.counters.foreign += 1
                continue
            believed = self._believe(self._packets.read(datagram), signing)
            if believed and self.waits:
                self._note_peer(sender)
            found += believed
        return found

    def _believe(self, messages: list[Message], signing: Signing | None) -> list[Message]:
        """Return the messages that are signed as they must be; of them those that the rate allows."""
        believed = []
        for message in messages:
            if signing is not None and not signing.accept(bytes(message.get_msgbuf())):
                self.counters.bad_signature += 1
                self.counters.received -= 1
            elif self._allowed < 1.0:
                self.counters.dropped += 1
            else:
                self._allowed -= 1.0
                believed.append(message)
        return believed

    def _refill(self) -> None:
        now_s = time.monotonic()
        self._allowed = min(BURST, self._allowed + (now_s - self._seen_s) * RATE_HZ)
        self._seen_s = now_s

    def _note_peer(self, sender: tuple[str, int]) -> None:
        self.peers.pop(sender, None)
        self.peers[sender] = None
        if len(self.peers) > PEERS:
            del self.peers[next(iter(self.peers))]

    def send(self, packet: bytes) -> None:
        """Send a packet to everyone who is there."""
        for peer in self.peers:
            try:
                self.socket.sendto(packet, peer)
                self.counters.sent += 1
            except OSError:
                self.counters.dropped += 1
