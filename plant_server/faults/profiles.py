"""How a fault comes on: the level from 0, not there, to 1, fully there, over the time since its onset.

A profile is one class: its keys as annotated fields, `level` and `settled`. It is chosen with the key `profile`; a key of
one profile alone, such as `rise_s`, says which.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Protocol

from bus.units import Ge, Seconds


class Profile(Protocol):
    """What the timeline needs of a profile."""

    def level(self, elapsed_s: float) -> float:
        """Return how far the fault has come on, 0..1, so long after its onset [s]."""
        ...

    def settled(self, elapsed_s: float) -> bool:
        """Return whether the level stays what it is from so long after the onset on [s]."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """There at once."""

    def level(self, elapsed_s: float) -> float:
        """Return 1: a fault that acts is there."""
        return 1.0

    def settled(self, elapsed_s: float) -> bool:
        """Return True."""
        return True


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearRise:
    """From none to full along a straight line."""

    rise_s: Annotated[Seconds, Ge(0)]  # from none to full; 0: at once

    def level(self, elapsed_s: float) -> float:
        """Return the part of the rise that has passed, at most 1."""
        if elapsed_s >= self.rise_s or self.rise_s == 0.0:
            return 1.0
        return elapsed_s / self.rise_s if elapsed_s > 0.0 else 0.0

    def settled(self, elapsed_s: float) -> bool:
        """Return whether the rise is over."""
        return elapsed_s >= self.rise_s


PROFILES: dict[str, type] = {"step": Step, "linear": LinearRise}
STEP = Step()
