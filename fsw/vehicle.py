"""The satellite as the flight software believes it to be: inertia, wheel axes, limits. The truth is the plant's business."""

from __future__ import annotations

import math

from bus.errors import ConfigError
from bus.linear import ZERO3, invert_symmetric
from bus.units import Mat3, Vec3, Vec4
from fsw.records import Flags4
from fsw.settings import ModelConfig, WheelModelConfig
from fsw.wheel_geometry import SKEW, WheelGeometry
from fsw.wheel_motor import WheelMotor, fill_motor

FourMotors = tuple[WheelMotor | None, WheelMotor | None, WheelMotor | None, WheelMotor | None]


class Vehicle:
    """The satellite, ready to compute with. Shared by all algorithms of a flight; nothing in it changes."""

    __slots__ = (
        "fitted",
        "inertia_kgm2",
        "inverse_inertia",
        "wheel_inertia_kgm2",
        "wheel_max_speed_rad_s",
        "wheel_momentum",
        "wheel_motors",
        "wheels",
    )

    def __init__(self, config: ModelConfig) -> None:
        """Raises ConfigError when the inertia is not positive definite, or an axis has no direction."""
        self.inertia_kgm2: Mat3 = config.inertia_kgm2
        self.inverse_inertia: Mat3 = invert_inertia(config.inertia_kgm2)
        self.wheel_momentum = config.wheel_momentum  # whether the wheels' momentum is in the gyroscopic term
        a, b, c, d = config.wheels or _four_alike(config)
        self.wheel_max_speed_rad_s: Vec4 = (a.max_speed_rad_s, b.max_speed_rad_s, c.max_speed_rad_s, d.max_speed_rad_s)
        self.wheel_inertia_kgm2: Vec4 = (a.inertia_kgm2, b.inertia_kgm2, c.inertia_kgm2, d.inertia_kgm2)
        self.fitted: Flags4 = (a.fitted, b.fitted, c.fitted, d.fitted)
        self.wheel_motors: FourMotors = (_motor_of(a), _motor_of(b), _motor_of(c), _motor_of(d))
        self.wheels = WheelGeometry(
            (_point(a, 0), _point(b, 1), _point(c, 2), _point(d, 3)),
            (a.max_torque_nm, b.max_torque_nm, c.max_torque_nm, d.max_torque_nm),
        )


def invert_inertia(inertia_kgm2: Mat3) -> Mat3:
    """Return the inverse of the inertia matrix [1/(kg m^2)]. Raises ConfigError when it is not positive definite."""
    (a, b, c), (d, e, f), (g, h, i) = inertia_kgm2
    minor_2 = a * e - b * d
    det = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    if not (a > 0.0 and minor_2 > 0.0 and det > 0.0):
        raise ConfigError(
            f"model.inertia_kgm2 = {inertia_kgm2} kg m^2 is not positive definite "
            f"(leading minors {a:g}, {minor_2:g}, {det:g}, all must be > 0); check its signs and its symmetry"
        )
    return invert_symmetric(inertia_kgm2)


def _four_alike(config: ModelConfig) -> tuple[WheelModelConfig, ...]:
    """Three wheels along the body axes and one askew to all of them, Zhang, Ye & Sun 2018, eq (5)."""
    axes: tuple[Vec3, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (SKEW, SKEW, SKEW))
    return tuple(
        WheelModelConfig(
            axis_b=axis,
            max_torque_nm=config.wheel_max_torque_nm,
            max_speed_rad_s=config.wheel_max_speed_rad_s,
            inertia_kgm2=config.wheel_inertia_kgm2,
            motor=config.wheel_motor,
        )
        for axis in axes
    )


def _motor_of(config: WheelModelConfig) -> WheelMotor | None:
    return None if config.motor is None else fill_motor(config.motor)


def _point(config: WheelModelConfig, wheel: int) -> Vec3:
    """The unit vector of a wheel's axis; the zero vector where there is no wheel, so that nothing can come from there."""
    axis = config.axis_b
    x, y, z = axis
    length = math.sqrt(x * x + y * y + z * z)
    if not length > 1e-6:
        raise ConfigError(f"model.wheels[{wheel}].axis_b = {axis} has no direction; its length is {length:g}")
    if not config.fitted:
        return ZERO3
    if abs(length - 1.0) < 1e-15:
        return axis
    return (x / length, y / length, z / length)
