"""Settings of the estimators. Data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from bus.units import Gt, Positive, Unit, Vec3


@dataclass(frozen=True, slots=True, kw_only=True)
class DirectConfig:
    """Star-tracker attitude carried forward with the gyro rate; no filtering. For ideal sensors."""

    kind: Literal["direct"]


@dataclass(frozen=True, slots=True, kw_only=True)
class MekfConfig:
    """Multiplicative extended Kalman filter with gyro bias states (Lefferts, Markley & Shuster 1982)."""

    kind: Literal["mekf"]
    gyro_arw_rad_sqrt_s: Positive = 2.91e-5
    gyro_rrw_rad_s_sqrt_s: Positive = 1e-7
    star_noise_arcsec: Annotated[Vec3, Unit("arcsec")] = (10.0, 10.0, 52.0)
    initial_attitude_sigma_deg: Annotated[float, Unit("deg"), Gt(0)] = 1.0
    initial_bias_sigma_rad_s: Positive = 1e-3
    gate_sigma: Positive = 6.0  # innovations beyond this are rejected and counted
