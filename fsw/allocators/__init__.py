"""Allocators: from a body torque to four wheel torques within limits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fsw.allocators.pseudo_inverse import PseudoInverse
from fsw.config import ModelConfig
from fsw.records import Allocator

# kind in the settings -> factory(config, model)
REGISTRY: dict[str, Callable[[Any, ModelConfig], Allocator]] = {
    "pseudo_inverse": PseudoInverse,
}
