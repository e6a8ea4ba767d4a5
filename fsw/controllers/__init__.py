"""Controllers: from attitude error, rate and estimated fault torque to a demand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fsw.config import ModelConfig
from fsw.controllers.braking_profile import BrakingProfile
from fsw.controllers.smc import SlidingMode
from fsw.controllers.variable_structure import VariableStructure
from fsw.records import Controller

# kind in the settings -> factory(config, model)
REGISTRY: dict[str, Callable[[Any, ModelConfig], Controller]] = {
    "braking_profile": BrakingProfile,
    "smc": SlidingMode,
    "variable_structure": VariableStructure,
}
