"""Settings of the allocators. Data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from bus.units import Gt, Le


@dataclass(frozen=True, slots=True, kw_only=True)
class PseudoInverseConfig:
    """tau_rw = D0^T (D0 D0^T)^-1 tau, then limited per wheel (`clip`) or scaled as a whole (`direction`)."""

    kind: Literal["pseudo_inverse"]
    saturation: Literal["clip", "direction"] = "clip"
    share_min: Annotated[float, Gt(0), Le(1)] = (
        0.15  # a wheel judged weaker is still asked as if it gave this share [1]
    )
    use_health: bool = True  # reckon with the shares that wheel health thinks the wheels give; False: with whole ones


@dataclass(frozen=True, slots=True, kw_only=True)
class TransposeConfig:
    """tau_rw = sat(D0^T tau): no wheel knows of the others, and together they give more than was asked for."""

    kind: Literal["transpose"]
