"""Controllers: from the pointing error and the estimated fault torque to a body torque."""

from __future__ import annotations

from fsw.controllers.braking_profile import BrakingProfile
from fsw.controllers.dismc import DiscreteIntegralSlidingMode
from fsw.controllers.finite_time import FiniteTime
from fsw.controllers.fuzzy_pid import FuzzyPid
from fsw.controllers.pid import Pid
from fsw.controllers.power_integrator import PowerIntegrator
from fsw.controllers.rate_pid import RatePid
from fsw.controllers.settings import (
    BrakingProfileConfig,
    DismcConfig,
    FiniteTimeConfig,
    FuzzyPidConfig,
    PidConfig,
    PowerIntegratorConfig,
    RatePidConfig,
    SmcConfig,
    VariableStructureConfig,
)
from fsw.controllers.smc import SlidingMode
from fsw.controllers.variable_structure import VariableStructure
from fsw.families import Controller
from fsw.registry import Registry

REGISTRY: Registry[Controller] = Registry(
    (BrakingProfileConfig, BrakingProfile),
    (DismcConfig, DiscreteIntegralSlidingMode),
    (FiniteTimeConfig, FiniteTime),
    (FuzzyPidConfig, FuzzyPid),
    (PidConfig, Pid),
    (PowerIntegratorConfig, PowerIntegrator),
    (RatePidConfig, RatePid),
    (SmcConfig, SlidingMode),
    (VariableStructureConfig, VariableStructure),
)
