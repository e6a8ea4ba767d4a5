"""Settings of the flight software: every number that flight code uses, with unit and range. Data only.

The flight software has its own idea of the satellite (inertia, wheel axes, limits). The truth is the plant's business.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from bus.units import Ge, Gt, Le, Mat3, NonNegative, Positive, RadS, Seconds, Unit, Vec3, Vec4


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelConfig:
    """What the flight software believes about the satellite."""

    inertia_kgm2: Annotated[Mat3, Unit("kg m^2")]
    wheel_max_torque_nm: Annotated[float, Unit("N m"), Gt(0)] = 0.1
    wheel_max_speed_rad_s: Annotated[RadS, Gt(0)] = 1000.0
    wheel_inertia_kgm2: Annotated[float, Unit("kg m^2"), Gt(0)] = 0.01
    wheel_momentum: bool = True  # count the wheels' momentum in the gyroscopic term


# -- estimators ----------------------------------------------------------------------------------------------------


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


# -- detectors -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class NoDetectorConfig:
    """No fault detection: the estimate passes through."""

    kind: Literal["none"]


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
    wheel_threshold_nm: Annotated[float, Unit("N m"), Gt(0)] = 0.01
    wheel_filter_s: Annotated[Seconds, Gt(0)] = 1.0
    clear_filter_s: Annotated[Seconds, Gt(0)] = 2.0
    clear_threshold_rad_s: Annotated[RadS, Gt(0)] = 2e-4
    clear_after_s: Annotated[Seconds, Gt(0)] = 30.0
    classify_after_s: Annotated[Seconds, Ge(5)] = 20.0
    star_lost_after_s: Annotated[Seconds, Gt(0)] = 0.6  # past this without a frame the gyro carries the filters
    safe_after_s: Annotated[Seconds, Gt(0)] = 30.0  # past this without frames and without a good gyro: safe mode
    cycle_s: Annotated[Seconds, Gt(0)] = 0.05  # detection runs at the multiple of the tick nearest to this


# -- observers -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class NoObserverConfig:
    """No fault-torque estimate (zeros)."""

    kind: Literal["none"]


@dataclass(frozen=True, slots=True, kw_only=True)
class IloConfig:
    """Iterative learning observer, Zhang, Ye & Sun 2018, eqs (12)-(13). Gains belong to `period_s`."""

    kind: Literal["ilo"]
    period_s: Annotated[Seconds, Gt(0)] = 0.1
    k1: Annotated[float, Ge(0), Le(1)] = 0.15  # [1]
    k2: NonNegative = 98.0  # [N m s/rad]
    k3: NonNegative = 21.0  # [N m s/rad]
    lambda_nm_s: NonNegative = 0.1  # [N m s/rad]


# -- controllers ---------------------------------------------------------------------------------------------------


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
    """Saturated variable-structure law, tau_rw = -tau_max sat(D0^T s / epsilon), s = w + k q (a baseline)."""

    kind: Literal["variable_structure"]
    k: Positive = 0.12  # [rad/s]
    epsilon: Positive = 0.003  # boundary layer [rad/s]


@dataclass(frozen=True, slots=True, kw_only=True)
class BrakingProfileConfig:
    """Sliding surface along a braking profile, s = w - w_d(theta); its margin adapts to what the wheels give."""

    kind: Literal["braking_profile"]
    eta: Annotated[float, Gt(0), Le(1)] = 0.9  # share of the braking authority planned on, close to the target [1]
    k_theta: Positive = 0.8  # slope of the profile at the target [1/s]
    k_s: Positive = 0.6  # gain from the surface to acceleration [1/s]
    adapt: bool = True  # False: braking_torque_nm and eta throughout, no learning
    braking_torque_nm: Positive = 0.04  # per wheel, planned on where adapt is off
    eta_far: Annotated[float, Gt(0), Le(1)] = 0.3  # share planned on far from the target, where a fault costs most [1]
    far_rad: Positive = 0.25  # distance over which eta passes to eta_far
    reserve: Annotated[float, Ge(0), Le(1)] = 0.2  # weight of "one more wheel fails" in the braking authority [1]
    learn_s: Annotated[Seconds, Gt(0)] = 0.28  # time constant of learning what each wheel delivers, at full torque
    observer_lag_s: Annotated[Seconds, Gt(0)] = 0.3  # time constant of the observer that reports the fault torque


# -- allocators ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class PseudoInverseConfig:
    """tau_rw = D0^T (D0 D0^T)^-1 tau, then limited per wheel (`clip`) or scaled as a whole (`direction`)."""

    kind: Literal["pseudo_inverse"]
    saturation: Literal["clip", "direction"] = "clip"


# -- executive and modes -------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class ExecutiveConfig:
    """Rates and what to do when a cycle is late. The base rate is the run's tick rate."""

    control_divider: Annotated[int, Ge(1)] = 1  # observe, guide, control, allocate every n-th tick
    overrun: Literal["skip", "catch_up", "degrade", "safe"] = "skip"
    max_consecutive_slips: Annotated[int, Ge(1)] = 50  # past this the run ends as an infrastructure failure
    watchdog_s: Annotated[Seconds, Gt(0)] = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ModesConfig:
    """When to change mode."""

    initial: Literal["standby", "detumble", "point", "safe"] = "point"  # entered once sensors are valid
    detumble_above_deg_s: Annotated[float, Unit("deg/s"), Gt(0)] = 5.0
    point_below_deg_s: Annotated[float, Unit("deg/s"), Gt(0)] = 2.0
    stale_after_ticks: Annotated[int, Ge(1)] = 5  # K: last good value is held this long, then the unit is stale
    star_stale_after_s: Annotated[Seconds, Gt(0)] = 5.0
    recover_after_ticks: Annotated[int, Ge(1)] = 20  # good ticks before safe is left
    damping_nm_s: Positive = 20.0  # rate damping gain in detumble and safe [N m s/rad]


EstimatorConfig = DirectConfig | MekfConfig
DetectorConfig = NoDetectorConfig | Wang2010DetectorConfig | PracticalDetectorConfig
ObserverConfig = NoObserverConfig | IloConfig
ControllerConfig = SmcConfig | VariableStructureConfig | BrakingProfileConfig
AllocatorConfig = PseudoInverseConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class FswConfig:
    """Everything the flight software needs beside the clock and the bus."""

    model: ModelConfig
    target_q: Vec4 = (1.0, 0.0, 0.0, 0.0)  # attitude to reach, q_it, scalar first; normalised when read
    estimator: EstimatorConfig
    detector: DetectorConfig = field(default_factory=lambda: NoDetectorConfig(kind="none"))
    observer: ObserverConfig
    controller: ControllerConfig
    allocator: AllocatorConfig = field(default_factory=lambda: PseudoInverseConfig(kind="pseudo_inverse"))
    executive: ExecutiveConfig = field(default_factory=ExecutiveConfig)
    modes: ModesConfig = field(default_factory=ModesConfig)
