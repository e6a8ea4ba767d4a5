"""Settings of the flight software beside those of its algorithms, which stand in their families. Data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from bus.units import Ge, Gt, Le, Mat3, Positive, RadS, Seconds, Unit, Vec3


@dataclass(frozen=True, slots=True, kw_only=True)
class ExecutiveConfig:
    """Rates and what to do when a cycle is late. The base rate is the run's tick rate."""

    control_divider: Annotated[int, Ge(1)] = 1  # observe, guide, control, allocate every n-th tick
    overrun: Literal["skip", "catch_up", "degrade", "safe"] = "skip"
    max_consecutive_slips: Annotated[int, Ge(1)] = 50  # past this the run ends as an infrastructure failure
    watchdog_s: Annotated[Seconds, Gt(0)] = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class GuidanceConfig:
    """How a target that moves is followed."""

    feed_forward: bool = True  # the torque that the target's own motion takes is added to the law's


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


NewtonMetre = Annotated[float, Unit("N m"), Gt(0)]


KgM2 = Annotated[float, Unit("kg m^2"), Gt(0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelMotorConfig:
    """A wheel's motor as the flight software knows it. `preset` fills the values; a value given beside it wins."""

    preset: Literal["ithaco_a", "rw100"] = "ithaco_a"
    driver_gain_a_v: Annotated[float, Unit("A/V"), Gt(0)] | None = None  # current for a volt of command
    torque_constant_nm_a: Annotated[float, Unit("N m/A"), Gt(0)] | None = None
    bandwidth_rad_s: Annotated[RadS, Gt(0)] | None = None  # of the driver
    coulomb_nm: Annotated[float, Unit("N m"), Ge(0)] | None = None  # dry friction
    viscous_nm_s: Annotated[float, Unit("N m s/rad"), Ge(0)] | None = None  # viscous friction, at 20 C
    max_command_v: Annotated[float, Unit("V"), Gt(0)] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelModelConfig:
    """One wheel as the flight software knows it."""

    axis_b: Vec3  # spin axis, body axes; normalised when read
    max_torque_nm: NewtonMetre = 0.1
    max_speed_rad_s: Annotated[RadS, Gt(0)] = 1000.0
    inertia_kgm2: KgM2 = 0.01  # rotor, about its spin axis
    motor: WheelMotorConfig | None = None  # None: one that gives its command at once, without friction
    fitted: bool = True  # false: there is no wheel at this position, and it is never used


FourWheels = tuple[WheelModelConfig, WheelModelConfig, WheelModelConfig, WheelModelConfig]


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelConfig:
    """What the flight software believes about the satellite."""

    inertia_kgm2: Annotated[Mat3, Unit("kg m^2")]
    wheel_max_torque_nm: NewtonMetre = 0.1  # of each wheel, where `wheels` is not given
    wheel_max_speed_rad_s: Annotated[RadS, Gt(0)] = 1000.0
    wheel_inertia_kgm2: KgM2 = 0.01
    wheel_motor: WheelMotorConfig | None = None
    wheels: FourWheels | None = None  # None: along x, y, z and (1, 1, 1)
    wheel_momentum: bool = True  # count the wheels' momentum in the gyroscopic term


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveConfig:
    """What is added to the torques allocated before they are sent."""

    friction: Literal["none", "nominal"] = "none"  # nominal: the drag of the wheels' motors is made up for
    gain: Literal["none", "estimated"] = "none"  # estimated: and the gains and friction that wheel health estimates


@dataclass(frozen=True, slots=True, kw_only=True)
class NullSpaceConfig:
    """What four wheels do among themselves, without a torque on the body. Everything is off unless asked for."""

    momentum_gain_1_s: Annotated[float, Ge(0), Le(1)] = 0.0  # how fast null momentum decays [1/s]; 0: it is left alone
    momentum_nms: float = 0.0  # what it decays to [N m s]
    avoid_speed_rad_s: Annotated[RadS, Ge(0)] = 0.0  # wheels are kept faster than this by null torque; 0: they are not
    avoid_gain_1_s: Annotated[float, Gt(0), Le(1)] = 0.5  # how fast a wheel that is slower is brought out [1/s]
    dither_nm: Annotated[float, Unit("N m"), Ge(0)] = (
        0.0  # square wave of null torque, of the wheel most moved; 0: none
    )
    dither_period_s: Annotated[Seconds, Ge(0)] = 0.0  # of that wave
