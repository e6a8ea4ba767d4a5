"""MAVLink 2 signing: what goes out is signed, what comes in is believed only when it is signed with the same key.

https://mavlink.io/en/guide/message_signing.html. A signature is checked before anything of its packet changes anything here;
the code that pymavlink generates stores the time of a stream first, so that a forged packet can shut a stream out.
"""

from __future__ import annotations

import hashlib
import hmac
import time
from collections.abc import Callable
from typing import Final

from bus.mavlink.packets import CRC_SIZE, SIGNATURE_SIZE, SIGNED, V2, V2_HEAD
from tools.ground.rewriting import put_checksum

EPOCH_S: Final = 1_420_070_400  # 2015-01-01 00:00 UTC
TICKS_PER_S: Final = 100_000  # of a signature's time, 10 us each
BEHIND: Final = 60 * TICKS_PER_S  # that a new stream may be
MOST_STREAMS: Final = 64
HASH_SIZE: Final = 6  # bytes of the hash that are sent


def _read_wall_clock() -> int:
    """Time of a signature now [10 us since 2015]."""
    return int((time.time() - EPOCH_S) * TICKS_PER_S)


class Signing:
    """Signs and checks with one key. Both share one clock that never goes back, as the protocol asks."""

    def __init__(self, key: bytes, link_id: int = 0, now: Callable[[], int] = _read_wall_clock) -> None:
        """now : what time it is [10 us since 2015-01-01 UTC]"""
        self._key = key
        self._link_id = link_id
        self._now = now
        self._last = 0  # the latest time that was sent or believed
        self._streams: dict[tuple[int, int, int], int] = {}  # link id, system, component -> its latest time

    def sign(self, packet: bytes, crc_extra: int) -> bytes:
        """Return a MAVLink 2 packet without a signature as one with it."""
        self._last = max(self._now(), self._last + 1)
        body = bytearray(packet)
        body[2] |= SIGNED
        put_checksum(body, crc_extra)
        body += bytes([self._link_id]) + self._last.to_bytes(6, "little")
        return bytes(body) + self._hash(body)

    def accept(self, packet: bytes) -> bool:
        """Return whether a packet is signed with the key at a time that its stream has not had."""
        if len(packet) < V2_HEAD + CRC_SIZE + SIGNATURE_SIZE or packet[0] != V2 or not packet[2] & SIGNED:
            return False
        if not hmac.compare_digest(self._hash(packet[:-HASH_SIZE]), bytes(packet[-HASH_SIZE:])):
            return False
        time_10us = int.from_bytes(packet[-12:-6], "little")
        stream = (packet[-13], packet[5], packet[6])
        latest = self._streams.get(stream)
        if latest is None:
            if len(self._streams) >= MOST_STREAMS or time_10us + BEHIND < max(self._now(), self._last):
                return False
        elif time_10us <= latest:
            return False
        self._streams[stream] = time_10us
        self._last = max(self._last, time_10us)
        return True

    def _hash(self, body: bytes | bytearray) -> bytes:
        return hashlib.sha256(self._key + body).digest()[:HASH_SIZE]
