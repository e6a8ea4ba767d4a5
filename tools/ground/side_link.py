"""The private socket beside one side of a bench: packets as they are, and what waits for room in the side's queue."""

from __future__ import annotations

import contextlib
import os
import socket
from collections import deque
from pathlib import Path
from typing import Final

from bus.errors import UsageError
from bus.mavlink.dialect import MAVLink_heartbeat_message
from bus.mavlink.endpoint import LARGEST
from bus.mavlink.packets import LinkCounters, Message, Packets
from bus.mavlink.words import AUTOPILOT_INVALID, GATEWAY_COMPONENT, GROUND_SYSTEM_ID, STATE_ACTIVE, TYPE_ONBOARD

AT_ONCE: Final = 64  # datagrams of a turn
OUTBOX: Final = 64  # messages that wait


class SideLink:
    """One side."""

    def __init__(self, directory: Path, side: str, path: str) -> None:
        """path : of the side's socket, which need not be there yet. Raises UsageError where no socket can be made."""
        self.side = side
        self.waiting: deque[bytes] = deque()
        self.counters = LinkCounters()
        self._to = path
        self._own = directory / f"gateway-{side}.sock"
        self._packets = Packets(GROUND_SYSTEM_ID, GATEWAY_COMPONENT, self.counters)
        self._sequence = 0
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)
        try:
            self._socket.bind(os.fspath(self._own))
            os.chmod(self._own, 0o600)
        except OSError as error:
            self._socket.close()
            raise UsageError(f"{self._own}: cannot make the gateway's socket: {error.strerror or error}") from None

    def put(self, packet: bytes) -> bool:
        """Queue a packet; False when there is no room."""
        if len(self.waiting) >= OUTBOX:
            return False
        self.waiting.append(packet)
        return True

    def flush(self) -> None:
        """Send what waits, as far as the side takes it. Where nobody is there, it is gone."""
        while self.waiting:
            try:
                self._socket.sendto(self.waiting[0], self._to)
            except BlockingIOError:
                return
            except OSError:
                self.counters.dropped += 1
            self.waiting.popleft()

    def greet(self) -> None:
        """Send the gateway's own heartbeat: the side streams to who sends one."""
        heartbeat = MAVLink_heartbeat_message(TYPE_ONBOARD, AUTOPILOT_INVALID, 0, 0, STATE_ACTIVE, 3)
        with contextlib.suppress(OSError):
            self._socket.sendto(self._packets.write(heartbeat, self._sequence), self._to)
            self._sequence = (self._sequence + 1) % 256

    def receive(self) -> list[Message]:
        """Return what the side has sent, of at most AT_ONCE datagrams."""
        found: list[Message] = []
        for _ in range(AT_ONCE):
            try:
                datagram, sender = self._socket.recvfrom(LARGEST)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:
                continue
            if sender == self._to:
                found += self._packets.read(datagram)
        return found

    def fileno(self) -> int:
        """Return a descriptor that is readable when `receive` has something."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close and remove the socket."""
        self._socket.close()
        with contextlib.suppress(OSError):
            self._own.unlink()
