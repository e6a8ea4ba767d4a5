"""Settings of the gyro fault detectors. Data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from bus.units import Ge, Gt, Le, NonNegative, Positive, RadS, Seconds, Unit, Vec3, Vec4


@dataclass(frozen=True, slots=True, kw_only=True)
class NoDetectorConfig:
    """No fault detection: the estimate passes through."""

    kind: Literal["none"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PracticalDetectorConfig:
    """Gyro and wheel faults told apart with star tracker and wheel speeds. See docs/gyro-fdi.md, section 3."""

    kind: Literal["practical"]
    observer: Literal["linear", "ts_b", "ts_bx", "static"] = "static"  # residual that serves without a star tracker
    recovery: Literal["off", "on"] = "on"  # off: detect and report, fly with the estimator's rate
    fog: Literal["tactical", "space"] = "tactical"  # what a healthy gyro may do; a term given below wins
    gyro_arw_rad_sqrt_s: Positive | None = None  # angle random walk [rad/sqrt(s)]
    angle_lsb_rad: NonNegative | None = None  # quantisation of the integrated angle [rad]
    bias_max_rad_s: NonNegative | None = None  # drift that is not yet a fault
    scale_max: NonNegative | None = None  # scale factor error that is not yet a fault [1]
    star_noise_arcsec: Annotated[Vec3, Unit("arcsec")] = (10.3, 10.3, 51.6)  # 1 sigma about body x, y, z
    filter_rate_rad_s: Annotated[RadS, Gt(0), Le(2)] = 0.6  # bandwidth of the gyro-less rate filter
    static_gain_rad_s: Positive = 0.05  # l of observer `static`, and memory 1/l of its threshold
    parity_windows_s: Annotated[Vec4, Unit("s")] = (0.25, 1.0, 4.0, 16.0)
    parity_sigma: Positive = 6.0  # two frames in a row, same sign
    suspect_sigma: Positive = 9.0  # one frame, while the axis is suspect
    acceleration_max_rad_s2: Positive | None = None  # None: 1.35 times what all wheels together can do
    suspect_s: Annotated[Seconds, Gt(0)] = 3.0
    observer_threshold_rad_s: Annotated[RadS, Gt(0)] = 0.003
    clear_filter_s: Annotated[Seconds, Gt(0)] = 2.0
    clear_threshold_rad_s: Annotated[RadS, Gt(0)] = 2e-4
    clear_after_s: Annotated[Seconds, Gt(0)] = 30.0
    classify_after_s: Annotated[Seconds, Ge(5)] = 20.0
    star_lost_after_s: Annotated[Seconds, Gt(0)] = 0.6  # past this without a frame the gyro carries the filters
    safe_after_s: Annotated[Seconds, Gt(0)] = 30.0  # past this without frames and without a good gyro: safe mode
    cycle_s: Annotated[Seconds, Gt(0)] = 0.05  # detection runs at the multiple of the tick nearest to this


@dataclass(frozen=True, slots=True, kw_only=True)
class Wang2010DetectorConfig:
    """The gyro fault observers of Wang, Li & Ma 2010: one residual against one threshold. See docs/gyro-fdi.md.

    Gyro alone and open loop at heart: it holds only while torque, inertia and wheel momentum are known.
    """

    kind: Literal["wang2010"]
    observer: Literal["linear", "ts_a", "ts_b", "ts_bx", "static"] = "ts_b"
    threshold_rad_s: Annotated[RadS, Gt(0)] = 0.0008  # on the residual of each axis
    debounce_ticks: Annotated[int, Ge(1)] = 1  # residuals beyond the threshold in a row
    static_gain_rad_s: Positive = 0.05  # for `static`
    recovery: Literal["off", "on"] = "off"  # on: the residual is taken off the rate while the alarm stands
