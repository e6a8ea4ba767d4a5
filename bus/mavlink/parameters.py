"""A component's parameters on the link: named numbers, each read from where it lives; some can be set.

Every one is REAL32: ground programs read integers in two ways that exclude each other, and a float in one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from bus.errors import ConfigError

LONGEST_NAME: Final = 16


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number. `write` returns "" or why the value was refused; None: it cannot be set."""

    name: str  # at most 16 characters, upper case
    read: Callable[[], float]
    write: Callable[[float], str] | None = None
    low: float = -math.inf
    high: float = math.inf
    text: str = ""  # what it is, with its unit, for a list that people read


class Parameters:
    """All parameters of a component in a fixed order: dense indexes from 0."""

    def __init__(self, items: Iterable[Parameter] = ()) -> None:
        self.items = tuple(items)
        self._index = {item.name: i for i, item in enumerate(self.items)}
        if len(self._index) != len(self.items) or any(not 0 < len(name) <= LONGEST_NAME for name in self._index):
            raise ConfigError("parameters on the link need names of 1 to 16 characters, each once")

    def find(self, name: str, index: int = -1) -> int | None:
        """Return the index of a parameter, by its index where that is not negative, else by its name."""
        if index >= 0:
            return index if index < len(self.items) else None
        return self._index.get(name)
