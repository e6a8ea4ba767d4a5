"""The families of algorithms that a scenario can choose from: the base class of each, which says what it must offer.

An algorithm is a class of its family that is made as `Algorithm(settings, vehicle, period_s)`, with settings a frozen
dataclass that has a `kind`, and period_s the nominal time between two calls of `step`. It is registered by one line in its
family's `__init__.py`. It is deterministic: no clock, no random numbers, no input or output of its own.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

from mypy_extensions import mypyc_attr

from bus.units import Vec3, Vec4
from fsw.records import Allocation, Detection, Estimate, FourReadings, PointingError, Sensors, Target, WheelHealth


class NoInternals(NamedTuple):
    """Of an algorithm that has nothing to show."""


NO_INTERNALS: Final = NoInternals()


@mypyc_attr(allow_interpreted_subclasses=True)
class Algorithm:
    """What all families have in common."""

    __slots__ = ()

    @property
    def internals(self) -> tuple[Any, ...]:
        """A named tuple of numbers and tuples of numbers, fixed in shape, for telemetry."""
        return NO_INTERNALS

    @property
    def caution(self) -> str:
        """What its settings leave in doubt, in words for the log; empty where there is nothing."""
        return ""

    def reset(self) -> None:
        """Back to where it was when it was made."""
        raise NotImplementedError


@mypyc_attr(allow_interpreted_subclasses=True)
class Estimator(Algorithm):
    """Attitude and rate from the sensors of a tick."""

    __slots__ = ()

    def step(self, sensors: Sensors) -> Estimate:
        """Return attitude and rate at this tick."""
        raise NotImplementedError


@mypyc_attr(allow_interpreted_subclasses=True)
class Detector(Algorithm):
    """Gyro fault detection."""

    __slots__ = ()

    def step(self, sensors: Sensors, estimate: Estimate, tau_rw_cmd_nm: Vec4) -> Detection:
        """tau_rw_cmd_nm: wheel torques commanded over the tick that ends now (as sent) [N m]."""
        raise NotImplementedError


@mypyc_attr(allow_interpreted_subclasses=True)
class Observer(Algorithm):
    """The lumped fault torque on the body."""

    __slots__ = ()

    def step(self, dt_s: float, omega_bi_b_rad_s: Vec3, tau_cmd_b_nm: Vec3, h_rw_b_nms: Vec3) -> Vec3:
        """Advance by dt_s; return the lumped fault torque on the body [N m].

        dt_s         : time since the last call; the nominal period, or more after lost ticks
        tau_cmd_b_nm : torque commanded (as sent) over the interval that ends now [N m]
        h_rw_b_nms   : total wheel momentum in body axes [N m s]; zeros for the papers' plant
        """
        raise NotImplementedError

    def shift_rate(self, step_b_rad_s: Vec3) -> None:
        """Move the internal rate state by a known jump of the rate source (bumpless transfer)."""
        raise NotImplementedError


@mypyc_attr(allow_interpreted_subclasses=True)
class WheelHealthMonitor(Algorithm):
    """Which wheels give what they are told."""

    __slots__ = ()

    def step(
        self, dt_s: float, wheels: FourReadings, tau_rw_cmd_nm: Vec4, tau_fault_hat_b_nm: Vec3 | None
    ) -> WheelHealth:
        """Advance by dt_s; return what is thought of the wheels now.

        tau_rw_cmd_nm      : torques that the wheels were to give over the interval that ends now [N m]; as sent, unless
                             `note_sent` said otherwise
        tau_fault_hat_b_nm : the observer's fault torque for that interval [N m]; None while no observer runs
        """
        raise NotImplementedError

    def note_sent(self, tau_rw_sent_nm: Vec4) -> None:
        """Called before `step` where the drive makes up for drag or gain: the torques that the frames carried [N m]."""


@mypyc_attr(allow_interpreted_subclasses=True)
class Guide:
    """A course of the target over time."""

    __slots__ = ()

    @property
    def top_rate_rad_s(self) -> float:
        """The rate that it is sure to come to [rad/s]; 0 where it does not say."""
        return 0.0

    def point(self, t_s: float) -> Target:
        """Return the target at the time t_s [s]."""
        raise NotImplementedError


@mypyc_attr(allow_interpreted_subclasses=True)
class Controller(Algorithm):
    """From the pointing error to a body torque."""

    __slots__ = ()

    def step(self, dt_s: float, error: PointingError, tau_fault_hat_b_nm: Vec3, health: WheelHealth) -> Vec3:
        """Advance by dt_s; return the torque that is to act on the body, body axes [N m].

        tau_fault_hat_b_nm : the observer's fault torque less what `health` explains, which the law makes up for [N m]
        """
        raise NotImplementedError

    def note_sent(self, tau_b_nm: Vec3) -> None:
        """Called after `step`: the torque that the wheels are now expected to give for it, body axes [N m].

        It is less than what `step` returned where limits, health or whole steps of a frame left no more. What a moving
        target takes beside it is not in it.
        """


@mypyc_attr(allow_interpreted_subclasses=True)
class Allocator(Algorithm):
    """From a body torque to wheel torques within limits."""

    __slots__ = ()

    def allocate(self, tau_cmd_b_nm: Vec3, health: WheelHealth) -> Allocation:
        """Return the wheels' share of a body torque [N m]; see each allocator for what is kept on saturation."""
        raise NotImplementedError
