"""Estimators: attitude and rate from the sensors of a tick."""

from __future__ import annotations

from fsw.estimation.direct import Direct
from fsw.estimation.mekf import Mekf
from fsw.estimation.settings import DirectConfig, MekfConfig
from fsw.families import Estimator
from fsw.registry import Registry

REGISTRY: Registry[Estimator] = Registry(
    (DirectConfig, Direct),
    (MekfConfig, Mekf),
)
