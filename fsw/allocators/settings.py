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

    share_min keeps a wheel that was judged away in use, so that a recovery shows: what is never asked for anything is never
    seen to come back. Set it to 0 where wheel health tells dead wheels and probes them. Then dead_below counts: where no
    other wheel can stand in for one that gives next to nothing, the torque along its axis is better given up than the
    whole torque cut down to what is left of that axis.
    """

    kind: Literal["direct"]
    use_health: bool = True  # reckon with shares and biases as wheel health thinks them; False: with whole wheels
    share_min: Annotated[float, Ge(0), Le(1)] = 0.15  # a wheel judged weaker counts as if it gave this share [1]
    dead_below: Annotated[float, Gt(0), Le(1)] = 0.02  # one whose share is then still below this counts as dead [1]
