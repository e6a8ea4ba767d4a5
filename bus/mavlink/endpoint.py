"""A Unix datagram socket that speaks MAVLink packets: private to who can enter its directory, and never waited for.

Every reader is somebody's loop: `poll` takes at most so many datagrams and returns, `send` drops what does not fit, and both
count. Who talks to an endpoint binds a socket of its own beside it, for the answers.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from bus.errors import UsageError
from bus.mavlink.packets import LinkCounters, Message, Packets

LARGEST: Final = 65536  # bytes of one datagram
AT_ONCE: Final = 8  # datagrams of one poll,
PACKETS_AT_ONCE: Final = 16  # and packets in them: what is left of a datagram is for the next poll
LONGEST_PATH: Final = 107  # bytes, of a Unix socket's name


class Endpoint:
    """One component's socket."""

    def __init__(self, path: Path, system: int, component: int) -> None:
        """Bind the socket at a path that is not there yet. Raises UsageError where that cannot be."""
        self.path = path
        self.counters = LinkCounters()
        self._packets = Packets(system, component, self.counters)
        self._sequence: dict[str, int] = {}  # next number, by receiver; forgotten with it
        self._left = (b"", "")  # of a datagram, and who sent it
        if len(os.fsencode(path)) > LONGEST_PATH:
            raise UsageError(
                f"{path}: too long for a socket's name ({LONGEST_PATH} bytes); set TMPDIR to a shorter directory"
            )
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)
        try:
            self._socket.bind(os.fspath(path))
            os.chmod(path, 0o600)
        except OSError as error:
            self._socket.close()
            raise UsageError(f"{path}: cannot make the command socket: {error.strerror or error}") from None
        self._watch = select.epoll()
        self._watch.register(self._socket, select.EPOLLIN)
        self._waiting = self._watch.poll

    def poll(self, most: int = AT_ONCE) -> list[tuple[Message, str]]:
        """Return the messages of at most so many datagrams that wait, each with the address to answer to ("": none)."""
        found: list[tuple[Message, str]] = []
        if not self._left[0] and not self._waiting(0):
            return found  # nearly always: asking is four times cheaper than a read that finds nothing
        left, packets = most, PACKETS_AT_ONCE
        while left > 0 and packets > 0:
            left -= 1
            datagram, address = self._left
            if datagram:
                self._left = (b"", "")
            else:
                try:
                    datagram, sender = self._socket.recvfrom(LARGEST)
                except (BlockingIOError, InterruptedError):
                    break
                except OSError:  # an answer of ours met nobody
                    continue
                address = sender if isinstance(sender, str) else ""
            messages, rest, taken = self._packets.read_some(datagram, packets)
            packets -= taken
            if rest:
                self._left = (rest, address)
            found += [(message, address) for message in messages]
        return found

    def send(self, message: Message, to: str) -> bool:
        """Send a message; False, and counted, when it could not be taken at once or nobody is there."""
        if self.try_send(message, to):
            return True
        self._sequence[to] = (self._sequence[to] + 1) % 256  # the receiver sees that one is missing
        self.counters.dropped += 1
        return False

    def try_send(self, message: Message, to: str) -> bool:
        """Send a message; False when the receiver has no room now. One that nobody is there for is dropped, and counted.

        Sequence numbers count by receiver: each sees all of its own.
        """
        sequence = self._sequence.setdefault(to, 0)
        try:
            self._socket.sendto(self._packets.write(message, sequence), to)
        except BlockingIOError:
            return False
        except (OSError, ValueError):
            self.counters.dropped += 1
            self._sequence.pop(to)
            return True
        self._sequence[to] = (sequence + 1) % 256
        self.counters.sent += 1
        return True

    def send_together(self, messages: Sequence[Message], to: str) -> bool:
        """Send messages as one datagram, which takes one place in the receiver's queue; False where `send` says so."""
        sequence = self._sequence.get(to, 0)
        data = b"".join([self._packets.write(message, (sequence + i) % 256) for i, message in enumerate(messages)])
        self._sequence[to] = (sequence + len(messages)) % 256
        try:
            self._socket.sendto(data, to)
        except OSError as error:
            if not isinstance(error, BlockingIOError):
                del self._sequence[to]
            self.counters.dropped += len(messages)
            return False
        self.counters.sent += len(messages)
        return True

    def fileno(self) -> int:
        """Return a descriptor that is readable when `poll` has something."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close and remove the socket. May be repeated."""
        if self._socket.fileno() >= 0:
            self._watch.close()
            self._socket.close()
            with contextlib.suppress(OSError):
                os.unlink(self.path)
