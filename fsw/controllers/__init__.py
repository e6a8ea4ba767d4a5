"""Controllers: from the pointing error and the estimated fault torque to a body torque."""

from __future__ import annotations

from fsw.controllers.braking_profile import BrakingProfile, BrakingProfileConfig
from fsw.controllers.smc import SlidingMode, SmcConfig
from fsw.controllers.variable_structure import VariableStructure, VariableStructureConfig
from fsw.families import Controller, Registry

REGISTRY: Registry[Controller] = Registry(
    (BrakingProfileConfig, BrakingProfile),
    (SmcConfig, SlidingMode),
    (VariableStructureConfig, VariableStructure),
)
