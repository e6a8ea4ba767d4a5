"""JSON texts longer than a packet: cut into HILSAT_REQUEST and HILSAT_REPLY messages, and put together again.

A request is an object with a key `do`; its replies are objects with a key `state`, the last one with `final` true.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, Final

from bus.mavlink.dialect import MAVLink_hilsat_reply_message, MAVLink_hilsat_request_message
from bus.mavlink.packets import Message

PART_SIZE: Final = 230
MOST_PARTS: Final = 255
PENDING: Final = 16  # texts that wait for parts; the oldest is forgotten for another


def cut_request(what: dict[str, Any], token: int, system: int, component: int) -> list[Message]:
    """Return the messages of a request. Raises ValueError for one that is too long."""
    return _cut(
        what, lambda i, n, size, part: MAVLink_hilsat_request_message(token, system, component, i, n, size, part)
    )


def cut_reply(what: dict[str, Any], token: int, number: int, system: int, component: int) -> list[Message]:
    """Return the messages of a reply, the number-th of its request. Raises ValueError for one that is too long."""
    return _cut(
        what,
        lambda i, n, size, part: MAVLink_hilsat_reply_message(token, number, system, component, i, n, size, part),
    )


def _cut(what: dict[str, Any], make: Callable[[int, int, int, list[int]], Message]) -> list[Message]:
    text = json.dumps(what, separators=(",", ":"), allow_nan=False).encode()
    count = max(1, -(-len(text) // PART_SIZE))
    if count > MOST_PARTS:
        raise ValueError(f"{len(text)} bytes do not fit into {MOST_PARTS} messages")
    parts = [text[i * PART_SIZE : (i + 1) * PART_SIZE] for i in range(count)]
    return [make(i, count, len(part), list(part.ljust(PART_SIZE, b"\0"))) for i, part in enumerate(parts)]


class Assembler:
    """Puts parts together, each text by its sender, token and number."""

    def __init__(self) -> None:
        self._pending: dict[tuple[Any, ...], list[bytes | None]] = {}

    def add(self, message: Message, sender: str = "") -> dict[str, Any] | None:
        """Return the object once its last part is here, None before that and for what is no JSON object."""
        number = getattr(message, "reply", -1)
        key = (sender, message.get_srcSystem(), message.get_srcComponent(), message.token, number, message.parts)
        if not 0 <= message.part < message.parts or message.length > PART_SIZE:
            return None
        parts = self._pending.setdefault(key, [None] * message.parts)
        parts[message.part] = bytes(message.text[: message.length])
        if any(part is None for part in parts):
            if len(self._pending) > PENDING:
                del self._pending[next(iter(self._pending))]
            return None
        del self._pending[key]
        try:
            what = json.loads(b"".join([part or b"" for part in parts]))
        except (ValueError, RecursionError):
            return None
        return what if isinstance(what, dict) else None
