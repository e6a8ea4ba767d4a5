"""What passes between a hub and its clients beside frames.

A datagram of whole frames is traffic. A datagram of 16 n + 8 bytes is a control message: four bytes of mark, then one
JSON object, padded with blanks. Anything else is garbage, and the receiver counts it.

    client to hub: {"hello": {"version", "node", "receive_own", "queue_frames", "filters"}}  once, first
                   {"filters": [[id, mask], ...] | null}
    hub to client: {"welcome": {"node": name of the host}}, or {"refused": why} and the end
                   {"dropped": frames lost so far for this client}   before the next frames, like SO_RXQ_OVFL
                   {"gone": name of a node that left}
"""

from __future__ import annotations

import json
from typing import Any

from bus.wire.frames import FRAME_SIZE, Filter

VERSION = 1
MARK = b"\xffHil"
MAX_BATCH_FRAMES = 1024
MAX_DATAGRAM = MAX_BATCH_FRAMES * FRAME_SIZE  # longer ones are garbage
VCAN_QUEUE_FRAMES = 278  # what a socket on vcan holds with the kernel's default receive buffer
MAX_QUEUE_FRAMES = 1 << 20
MAX_FILTERS = 512  # CAN_RAW_FILTER_MAX
SOCKET_NAME = "hub.sock"


def cut_datagrams(batch: bytes) -> tuple[bytes, ...]:
    """Return the batch in pieces that a datagram may hold; none of an empty one."""
    if len(batch) <= MAX_DATAGRAM:
        return (batch,) if batch else ()
    return tuple(batch[at : at + MAX_DATAGRAM] for at in range(0, len(batch), MAX_DATAGRAM))


def pack_control(**message: Any) -> bytes:
    """Return the datagram of one control message."""
    datagram = MARK + json.dumps(message, separators=(",", ":")).encode()
    return datagram + b" " * ((FRAME_SIZE // 2 - len(datagram)) % FRAME_SIZE)


def unpack_control(datagram: bytes) -> dict[str, Any] | None:
    """Return the control message in a datagram; None when it holds none."""
    if len(datagram) % FRAME_SIZE != FRAME_SIZE // 2 or not datagram.startswith(MARK):
        return None
    try:
        message = json.loads(datagram[len(MARK) :])
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) else None


def read_filters(value: Any) -> tuple[Filter, ...] | None:
    """Return the filters of a control message. Raises ValueError when they are not a list of (id, mask) or null."""
    if value is None:
        return None
    if not isinstance(value, list) or len(value) > MAX_FILTERS:
        raise ValueError(f"filters are at most {MAX_FILTERS} pairs of id and mask")
    filters = []
    for pair in value:
        if not isinstance(pair, list) or len(pair) != 2 or not all(type(v) is int and 0 <= v < 1 << 32 for v in pair):
            raise ValueError("a filter is a pair of 32-bit numbers, id and mask")
        filters.append((pair[0], pair[1]))
    return tuple(filters)
