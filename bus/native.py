"""Whether the native variants of a few functions run: where this module is compiled, and with it those that have them.

Plain code asks before it imports one, for librt need not be there.
"""

from __future__ import annotations

from types import FunctionType
from typing import Final


def _probe() -> None:
    """One of Python's own functions, unless this module is compiled."""


COMPILED: Final = not isinstance(_probe, FunctionType)
