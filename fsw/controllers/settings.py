"""Settings of the controllers. Data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from bus.units import Ge, Gt, Le, Positive


@dataclass(frozen=True, slots=True, kw_only=True)
class BrakingProfileConfig:
    """Sliding surface along a braking profile, s = w - w_d(theta); its margin adapts to what the wheels give.

    Made for `wheel_health: share_learner`, which tells it what they give.
    """

    kind: Literal["braking_profile"]
    eta: Annotated[float, Gt(0), Le(1)] = 0.9  # share of the braking authority planned on, close to the target [1]
    k_theta: Positive = 0.8  # slope of the profile at the target [1/s]
    k_s: Positive = 0.6  # gain from the surface to acceleration [1/s]
    adapt: bool = True  # False: braking_share and eta throughout, whatever the wheels give
    braking_share: Annotated[float, Gt(0), Le(1)] = 0.4  # of each wheel's torque, planned on where adapt is off [1]
    eta_far: Annotated[float, Gt(0), Le(1)] = 0.3  # share planned on far from the target, where a fault costs most [1]
    far_rad: Positive = 0.25  # distance over which eta passes to eta_far
    reserve: Annotated[float, Ge(0), Le(1)] = 0.2  # weight of "one more wheel fails" in the braking authority [1]


@dataclass(frozen=True, slots=True, kw_only=True)
class SmcConfig:
    """Sliding-mode law with adaptive surface slope, Zhang, Ye & Sun 2018, eqs (33)-(35)."""

    kind: Literal["smc"]
    k1: Positive = 5.6  # [N m s/rad]; k2 = 1/k1
    mu: Positive = 2.0
    beta0: Positive = 0.4
    beta_law: Literal["published", "lyapunov", "fixed"] = "published"


@dataclass(frozen=True, slots=True, kw_only=True)
class VariableStructureConfig:
    """Variable-structure law, tau = -(tau_max/epsilon) s, s = w + k q (a baseline). Made for `allocator: transpose`."""

    kind: Literal["variable_structure"]
    k: Positive = 0.12  # [rad/s]
    epsilon: Positive = 0.003  # boundary layer [rad/s]
