"""Estimators: attitude and rate from the sensors of a tick."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fsw.config import DirectConfig, ModelConfig
from fsw.estimation.direct import Direct
from fsw.estimation.mekf import Mekf
from fsw.records import Estimator


def _make_direct(config: DirectConfig, model: ModelConfig, tick_s: float) -> Direct:
    return Direct(config, model)  # it reads the time from the sensors


# kind in the settings -> factory(config, model, tick_s)
REGISTRY: dict[str, Callable[[Any, ModelConfig, float], Estimator]] = {
    "direct": _make_direct,
    "mekf": Mekf,
}
