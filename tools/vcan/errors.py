"""What can go wrong between a command and an AF_CAN socket."""

from __future__ import annotations

from bus.errors import BusError


class VcanError(BusError):
    """CAN cannot be had here. The message says what is missing and what to do about it."""


class PackageError(VcanError):
    """A Debian package is needed that cannot be had."""


class GuestError(VcanError):
    """The guest kernel did not come up, or went down under the command (`command_began`)."""

    exit_code = 125

    def __init__(self, message: str, *, command_began: bool = False) -> None:
        super().__init__(message)
        self.command_began = command_began
