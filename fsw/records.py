"""What one stage of the flight cycle hands to the next, and what each family of algorithms must offer.

Everything is a plain tuple of floats: shapes stand in the comments, vectors are in body axes unless named otherwise.
An algorithm is deterministic: no clock, no random numbers, no input or output of its own.

What every cycle makes is made by `tuple.__new__(Sensors, (...))`, at a third of the cost of calling the class.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

from bus.units import Vec3, Vec4


class Sensors(NamedTuple):
    """What the validated bus traffic of one tick says. A stale or failed unit is marked, never left out."""

    tick: int
    t_s: float  # tick * base period
    omega_meas_b_rad_s: Vec3  # gyro rate per axis, mean over the last tick; last good value where not valid
    gyro_valid: tuple[bool, bool, bool]
    q_ib_meas: Vec4  # last star-tracker attitude, scalar first, unit norm
    star_new: bool  # True on the tick on which q_ib_meas arrived
    star_valid: bool  # False once the last one is older than the staleness limit
    star_age_s: float  # age of q_ib_meas at this tick (0.0: measured at this tick)
    wheel_speed_rad_s: Vec4  # relative to the body, about each wheel's nominal axis
    wheel_valid: tuple[bool, bool, bool, bool]
    h_rw_nms: Vec4  # wheel_speed * rotor inertia: momentum relative to the body, per wheel


class Estimate(NamedTuple):
    """Attitude and rate as the controllers use them."""

    q_ib: Vec4  # scalar first, Hamilton: v_i = R(q_ib) v_b
    omega_bi_b_rad_s: Vec3
    bias_b_rad_s: Vec3  # gyro bias estimate (zeros where the estimator has none)
    valid: bool  # False: not fit for pointing


class Detection(NamedTuple):
    """Output of the fault detection stage: the estimate to use from here on, and what was found."""

    estimate: Estimate
    rate_step_b_rad_s: Vec3  # jump of the rate source at this tick, for bumpless transfer to observers (usually zeros)
    gyro_state: tuple[int, int, int]  # 0 nominal, 1 suspect, 2 alarm, 3 classified
    wheel_alarm: tuple[bool, bool, bool, bool]
    fault_hat_b_rad_s: Vec3  # gyro fault estimate per axis
    request_safe: bool  # True: rate knowledge is no longer good enough to point
    rate_good: bool = True  # False: the rate above is not fit even for damping (no gyro and nothing in its place)


class Demand(NamedTuple):
    """What a controller asks for."""

    tau_cmd_b_nm: Vec3  # body torque
    tau_rw_nm: Vec4 | None  # set only by laws that command the wheels directly; then the allocator only limits


class Estimator(Protocol):
    def reset(self) -> None: ...
    def step(self, sensors: Sensors) -> Estimate: ...


class Detector(Protocol):
    @property
    def internals(self) -> tuple[Any, ...]:
        """A named tuple of numbers and tuples of numbers, fixed in shape, for telemetry."""
        ...

    def reset(self) -> None: ...
    def step(self, sensors: Sensors, estimate: Estimate, tau_rw_cmd_nm: Vec4) -> Detection:
        """tau_rw_cmd_nm: wheel torques commanded over the tick that ends now (after limiting) [N m]."""
        ...


class Observer(Protocol):
    def reset(self) -> None: ...
    def step(self, dt_s: float, omega_bi_b_rad_s: Vec3, tau_cmd_b_nm: Vec3, h_rw_b_nms: Vec3) -> Vec3:
        """Advance one control period; return the lumped fault torque on the body [N m].

        tau_cmd_b_nm : torque commanded (after limiting, D0 @ tau_rw) over the interval that ends now [N m]
        h_rw_b_nms   : total wheel momentum in body axes, D0 @ h_rw [N m s]; zeros for the papers' plant
        """
        ...

    def shift_rate(self, step_b_rad_s: Vec3) -> None:
        """Move the internal rate state by a known jump of the rate source (bumpless transfer)."""
        ...


class Controller(Protocol):
    @property
    def internals(self) -> tuple[Any, ...]:
        """A named tuple of numbers and tuples of numbers, fixed in shape, for telemetry."""
        ...

    def reset(self) -> None: ...
    def step(self, dt_s: float, q_err: Vec4, omega_err_b_rad_s: Vec3, tau_fault_hat_b_nm: Vec3) -> Demand:
        """q_err: body with respect to target, q0 >= 0 already chosen by the caller (with hysteresis)."""
        ...


class Allocator(Protocol):
    def allocate(self, tau_cmd_b_nm: Vec3) -> Vec4:
        """Wheel torques within limits [N m] for a body torque; see each allocator for what is kept on saturation."""
        ...

    def limit(self, tau_rw_nm: Vec4) -> Vec4:
        """Bring demanded wheel torques within limits."""
        ...
