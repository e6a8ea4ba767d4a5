"""Settings of the allocators. Data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from bus.units import Ge, Gt, Le


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


@dataclass(frozen=True, slots=True, kw_only=True)
class DirectAllocationConfig:
    """As much torque as the wheels have in the direction asked for, with the least load on the most loaded wheel.

    Where no other wheel can stand in for one that gives next to nothing, the torque along its axis is better given up than
    the whole torque cut down to what is left of that axis: hence dead_below. With a share_min above it no wheel is dead on
    its share alone; it stays in use, so that a recovery shows without a probe.
    """

    kind: Literal["direct"]
    use_health: bool = True  # reckon with shares and biases as wheel health thinks them; False: with whole wheels
    dead_below: Annotated[float, Gt(0), Le(1)] = 0.02  # a wheel that gives a smaller share counts as dead [1]
    share_min: Annotated[float, Ge(0), Le(1)] = 0.0  # a wheel judged weaker counts as if it gave this share [1]
