"""The directory of an embedded bus: private to its user, and locked by the one host that serves it."""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
import stat
import struct
from pathlib import Path

from bus.errors import BusAddressError, BusInUseError
from bus.wire.hub.datagrams import SOCKET_NAME

ATTEMPTS = 100  # at a directory that others make and remove meanwhile


def default_directory() -> Path:
    """Return where `hub:` without a directory lives: one bus per user."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    return Path(runtime, "hilsat-hub") if runtime else Path(f"/tmp/hilsat-hub-{os.geteuid()}")


def resolve_directory(where: str) -> Path:
    """Return the absolute directory that a hub address names."""
    return Path(os.path.abspath(os.path.expanduser(where))) if where else default_directory()


def check_place(path: Path) -> None:
    """Raise BusAddressError where there is no directory at a path and none can be made: something else is in the way."""
    for place in (path, *path.parents):
        if os.path.isdir(place):
            return
        if os.path.islink(place):
            raise BusAddressError(f"hub:{path}: {place} is a link that leads nowhere; name another directory")
        if os.path.lexists(place):
            made = "" if place == path else f" cannot be made: {place}"
            raise BusAddressError(f"hub:{path}{made} is not a directory; name another one")


class HubDirectory:
    """An open, checked bus directory. Addresses its socket through the open descriptor where the path is too long.

    Raises BusAddressError when it is no directory, belongs to somebody else or is open to others.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.address = f"hub:{path}"
        self.made = False  # by this process
        try:
            self._fd = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except NotADirectoryError:
            raise BusAddressError(f"{self.address} is not a directory; name another one") from None
        except PermissionError:
            raise BusAddressError(f"{self.address} may not be opened by this user; name another directory") from None
        except FileNotFoundError:
            raise
        except OSError as error:
            raise BusAddressError(f"{self.address} cannot be opened: {error.strerror}; name another one") from None
        try:
            self._check()
        except BusAddressError:
            os.close(self._fd)
            raise

    @classmethod
    def make(cls, path: Path) -> HubDirectory:
        """Return the directory, made with mode 0700 where there is none, and locked for this process.

        Raises BusInUseError when another host holds it.
        """
        check_place(path)
        for _ in range(ATTEMPTS):
            made = True
            try:
                path.mkdir(mode=0o700, parents=True)
            except FileExistsError:
                made = False
            except OSError as error:
                raise BusAddressError(f"hub:{path} cannot be made: {error.strerror}; name another directory") from None
            with contextlib.suppress(FileNotFoundError):
                directory = cls(path)
                if directory._lock():
                    directory.made = made
                    return directory
        raise BusAddressError(f"hub:{path} is taken away as fast as it is made; name another directory")

    @property
    def socket_path(self) -> str:
        """Where to bind or connect: the kernel takes at most 107 bytes."""
        plain = os.path.join(self.path, SOCKET_NAME)
        return plain if len(os.fsencode(plain)) < 108 else f"/proc/self/fd/{self._fd}/{SOCKET_NAME}"

    def remove_socket(self) -> None:
        """Remove the socket of a host that is no more. Only for the process that holds the lock.

        Raises BusAddressError for something of that name that is no socket: it is somebody's, and stays.
        """
        with contextlib.suppress(FileNotFoundError):
            if not stat.S_ISSOCK(os.stat(SOCKET_NAME, dir_fd=self._fd, follow_symlinks=False).st_mode):
                raise BusAddressError(
                    f"{self.address} has a {SOCKET_NAME} that is no socket of a bus; name another directory, or move it away"
                )
            os.unlink(SOCKET_NAME, dir_fd=self._fd)

    def release(self) -> None:
        """Give the directory up, and take it away if this process made it and nothing is left in it."""
        if self._fd < 0:
            return
        if self.made:
            with contextlib.suppress(OSError):
                os.rmdir(self.path)
        os.close(self._fd)
        self._fd = -1

    def _check(self) -> None:
        status = os.fstat(self._fd)
        if status.st_uid != os.geteuid() and os.geteuid() != 0:
            raise BusAddressError(f"{self.address} belongs to user id {status.st_uid}; name a directory of your own")
        mode = stat.S_IMODE(status.st_mode)
        if mode & 0o077:
            raise BusAddressError(
                f"{self.address} is open to other users (mode {mode:04o}); a bus directory has mode 0700:"
                f" chmod 700 {self.path}, or name one that does not exist yet"
            )

    def _lock(self) -> bool:
        """Lock it; False when it was removed in the meantime."""
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = self._name_holder()
            self.release()
            raise BusInUseError(
                f"{self.address} already has a host{holder}; end that run, or use another directory"
            ) from None
        try:
            same = os.path.samestat(os.fstat(self._fd), os.stat(self.path))
        except FileNotFoundError:
            same = False
        if not same:
            self.release()
        return same

    def _name_holder(self) -> str:
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
            probe.setblocking(False)
            probe.connect(self.socket_path)
            pid = struct.unpack("3i", probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))[0]
            return f", process {pid}"
        return ""
