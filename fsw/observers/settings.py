"""Settings of the observers. Data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from bus.units import Ge, Gt, Le, NonNegative, Seconds


@dataclass(frozen=True, slots=True, kw_only=True)
class IloConfig:
    """Iterative learning observer, Zhang, Ye & Sun 2018, eqs (12)-(13). Gains belong to `period_s`."""

    kind: Literal["ilo"]
    period_s: Annotated[Seconds, Gt(0)] = 0.1
    k1: Annotated[float, Ge(0), Le(1)] = 0.15  # [1]
    k2: NonNegative = 98.0  # [N m s/rad]
    k3: NonNegative = 21.0  # [N m s/rad]
    lambda_nm_s: NonNegative = 0.1  # [N m s/rad]


@dataclass(frozen=True, slots=True, kw_only=True)
class NoObserverConfig:
    """No fault-torque estimate (zeros)."""

    kind: Literal["none"]
