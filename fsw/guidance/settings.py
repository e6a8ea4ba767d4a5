"""Settings of the guides. Data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from bus.units import Ge, Gt, Seconds, Unit, Vec3, Vec4


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldConfig:
    """Point to an attitude at once and stay there: a step, which the control law takes as it can."""

    do: Literal["hold"]
    at_s: Annotated[Seconds, Ge(0)]
    target_q: Vec4 | None = None  # q_it, scalar first; normalised when read; none: where the target stands at that time


@dataclass(frozen=True, slots=True, kw_only=True)
class SlewConfig:
    """Turn the target to another attitude about the eigenaxis, the short way, from rest to rest."""

    do: Literal["slew"]
    at_s: Annotated[Seconds, Ge(0)]
    target_q: Vec4  # q_it at the end, scalar first; normalised when read
    max_rate_deg_s: Annotated[float, Unit("deg/s"), Gt(0)] = 0.2
    max_acceleration_deg_s2: Annotated[float, Unit("deg/s^2"), Gt(0)] = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackConfig:
    """Let the target turn at a constant rate about an axis fixed in it, which is then fixed in inertial space too."""

    do: Literal["track"]
    at_s: Annotated[Seconds, Ge(0)]
    rate_deg_s: Annotated[Vec3, Unit("deg/s")]  # omega_ti, target axes
    rise_s: Annotated[Seconds, Ge(0)] = 0.0  # time in which the rate comes up linearly from zero; 0: a step
    target_q: Vec4 | None = None  # q_it at at_s, scalar first; none: where the target stands at that time


@dataclass(frozen=True, slots=True, kw_only=True)
class RateConfig:
    """Let the target turn at a rate in its own axes, from where it stands and as it moves: what the body's rate will be."""

    do: Literal["rate"]
    at_s: Annotated[Seconds, Ge(0)]
    rate_deg_s: Annotated[Vec3, Unit("deg/s")]  # omega_ti, target axes; zero stops it
    max_acceleration_deg_s2: Annotated[float, Unit("deg/s^2"), Gt(0)] = 0.01  # how fast the rate changes
