"""What one stage of the flight cycle hands to the next.

Vectors are plain tuples of floats in body axes unless named otherwise. A record that a cycle makes is not changed any more
once it is handed on, but for `Sensors` and its `WheelReading`s: there is one of each, brought up to date every cycle, so
that whoever needs a value of an earlier cycle keeps the value and not the record.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from bus.attitude import IDENTITY
from bus.linear import ZERO3, ZERO4
from bus.units import Vec3, Vec4

Flags3 = tuple[bool, bool, bool]  # one per gyro axis
Flags4 = tuple[bool, bool, bool, bool]  # one per wheel
ALL_AXES: Flags3 = (True, True, True)
ALL_WHEELS: Flags4 = (True, True, True, True)
NO_WHEEL: Flags4 = (False, False, False, False)


@dataclass(slots=True)
class WheelReading:
    """What one wheel reports. A value that has not come for a while is held and marked not valid."""

    speed_rad_s: float = 0.0  # of the rotor, relative to the body, about the nominal axis
    current_a: float = 0.0  # of the motor
    status: int = 0  # as its frame says: 0 ok, 1 fault, 2 no command, 3 speed limit
    valid: bool = True  # False once its last frame is older than the staleness limit
    h_nms: float = 0.0  # momentum relative to the body: speed times rotor inertia


def four_readings() -> tuple[WheelReading, WheelReading, WheelReading, WheelReading]:
    """Four wheels at rest that have been heard."""
    return (WheelReading(), WheelReading(), WheelReading(), WheelReading())


@dataclass(slots=True)
class Sensors:
    """What the validated bus traffic up to one tick says. A stale or failed unit is marked, never left out."""

    tick: int = 0
    t_s: float = 0.0  # tick * base period
    omega_meas_b_rad_s: Vec3 = ZERO3  # gyro rate per axis, mean over the last tick; last good value where not valid
    gyro_valid: Flags3 = ALL_AXES
    q_ib_meas: Vec4 = IDENTITY  # star-tracker attitude, scalar first, unit norm
    star_new: bool = False  # True on the tick on which q_ib_meas arrived
    star_valid: bool = False  # False once the last one is older than the staleness limit
    star_age_s: float = 0.0  # age of q_ib_meas at this tick (0.0: measured at this tick)
    wheels: tuple[WheelReading, WheelReading, WheelReading, WheelReading] = field(default_factory=four_readings)

    def wheel_momenta(self) -> Vec4:
        """Momentum of each wheel relative to the body [N m s]; last good value where not valid."""
        a, b, c, d = self.wheels
        return (a.h_nms, b.h_nms, c.h_nms, d.h_nms)

    def wheels_valid(self) -> Flags4:
        """Which wheels have been heard lately."""
        a, b, c, d = self.wheels
        return (a.valid, b.valid, c.valid, d.valid)


@dataclass(slots=True)
class Estimate:
    """Attitude and rate as the controllers use them."""

    q_ib: Vec4  # scalar first, Hamilton: v_i = R(q_ib) v_b
    omega_bi_b_rad_s: Vec3
    bias_b_rad_s: Vec3  # gyro bias estimate (zeros where the estimator has none)
    valid: bool  # False: not fit for pointing


@dataclass(slots=True)
class Detection:
    """What gyro fault detection found, and the estimate to use from here on."""

    estimate: Estimate
    rate_step_b_rad_s: Vec3  # jump of the rate source at this tick, for bumpless transfer to observers (usually zeros)
    gyro_state: tuple[int, int, int]  # 0 nominal, 1 suspect, 2 alarm, 3 classified
    fault_hat_b_rad_s: Vec3  # gyro fault estimate per axis
    request_safe: bool  # True: rate knowledge is no longer good enough to point
    rate_good: bool  # False: the rate above is not fit even for damping (no gyro and nothing in its place)


@dataclass(slots=True)
class WheelHealth:
    """What is thought of the four wheels."""

    effectiveness: Vec4 = (1.0, 1.0, 1.0, 1.0)  # share of its commanded torque that each gives, 0 .. 1
    available: Flags4 = ALL_WHEELS  # False: not to be used
    alarm: Flags4 = NO_WHEEL  # True while a wheel's torque is not what was commanded
    explained_b_nm: Vec3 = ZERO3  # the part of the observer's fault torque that `effectiveness` accounts for


HEALTHY = WheelHealth()


@dataclass(slots=True)
class Target:
    """Where the body is to point, and how that moves."""

    q_it: Vec4  # attitude of the target in inertial, scalar first, unit norm
    omega_ti_t_rad_s: Vec3 = ZERO3  # rate of the target with respect to inertial, target axes
    alpha_ti_t_rad_s2: Vec3 = ZERO3  # its rate of change, target axes

    @property
    def at_rest(self) -> bool:
        """True where the target does not move."""
        return self.omega_ti_t_rad_s == ZERO3 and self.alpha_ti_t_rad_s2 == ZERO3


@dataclass(slots=True)
class PointingError:
    """The body with respect to its target."""

    q_tb: Vec4  # scalar first; the sign is chosen with hysteresis, so that q0 >= 0 but near the half turn
    omega_bt_b_rad_s: Vec3  # rate of the body with respect to the target, body axes
    omega_ti_b_rad_s: Vec3 = ZERO3  # the target's own rate, body axes
    alpha_ti_b_rad_s2: Vec3 = ZERO3  # and its rate of change as seen in inertial, body axes


@dataclass(slots=True)
class Allocation:
    """What the wheels are to give."""

    tau_rw_nm: Vec4 = ZERO4  # torque of each wheel on the body, within its limits
    achieved_b_nm: Vec3 = ZERO3  # the body torque that these add up to, if each wheel gives what it is told
    margin: float = 1.0  # share of the most loaded wheel's torque that is still free, 0 .. 1


@dataclass(slots=True)
class WheelCommands:
    """What goes out to the wheels."""

    modes: tuple[int, int, int, int]  # of each command frame: 0 off, 1 torque
    tau_rw_nm: Vec4  # torque on the body, as the frames carry it
    saturated: int  # how many of the four had to be cut to what a frame can carry
