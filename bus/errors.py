"""Every error that hilsat raises on purpose, in one tree, each with the exit code the command line ends with.

A message says what was being done, the value with its unit, the allowed range or the choices, where
(file:line:column, frame id, tick), and what to do about it.
"""

from __future__ import annotations


class HilsatError(Exception):
    """Root of the tree. `exit_code` is what the command line returns when this ends a run."""

    exit_code = 3


# -- 2: the user asked for something that cannot be run ------------------------------------------------------------


class UsageError(HilsatError):
    """A command line, file or value that cannot be used as given."""

    exit_code = 2


class ConfigError(UsageError):
    """A scenario or settings value is wrong. `problems` lists every one found, not only the first."""

    def __init__(self, *problems: str) -> None:
        self.problems = problems
        super().__init__("\n".join(problems))


class StepSizeError(UsageError):
    """An algorithm tuned for one sampling period was stepped with another."""


class BusAddressError(UsageError):
    """A bus address that names no transport, or one that this machine does not have."""


class BusLoadError(UsageError):
    """A schedule that a real CAN bus of the stated bit rate could not carry."""


class DesignError(UsageError):
    """An observer or controller design that does not exist or is not stable."""


# -- 3: the infrastructure failed under a run that was asked for correctly -----------------------------------------


class BusError(HilsatError):
    """The bus cannot carry traffic."""


class BusInUseError(BusError):
    """Another bench already runs on this bus."""


class BusLostError(BusError):
    """The bus went away under a running process."""


class PeerLostError(BusError):
    """A peer stopped answering. The message names it."""


class RecordError(HilsatError):
    """The log cannot be written or read."""


class DeadlineError(HilsatError):
    """Deadlines were missed past the limit that the scenario sets."""
