"""Settings of the plant: every number that the truth model uses, with unit and range. Data only.

Keys carry their unit. Angles are given in degrees where people think in degrees; the models convert once, at start.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from bus.units import (
    Deg,
    Ge,
    Gt,
    KgM2,
    Le,
    Lt,
    Mat3,
    NewtonMetre,
    NonNegative,
    Positive,
    RadS,
    Seconds,
    Unit,
    Vec3,
    Vec4,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyConfig:
    """Rigid body and where it starts."""

    inertia_kgm2: Annotated[Mat3, Unit("kg m^2")]  # body axes, without the rotors' own about their spin axes
    attitude_q: Vec4 = (1.0, 0.0, 0.0, 0.0)  # q_ib at t = 0, scalar first; normalised when read
    rate_deg_s: Annotated[Vec3, Unit("deg/s")] = (0.0, 0.0, 0.0)  # omega_bi_b at t = 0
    wheel_gyroscopic: bool = True  # False: the papers' plant, J w' = -w x J w + D tau, without the wheels' momentum


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelMotorConfig:
    """Motor, driver, bearing and supply of a wheel of the ITHACO Type-A class. What is not given is the preset's, see
    docs/wheels.md: each number there with its source.
    """

    preset: Literal["ithaco_a", "rw100", "low_drag"] = "ithaco_a"
    inertia_kgm2: Annotated[KgM2, Gt(0)] | None = None  # rotor, about its spin axis: J
    driver_gain_a_v: Annotated[float, Unit("A/V"), Gt(0)] | None = None  # G_d
    torque_constant_nm_a: Annotated[float, Unit("N m/A"), Gt(0)] | None = None  # k_t
    back_emf_v_s: Annotated[float, Unit("V s/rad"), Gt(0)] | None = None  # k_e
    bandwidth_rad_s: Annotated[RadS, Gt(0)] | None = None  # of the driver, w_d
    max_command_v: Annotated[float, Unit("V"), Gt(0)] | None = None
    coulomb_nm: NonNegative | None = None  # dry friction tau_c [N m]
    static_nm: NonNegative | None = None  # dry friction at rest tau_s, not less than coulomb_nm; None: the same [N m]
    viscous_nm_s: NonNegative | None = None  # viscous friction at -30 degC, v0 [N m s/rad]
    viscous_slope_nm_s_k: NonNegative | None = None  # by how much it falls with each degree, v1 [N m s/rad/K]
    overspeed_rad_s: Annotated[RadS, Gt(0)] | None = None  # where the speed limiter sets in, w_s
    overspeed_gain_v_s: Annotated[float, Unit("V s/rad"), Ge(0)] | None = None  # K_s
    emf_gain: NonNegative | None = None  # feedback of the limiter of the back-EMF, K_f [V/V]
    bus_v: Annotated[float, Unit("V"), Gt(1)] = 28.0
    input_ohm: Annotated[float, Unit("ohm"), Ge(0)] = 2.0  # between bus and driver, R_in
    bridge_ohm: Annotated[float, Unit("ohm"), Ge(0)] = 2.0  # R_B
    quiescent_w: Annotated[float, Unit("W"), Ge(0)] = 3.0  # P_q
    poles: Annotated[int, Ge(1)] = 36  # N
    ripple: Annotated[float, Ge(0), Lt(1)] = 0.0  # share of the motor's torque, B; the real wheel's is 0.22
    cogging_nm: NonNegative = 0.0  # C [N m]
    noise_angle_rad: NonNegative = 0.0  # of the lubricant's torque noise, theta_a [rad]; the real wheel's is 0.05
    noise_rate_rad_s: RadS = 0.2  # w_a
    temperature_c: Annotated[float, Unit("degC"), Ge(-60), Le(120)] = 20.0  # of the motor at t = 0
    ambient_c: Annotated[float, Unit("degC"), Ge(-60), Le(120)] = 20.0
    thermal: bool = False  # whether the motor warms up; its viscous friction falls with that
    thermal_resistance_k_w: Positive = 2.0  # [K/W]
    heat_capacity_j_k: Positive = 900.0  # [J/K]
    jitter: bool = False  # whether the rotor's imbalance acts on the body
    static_imbalance_kg_m: NonNegative = 5e-6  # U_s [kg m]
    dynamic_imbalance_kg_m2: NonNegative = 2e-6  # U_d [kg m^2]
    position_b_m: Annotated[Vec3, Unit("m")] = (0.0, 0.0, 0.0)  # of the wheel, for the torque of its static imbalance


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelConfig:
    """One reaction wheel. Nominal axis `mount`, true axis tilted and clocked (Zhang, Ye & Sun 2018, eq (3), exact form)."""

    mount: Literal["x", "y", "z", "skew"]
    tilt_deg: Deg = 0.0  # delta alpha
    clock_deg: Deg = 0.0  # delta beta
    speed_rad_s: RadS = 0.0  # at t = 0, relative to the body
    speed_noise_rad_s: NonNegative = 0.0  # tachometer, 1 sigma per sample
    current_noise_a: NonNegative = 0.0  # telemetered current, 1 sigma per sample [A]
    model: Literal["ideal", "ithaco"] = "ideal"  # ithaco: with motor, driver, bearing and supply, as `motor` says
    motor: WheelMotorConfig | None = None  # of the ithaco model; None: preset ithaco_a
    # of the ideal model alone
    inertia_kgm2: Annotated[KgM2, Gt(0)] = 0.01  # rotor, about its spin axis
    max_torque_nm: Annotated[NewtonMetre, Gt(0)] = 0.1
    max_speed_rad_s: Annotated[RadS, Gt(0)] = 1000.0
    torque_lag_s: Annotated[Seconds, Ge(0)] = 0.0  # first-order motor lag; 0: torque follows at once
    viscous_nm_s: NonNegative = 0.0  # drag torque per rad/s [N m s]
    coulomb_nm: NonNegative = 0.0  # dry friction [N m]
    motor_constant_nm_a: Positive = 0.05  # torque per ampere, for the telemetered current


@dataclass(frozen=True, slots=True, kw_only=True)
class GyroConfig:
    """Fiber-optic gyro triad. `preset` fills the noise terms; a term given beside it wins. See docs/plant.md."""

    preset: Literal["ideal", "space", "tactical"] = "ideal"
    arw_rad_sqrt_s: NonNegative | None = None  # angle random walk N [rad/sqrt(s)]
    bias_instability_rad_s: NonNegative | None = None  # B [rad/s]
    bias_time_s: Positive | None = None  # correlation time of the bias instability [s]
    rrw_rad_s_sqrt_s: NonNegative | None = None  # rate random walk K [rad/s/sqrt(s)]
    scale_factor: tuple[float, float, float] | None = None  # s_f per axis [1]; None: drawn from the preset's 1 sigma
    misalignment_deg: Annotated[Vec3, Unit("deg")] = (0.0, 0.0, 0.0)  # small rotation of the triad, body axes
    bias_rad_s: Vec3 = (0.0, 0.0, 0.0)  # constant turn-on bias, body axes [rad/s]
    angle_lsb_rad: NonNegative | None = None  # quantisation of the integrated angle [rad]; 0: none
    range_rad_s: Positive = 2.1  # saturates here [rad/s]
    bandwidth_hz: NonNegative = 0.0  # first-order; 0: unlimited


@dataclass(frozen=True, slots=True, kw_only=True)
class StarTrackerConfig:
    """Star tracker: attitude with noise, at its own rate, late by its latency, blind above a rate limit."""

    rate_hz: Annotated[float, Unit("Hz"), Gt(0)] = 10.0  # the tick rate must be a whole multiple
    noise_arcsec: Annotated[Vec3, Unit("arcsec")] = (0.0, 0.0, 0.0)  # 1 sigma about body x, y, z per frame
    latency_s: Annotated[Seconds, Ge(0)] = 0.0  # whole ticks; frames carry the SYNC count of the measurement
    max_rate_deg_s: Annotated[float, Unit("deg/s"), Gt(0)] = 1e6  # no attitude above this body rate
    exclusion: ExclusionConfig | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ExclusionConfig:
    """No attitude while the boresight is within `angle_deg` of a bright body fixed in inertial space."""

    boresight_b: Vec3 = (0.0, 0.0, 1.0)
    direction_i: Vec3 = (1.0, 0.0, 0.0)
    angle_deg: Annotated[Deg, Gt(0), Le(180)] = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ConstantTorque:
    """External torque, constant in body axes."""

    kind: Literal["constant"]
    torque_nm: Annotated[Vec3, Unit("N m")]


@dataclass(frozen=True, slots=True, kw_only=True)
class SinusoidalTorque:
    """External torque a_i sin(2 pi t / period + phase_i), body axes."""

    kind: Literal["sinusoidal"]
    amplitude_nm: Annotated[Vec3, Unit("N m")]
    period_s: Annotated[Seconds, Gt(0)]
    phase_deg: Annotated[Vec3, Unit("deg")] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class GravityGradient:
    """Gravity gradient of a circular orbit in the inertial x-y plane, starting on +x."""

    kind: Literal["gravity_gradient"]
    altitude_km: Annotated[float, Unit("km"), Gt(100)] = 500.0


TorqueConfig = ConstantTorque | SinusoidalTorque | GravityGradient


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantConfig:
    """Everything the plant needs beside the clock and the bus."""

    step_s: Annotated[Seconds, Gt(0), Le(0.1)] = 0.01  # integration step; the tick must be a whole multiple
    body: BodyConfig
    wheels: tuple[WheelConfig, WheelConfig, WheelConfig, WheelConfig]
    gyro: GyroConfig = field(default_factory=GyroConfig)
    star_tracker: StarTrackerConfig = field(default_factory=StarTrackerConfig)
    torques: tuple[Annotated[TorqueConfig, "kind"], ...] = ()
    command_timeout_ticks: Annotated[int, Ge(1)] = 5  # a wheel without a command for this long goes to zero torque
    command_max_age_ticks: Annotated[int, Ge(0)] = 2  # older commands are ignored
    command_latency_ticks: Annotated[int, Ge(0), Le(10)] = 0  # a command acts this many ticks after it was sent
